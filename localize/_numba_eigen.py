"""Kernel: eigenvalues and eigenvectors of a symmetric matrix of three by three, in closed form."""

import numpy as np
from numba import njit

_THIRD_TURN = 2.0 * np.pi / 3.0


@njit(cache=True)
def eigen3(S, values, vectors):
    """Eigenvalues (3,), ascending, and eigenvectors (rows of (3, 3)) of a symmetric matrix S (3, 3).

    The eigenvalue that stands farther from the middle one comes from the cosine formula, its eigenvector across the
    rows of ``S - λ``; the two others from one Jacobi rotation across it. Exact to the last digits of the largest,
    orthonormal whatever the matrix, and several times faster than LAPACK or Jacobi's sweeps.
    """
    xx, xy, xz, yy, yz, zz = S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2]
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    p = np.sqrt((a * a + b * b + c * c) / 6.0 + (xy * xy + xz * xz + yz * yz) / 3.0)
    if p <= 1e-12 * abs(mean):
        values[:] = mean
        vectors[:, :] = np.eye(3)
        return
    cosine = 0.5 * (a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)) / (p * p * p)
    angle = np.arccos(min(max(cosine, -1.0), 1.0)) / 3.0
    largest = cosine >= 0.0
    alone = 2.0 * p * np.cos(angle if largest else angle + _THIRD_TURN)
    a, b, c = a - alone, b - alone, c - alone
    vx, vy, vz = _across_rows(a, xy, xz, b, yz, c)
    # two axes across it, and what S does among them
    if abs(vx) > abs(vy):
        length = np.sqrt(vx * vx + vz * vz)
        sx, sy, sz = -vz / length, 0.0, vx / length
    else:
        length = np.sqrt(vy * vy + vz * vz)
        sx, sy, sz = 0.0, vz / length, -vy / length
    tx, ty, tz = vy * sz - vz * sy, vz * sx - vx * sz, vx * sy - vy * sx
    Sx, Sy, Sz = xx * sx + xy * sy + xz * sz, xy * sx + yy * sy + yz * sz, xz * sx + yz * sy + zz * sz
    ss, st = sx * Sx + sy * Sy + sz * Sz, tx * Sx + ty * Sy + tz * Sz
    Sx, Sy, Sz = xx * vx + xy * vy + xz * vz, xy * vx + yy * vy + yz * vz, xz * vx + yz * vy + zz * vz
    vv = vx * Sx + vy * Sy + vz * Sz
    tt = 3.0 * mean - ss - vv
    tangent = 0.0
    if st != 0.0:
        theta = (tt - ss) / (2.0 * st)
        tangent = np.copysign(1.0, theta) / (abs(theta) + np.sqrt(theta * theta + 1.0))
    cos = 1.0 / np.sqrt(tangent * tangent + 1.0)
    sin = tangent * cos
    first, second = ss - tangent * st, tt + tangent * st
    low, high = (0, 1) if largest else (1, 2)
    if first > second:
        low, high = high, low
    values[low], values[high] = first, second
    vectors[low, 0], vectors[low, 1], vectors[low, 2] = cos * sx - sin * tx, cos * sy - sin * ty, cos * sz - sin * tz
    vectors[high, 0], vectors[high, 1], vectors[high, 2] = sin * sx + cos * tx, sin * sy + cos * ty, sin * sz + cos * tz
    at = 2 if largest else 0
    values[at] = vv
    vectors[at, 0], vectors[at, 1], vectors[at, 2] = vx, vy, vz


@njit(cache=True, inline="always")
def _across_rows(xx, xy, xz, yy, yz, zz):
    """Unit vector across the rows of a symmetric matrix of rank two: of their three cross products the longest."""
    x, y, z = xy * yz - xz * yy, xz * xy - xx * yz, xx * yy - xy * xy
    length2 = x * x + y * y + z * z
    u, v, w = xy * zz - xz * yz, xz * xz - xx * zz, xx * yz - xy * xz
    other2 = u * u + v * v + w * w
    if other2 > length2:
        x, y, z, length2 = u, v, w, other2
    u, v, w = yy * zz - yz * yz, yz * xz - xy * zz, xy * yz - yy * xz
    other2 = u * u + v * v + w * w
    if other2 > length2:
        x, y, z, length2 = u, v, w, other2
    length = np.sqrt(length2)
    return x / length, y / length, z / length
