"""Kernel of the filter's update: the one system of equations in it."""

import numpy as np
from numba import njit


@njit(cache=True)
def solved(P, columns, A, rhs):
    """``(I + P A)⁻¹ rhs`` (n, k) for A (m, m) that has only ``columns`` (m,) of P (n, n): a system of m."""
    n, m = len(P), len(columns)
    PA, small, right = np.empty((n, m)), np.empty((m, m)), np.empty((m, rhs.shape[1]))
    for i in range(n):
        for j in range(m):
            PA[i, j] = P[i, columns[j]]
    PA = np.dot(PA, A)
    for i in range(m):
        small[i] = PA[columns[i]]
        small[i, i] += 1.0
        right[i] = rhs[columns[i]]
    return rhs - np.dot(PA, np.linalg.solve(small, right))
