"""The geometric invariant point: where the medial axes of the roadways meet.

A medial axis is equally far from the walls on both sides, so the point depends on the walls right around the
intersection and on nothing else: not on how densely they were sampled, nor on how far down the roadways one can see.
A node of a medial axis of cells is known to about a cell; the point is drawn from it to the centre of the clear
space around, which is known to a fraction of one.
"""

from __future__ import annotations

import numpy as np

from maps.free_space import FreeSpace
from semmap.geometry import Array

_KERNEL_M = 2.0
_NODE_SHARE = 0.25
_TOLERANCE_M, _MOST_STEPS = 0.005, 100
_PLANE_M, _PLANE_CELLS = 2.5, 20


def invariant_point(node: Array, space: FreeSpace, *, tied: bool = True) -> Array:
    """Centre (3,) of the clear space around a node (3,) of the medial axis; on the floor.

    The fixed point of ``p = (1 - a) m(p) + a node``, where ``m`` is the mean of the floor cells within two metres of p
    (as far as the walls are where that is more) weighted by the square of their clearance and by nearness.

    tied : whether ``a`` is a quarter, for a node where roadways meet, or 0, for a corner: the place of its node depends
        on how much of both legs is seen, and walls that turn hold the centre by themselves.
    """
    share = _NODE_SHARE if tied else 0.0
    radius = max(_KERNEL_M, space.clearance_at(node))
    rows = space.around(node, 2.0 * radius)
    plan, weight = space.centres(rows)[:, :2], space.clearance[rows].astype(np.float64) ** 2
    p = node[:2]
    for _ in range(_MOST_STEPS):
        near = np.clip(1.0 - np.sum((plan - p) ** 2, axis=1) / radius**2, 0.0, None) * weight
        if near.sum() <= 0.0:
            break
        before, p = p, (1.0 - share) * (near @ plan) / near.sum() + share * node[:2]
        if np.linalg.norm(p - before) < _TOLERANCE_M:
            break
    return on_floor(np.append(p, node[2]), space)


def on_floor(p: Array, space: FreeSpace) -> Array:
    """The point (3,) on the plane that fits the floor around it best, or as it is where there is none."""
    cells = space.centres(space.around(p, _PLANE_M))
    if len(cells) < _PLANE_CELLS:
        return p
    weight = np.clip(1.0 - np.sum((cells[:, :2] - p[:2]) ** 2, axis=1) / _PLANE_M**2, 0.0, None)
    mean = weight @ cells / weight.sum()
    off = cells - mean
    spread = (weight * off.T) @ off
    slope = np.linalg.lstsq(spread[:2, :2], spread[:2, 2], rcond=None)[0]
    return np.append(p[:2], mean[2] + slope @ (p[:2] - mean[:2]))
