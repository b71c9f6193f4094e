"""The floor and the roof around one place as small rasters: what the points there stand on, in any process."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from maps.free_space import FreeSpace
from maps.grid import Grid, Points
from semmap.geometry import Array

_CELL_M = 0.4
_BEYOND_M = 3.0
_SAME_FLOOR_M = 1.0
_BELOW_M, _OVER_ROOF_M, _ROOFLESS_M = 1.0, 1.0, 10.0
"""How far below the floor and above the roof a point still belongs to the level; above the floor without a roof."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorPatch:
    """One level around a place. Small, and pickles.

    grid : where the rasters lie.
    floor : (nx, ny) float32 height [m], carried on from the nearest floor beside it.
    roof : (nx, ny) float32 height [m], infinite where none was seen, -infinite more than three metres off the floor.
    """

    grid: Grid
    floor: NDArray[np.float32]
    roof: NDArray[np.float32]

    @classmethod
    def around(cls, p: Array, radius: float, space: FreeSpace) -> FloorPatch:
        """The level of ``p`` (3,) within ``radius`` [m], and up to three metres into the rock beside it.

        Where the floor winds over itself it is the turn nearest in height to ``p``.
        """
        cells = space.around(p, 2.0 * radius)
        plan, headroom = space.centres(cells), space.headroom[cells].astype(np.float64)
        near = np.abs(plan[:, :2] - p[:2]).max(axis=1, initial=0.0) <= radius + _CELL_M
        return cls._of_cells(plan[near], headroom[near], p, radius)

    @classmethod
    def _of_cells(cls, cells: Array, headroom: Array, p: Array, radius: float) -> FloorPatch:
        grid = Grid.around(np.array([p[:2]]), _CELL_M, margin=radius)
        owner, _ = grid.cells(cells[:, :2])
        off = np.abs(cells[:, 2] - p[2])
        least = np.full(grid.shape[0] * grid.shape[1], np.inf)
        np.minimum.at(least, owner, off)
        same = off <= least[owner] + _SAME_FLOOR_M
        owner, cells, headroom = owner[same], cells[same], headroom[same]
        count = np.bincount(owner, minlength=least.size)
        with np.errstate(invalid="ignore"):
            floor, roof = (
                (np.bincount(owner, height, minlength=least.size) / count).reshape(grid.shape)
                for height in (cells[:, 2], cells[:, 2] + headroom)
            )
        return cls(grid, *_widened(floor, roof))

    def heights(self, points: Points) -> Array:
        """Height (n,) of points (n, 3) above the floor [m]."""
        return np.asarray(points[:, 2] - self.grid.sample(self.floor.astype(np.float64), points[:, :2]))

    def on_level(self, points: Points) -> NDArray[np.bool_]:
        """Which points (n, 3) lie on this level: on its floor, walls or roof, or between."""
        cells, inside = self.grid.cells(points[:, :2])
        floor, roof = self.floor.ravel()[cells], self.roof.ravel()[cells]
        top = np.where(np.isinf(roof), floor + _ROOFLESS_M, roof + _OVER_ROOF_M)
        return np.asarray(inside & (points[:, 2] > floor - _BELOW_M) & (points[:, 2] < top))


def _widened(floor: Array, roof: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Floor and roof, NaN where there are none, with the nearest values beside them."""
    if np.isnan(floor).all():
        return np.zeros(floor.shape, np.float32), np.full(floor.shape, -np.inf, np.float32)
    away, nearest = ndimage.distance_transform_edt(np.isnan(floor), return_indices=True)
    over = np.where(away * _CELL_M <= _BEYOND_M, roof[tuple(nearest)], -np.inf)
    return floor[tuple(nearest)].astype(np.float32), over.astype(np.float32)
