"""The kernel of `localize.dust`: how thick the points are that fall in each cube."""

import numpy as np
from numba import njit

from localize._numba_voxels import EMPTY, cell_key, eigen3, slot_of


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
    S, variances, axes = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    for c in range(used):
        n, m = count[c], moments[c]
        k = 3
        for a in range(3):
            for b in range(a, 3):
                S[a, b] = S[b, a] = m[k] / n - m[a] * m[b] / (n * n)
                k += 1
        eigen3(S, variances, axes)
        thickness[c] = np.sqrt(max(variances[0], 0.0))
    return used
