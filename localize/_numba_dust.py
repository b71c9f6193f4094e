"""The kernel of `localize.dust`: how thick the points are that fall in each cube."""

import numpy as np
from numba import njit


@njit(cache=True)
def cubes(points, near, size, cube, count, thickness):
    """Cubes of edge ``size`` that the points (n, 3) nearer than ``near`` fall in; returns how many.

    cube (n,) int32: the number of each point's cube, -1 where it is farther off. count (n,), thickness (n,): of each
    cube, its points and the root of their least variance.
    """
    half = np.int64(np.ceil(near / size))
    across = 2 * half
    number = np.full(across * across * across, -1, np.int32)
    moments = np.empty((len(points), 9))
    inverse_size, near2 = 1.0 / size, near * near
    used = 0
    for p in range(len(points)):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        cube[p] = -1
        # not the other way round: what is no number is not near
        if not x * x + y * y + z * z < near2:
            continue
        # all are positive, so that what is cut off is rounded down
        i, j, k = int(x * inverse_size + half), int(y * inverse_size + half), int(z * inverse_size + half)
        place = (i * across + j) * across + k
        c = number[place]
        if c < 0:
            c = number[place] = used
            count[c] = 0
            moments[c] = 0.0
            used += 1
        cube[p] = c
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
