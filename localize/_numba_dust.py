"""The kernel of `localize.dust`: how thick the points are that fall in each cube."""

import numpy as np
from numba import njit

from localize._numba_voxels import EMPTY, cell_key, slot_of


@njit(cache=True)
def cubes(points, near, size, table, cube, count, moments, thickness):
    """Cubes of edge ``size`` that the points (n, 3) nearer than ``near`` fall in; returns how many.

    cube (n,): the number of each point's cube, -1 where it is farther off. count (n,), thickness (n,): of each cube,
    its points and the root of their least variance. table (m, 2), m a power of two of at least 2 n, and moments (n, 9)
    are scratch.
    """
    table[:, 0] = EMPTY
    used = 0
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if x * x + y * y + z * z >= near * near:
            cube[i] = -1
            continue
        key = cell_key(x, y, z, 1.0 / size)
        slot = slot_of(table, key)
        if table[slot, 0] == EMPTY:
            table[slot, 0] = key
            table[slot, 1] = used
            count[used] = 0
            moments[used] = 0.0
            used += 1
        c = table[slot, 1]
        cube[i] = c
        count[c] += 1
        m = moments[c]
        m[0] += x
        m[1] += y
        m[2] += z
        m[3] += x * x
        m[4] += x * y
        m[5] += x * z
        m[6] += y * y
        m[7] += y * z
        m[8] += z * z
    for c in range(used):
        n, m = count[c], moments[c]
        x, y, z = m[0] / n, m[1] / n, m[2] / n
        least = _least_variance(
            m[3] / n - x * x, m[4] / n - x * y, m[5] / n - x * z, m[6] / n - y * y, m[7] / n - y * z, m[8] / n - z * z
        )
        thickness[c] = np.sqrt(max(least, 0.0))
    return used


@njit(cache=True, inline="always")
def _least_variance(xx, xy, xz, yy, yz, zz):
    """The least eigenvalue of a symmetric matrix, by the cosine formula: exact to some 1e-8 of the largest."""
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    p2 = (a * a + b * b + c * c) / 6.0 + (xy * xy + xz * xz + yz * yz) / 3.0
    if p2 <= 1e-30:
        return mean
    p = np.sqrt(p2)
    det = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    cosine = min(max(0.5 * det / (p * p2), -1.0), 1.0)
    return mean + 2.0 * p * np.cos(np.arccos(cosine) / 3.0 + 2.0 * np.pi / 3.0)
