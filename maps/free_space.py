"""Free space: the floor a robot can be over, on as many levels as there are, and what bounds it.

One type for a whole mine and for a few stacked keyframes, so that everything behind it is one piece of code. The floor
is a surface of square cells that know their neighbours: a ramp that passes over a drift, a spiral decline and stacked
levels are cells with the same plan position and different neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from maps import _numba_rays as raster
from maps._numba_floor import DI, DJ, UNKNOWN, WALL, find_cells, nearest_edges, reached, walk_rays
from semmap.geometry import Array

_EIGHT = ndimage.generate_binary_structure(2, 2)
_LEVEL_M = 1.5
"""A point is on a level whose floor is at most this far above or below it."""


@dataclass(frozen=True, slots=True)
class Sight:
    """What is in sight along horizontal rays.

    distance : (n,) to where free space ends [m], at most the limit asked for.
    at_wall : (n,) bool, the ray ends at a wall; if not, and before the limit, it ends where nothing was seen.
    """

    distance: Array
    at_wall: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class FreeSpace:
    """The floor of a mine, or of the part of it that stacked keyframes saw, as cells.

    cell : side of a cell [m].
    corner : (2,) float64, lower corner of cell (0, 0) [m].
    ij : (n, 2) int32, plan position of each cell; rows are sorted by i, j and height.
    height : (n,) float32, of the floor [m].
    headroom : (n,) float32, from floor to roof [m]; infinite where no roof was seen.
    neighbours : (n, 8) int32, row of the cell next door in the directions ``DI``, ``DJ``; ``WALL`` where there is a
        wall or nothing but a wall beside, ``UNKNOWN`` where it was not seen how the floor goes on. Mutual.
    clearance : (n,) float32, distance from cell centre to centre to the nearest cell that is not free, measured
        along the surface [m].
    """

    cell: float
    corner: Array
    ij: NDArray[np.int32]
    height: NDArray[np.float32]
    headroom: NDArray[np.float32]
    neighbours: NDArray[np.int32]
    clearance: NDArray[np.float32]

    @classmethod
    def of_cells(
        cls,
        cell: float,
        corner: ArrayLike,
        ij: NDArray[np.int32],
        height: NDArray[np.float32],
        headroom: NDArray[np.float32],
        neighbours: NDArray[np.int32],
    ) -> FreeSpace:
        """Cells sorted by i, j and height, with their clearance."""
        to_edge = np.empty((len(ij), 2), np.int16)
        nearest_edges(neighbours, to_edge)
        clearance = np.hypot(to_edge[:, 0], to_edge[:, 1], dtype=np.float32) * np.float32(cell)
        return cls(float(cell), np.asarray(corner, np.float64), ij, height, headroom, neighbours, clearance)

    @classmethod
    def from_raster(cls, cells: NDArray[np.uint8], height: Array, *, cell: float, corner: ArrayLike) -> FreeSpace:
        """One level without a roof, from rasters (nx, ny): cells FREE, WALL or UNKNOWN of `maps._numba_rays`, height.

        corner : (2,) lower corner of the raster [m]. Outside of it everything is unknown.
        """
        wall = ndimage.binary_dilation(cells == raster.WALL, _EIGHT)
        free = cells == raster.FREE
        rows = np.pad(np.where(wall, np.int32(WALL), np.int32(UNKNOWN)), 1, constant_values=UNKNOWN)
        ij = np.argwhere(free)
        rows[1:-1, 1:-1][free] = np.arange(len(ij), dtype=np.int32)
        around = (ij[:, 0, None] + 1 + DI) * rows.shape[1] + ij[:, 1, None] + 1 + DJ
        return cls.of_cells(
            cell,
            corner,
            ij.astype(np.int32),
            height[free].astype(np.float32),
            np.full(len(ij), np.inf, np.float32),
            rows.ravel()[around],
        )

    def __len__(self) -> int:
        return len(self.ij)

    def centres(self, rows: NDArray[np.integer]) -> Array:
        """Middles (k, 3) of cells on the floor [m]."""
        plan = self.corner + (self.ij[rows] + 0.5) * self.cell
        return np.column_stack([plan, self.height[rows]])

    def find(self, p: Array) -> NDArray[np.int64]:
        """Rows (m,) of the cells that points (m, 3) are in, nearest in height; -1 off the floor and far above it."""
        p = np.asarray(p, dtype=np.float64).reshape(-1, 3)
        rows = np.empty(len(p), np.int64)
        at = np.floor(self._in_cells(p)).astype(np.int64)
        find_cells(self.ij, self.height, at, np.ascontiguousarray(p[:, 2]), _LEVEL_M, rows)
        return rows

    def around(self, p: Array, radius: float) -> NDArray[np.int64]:
        """Rows (k,), ascending, within ``radius`` [m] of ``p`` (3,) in plan, reached from its cell over such cells.

        None where ``p`` is not on the floor.
        """
        start = int(self.find(p)[0])
        if start < 0:
            return np.zeros(0, np.int64)
        x, y = self._in_cells(np.reshape(p, (1, 3)))[0]
        return np.asarray(reached(self.ij, self.neighbours, start, x, y, radius / self.cell))

    def clearance_at(self, p: Array) -> float:
        """Distance [m] from a point (3,) on the floor to the nearest cell that is not free, linear between cells."""
        low = np.floor(self._in_cells(np.reshape(p, (1, 3)))[0] - 0.5)
        share = self._in_cells(np.reshape(p, (1, 3)))[0] - 0.5 - low
        corners = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
        plan = self.corner + (low + corners + 0.5) * self.cell
        rows = self.find(np.column_stack([plan, np.full(4, np.ravel(p)[2])]))
        weight = np.abs(1 - corners - share).prod(axis=1)
        return float(weight @ np.where(rows >= 0, self.clearance[rows], 0.0))

    def sight(self, p: Array, angle: Array, limit: float) -> Sight:
        """Look from points (n, 3) on the floor along angles (n,) [rad], up to ``limit`` [m]."""
        x, y = self._in_cells(np.asarray(p, dtype=np.float64)).T.copy()
        distance, at_wall = np.empty(len(x)), np.empty(len(x), dtype=bool)
        angle = np.ascontiguousarray(angle, dtype=np.float64)
        walk_rays(self.ij, self.neighbours, self.find(p), x, y, angle, limit / self.cell, distance, at_wall)
        return Sight(distance * self.cell, at_wall)

    def frontier(self) -> NDArray[np.bool_]:
        """Cells (n,) beyond which, away from walls, it was not seen how the roadway goes on."""
        return np.asarray((self.neighbours == UNKNOWN).any(axis=1))

    def _in_cells(self, p: Array) -> Array:
        """Plan coordinates (m, 2) of points in cells, from the corner."""
        return np.asarray((p[:, :2] - self.corner) / self.cell)
