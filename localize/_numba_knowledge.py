"""Kernels of what is known, by direction: by a scan beyond its noise, and by the local map that is new."""

import numpy as np
from numba import njit

from localize._numba_eigen import eigen3


@njit(cache=True)
def beyond_noise(A, b, B, C, blind_from, doubt):
    """A (6, 6), b (6,) and B (6, 6) of `point_to_shape` without what C explains, in place; see `localize.lidar`.

    Returns along how many directions nothing is left.

    Rotation and position each for themselves: along a direction in which a share γ of A comes from C, b is multiplied
    by ``1 - γ``, and A and B by its square. Both fade, as the number of points does, to nothing where γ comes to
    ``blind_from``. doubt (6, 6): columns along these directions, as long as noise is to knowledge, ``γ / (1 - γ)``, and
    of length 1 where nothing is left.
    """
    T, Tb, W, share, V = np.zeros((6, 6)), np.zeros((6, 6)), np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    doubt[:, :] = 0.0
    blind = 0
    for first in (0, 3):
        block = slice(first, first + 3)
        # whitened by A: W A Wᵀ = 1, rows of W
        eigen3(A[block, block], share, W)
        least = 1e-9 * (share[0] + share[1] + share[2])
        for i in range(3):
            W[i] /= np.sqrt(max(share[i], least))
        eigen3(W @ np.ascontiguousarray(C[block, block]) @ W.T, share, V)
        directions = V @ W
        known = directions @ np.ascontiguousarray(A[block, block])
        for i in range(3):
            left = 1.0 - share[i]
            counts = max(1.0 - share[i] / blind_from, 0.0) / max(left, 1.0 - blind_from)
            for row in range(3):
                for column in range(3):
                    kept = left * known[i, row] * directions[i, column]
                    T[first + row, first + column] += np.sqrt(counts) * kept
                    Tb[first + row, first + column] += counts * kept
            odds = share[i] / left if counts > 0.0 else 1.0
            blind += counts == 0.0
            doubt[block, first + i] = odds / np.sqrt(np.sum(directions[i] ** 2)) * directions[i]
    A[:, :] = T @ A @ T.T
    b[:] = Tb @ b
    B[:, :] = T @ B @ T.T
    return blind


@njit(cache=True)
def new_share(A, new, R_odom_map, doubt, vague, lever, out):
    """How much of the map is new, into out (6, 6), see `renewed` of `localize.local_map`.

    A, new (6, 6) : of `Renewal`. vague (6,) : what is taken to be known besides. lever : a turn by 1 rad in metres.
    """
    G = np.zeros((6, 6))
    G[:3, :3], G[3:, 3:] = R_odom_map / lever, R_odom_map
    floor = np.diag(vague)
    A, new = G @ (A + floor) @ G.T, G @ (new + floor) @ G.T
    strength, axes = np.linalg.eigh(A)
    old = np.zeros((6, 6))
    for k in range(6):
        u = np.ascontiguousarray(axes[:, k])
        # what the noise of normals pretends to tell may be more than all that is known
        share = min(np.dot(u, np.dot(new, u)) / strength[k], 1.0)
        for i in range(6):
            for j in range(6):
                old[i, j] += (1.0 - share) * u[i] * u[j]
    kept = np.empty((6, 6))
    without(doubt, kept)
    old = kept @ old @ kept
    for i in range(6):
        for j in range(6):
            out[i, j] = ((1.0 if i == j else 0.0) - old[i, j]) * (lever if j < 3 else 1.0) / (lever if i < 3 else 1.0)


@njit(cache=True)
def without(doubt, kept):
    """What scales errors down, into kept (6, 6), by the columns of doubt (6, m), of length 1 at the most.

    Those that are not square to a longer one count by what they have beside it: from the longest on.
    """
    kept[:, :] = np.eye(6)
    size = np.sqrt(np.sum(doubt**2, axis=0))
    axes = np.zeros((6, len(size)))
    order = np.argsort(-size, kind="mergesort")
    for n, column in enumerate(order):
        if size[column] == 0.0:
            break
        axis = doubt[:, column] / size[column]
        for m in range(n):
            axis -= np.sum(axes[:, m] * axis) * axes[:, m]
        length = np.sqrt(np.sum(axis**2))
        if length < 1e-6:
            continue
        axes[:, n] = axis / length
        taken = 1.0 - np.sqrt(max(1.0 - size[column] ** 2, 0.0))
        for i in range(6):
            for j in range(6):
                kept[i, j] -= taken * axes[i, n] * axes[j, n]
