"""The geometric invariant point: where the medial axes of the roadways meet.

A medial axis is equally far from the walls on both sides, so the point depends on the walls right around the
intersection and on nothing else: not on how densely they were sampled, nor on how far down the roadways one can see.
A node of a raster's medial axis is known to about a cell; the point is drawn from it to the centre of the clear
space around, which is known to a fraction of one.
"""

from __future__ import annotations

import numpy as np

from maps.grid import Grid
from semmap.geometry import Array

_KERNEL_M = 3.0
_NODE_SHARE = 0.4
_TOLERANCE_M = 0.005


def invariant_point(node: Array, clearance: Array, grid: Grid) -> Array:
    """Centre (2,) of the clear space around a node (2,) of the medial axis, tied to the node.

    The fixed point of ``p = (1 - a) m(p) + a node``, where ``m`` is the mean of the cells within three metres of p
    (one and a half clearances where that is more) weighted by the square of their clearance and by nearness.

    clearance : (nx, ny) distance to the nearest wall [m].
    """
    p = np.asarray(node, dtype=np.float64)
    radius = max(_KERNEL_M, 1.5 * grid.sample(clearance, p[None])[0])
    for _ in range(20):
        moved = (1.0 - _NODE_SHARE) * _clear_mean(p, radius, clearance, grid) + _NODE_SHARE * node
        if np.linalg.norm(moved - p) < _TOLERANCE_M:
            return moved
        p = moved
    return p


def _clear_mean(p: Array, radius: float, clearance: Array, grid: Grid) -> Array:
    """Mean (2,) of the cells around ``p`` weighted by squared clearance and nearness."""
    centre = grid.coordinates(p[None])[0]
    reach = radius / grid.cell
    low = np.maximum(np.floor(centre - reach).astype(int), 0)
    high = np.minimum(np.ceil(centre + reach).astype(int) + 1, grid.shape)
    i, j = np.arange(low[0], high[0])[:, None], np.arange(low[1], high[1])[None, :]
    away2 = ((i - centre[0]) ** 2 + (j - centre[1]) ** 2) / reach**2
    weight = np.clip(1.0 - away2, 0.0, None) * clearance[low[0] : high[0], low[1] : high[1]] ** 2
    total = weight.sum()
    if total <= 0.0:
        return p
    mean = np.array([(weight * i).sum(), (weight * j).sum()]) / total
    return np.asarray((grid.x0, grid.y0) + (mean + 0.5) * grid.cell)
