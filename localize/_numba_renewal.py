"""Kernel of the local map: how much of it is new by what was put in, see `renewed` of `localize.local_map`."""

import numpy as np
from numba import njit


@njit(cache=True)
def new_share(A, new, R_odom_map, doubt, vague, lever, out):
    """Into out (6, 6); A and new (6, 6) in the axes of the map, vague (6,) what is known of each place for sure."""
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
