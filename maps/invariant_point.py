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

_KERNEL_M = 3.0
_NODE_SHARE = 0.4
_TOLERANCE_M = 0.005
_PLANE_M, _PLANE_CELLS = 2.5, 20


def invariant_point(node: Array, space: FreeSpace) -> Array:
    """Centre (3,) of the clear space around a node (3,) of the medial axis, tied to the node; on the floor.

    The fixed point of ``p = (1 - a) m(p) + a node``, where ``m`` is the mean of the floor cells within three metres of
    p (one and a half clearances where that is more) weighted by the square of their clearance and by nearness.
    """
    radius = max(_KERNEL_M, 1.5 * space.clearance_at(node))
    rows = space.around(node, 2.0 * radius)
    plan, weight = space.centres(rows)[:, :2], space.clearance[rows].astype(np.float64) ** 2
    p = node[:2]
    for _ in range(20):
        near = np.clip(1.0 - np.sum((plan - p) ** 2, axis=1) / radius**2, 0.0, None) * weight
        if near.sum() <= 0.0:
            break
        before, p = p, (1.0 - _NODE_SHARE) * (near @ plan) / near.sum() + _NODE_SHARE * node[:2]
        if np.linalg.norm(p - before) < _TOLERANCE_M:
            break
    return on_floor(np.append(p, node[2]), space)


def on_floor(p: Array, space: FreeSpace) -> Array:
    """The point (3,) on the plane that fits the floor around it best, or as it is where there is none."""
    cells = space.centres(space.around(p, _PLANE_M))
    if len(cells) < _PLANE_CELLS:
        return p
    away = cells[:, :2] - p[:2]
    weight = np.sqrt(np.clip(1.0 - np.sum(away**2, axis=1) / _PLANE_M**2, 0.0, None))
    A = np.column_stack([np.ones(len(away)), away])
    level = np.linalg.lstsq(weight[:, None] * A, weight * cells[:, 2], rcond=None)[0]
    return np.append(p[:2], level[0])
