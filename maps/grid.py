"""A horizontal grid of square cells: where a raster lies and which cell a point falls in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from semmap.errors import CloudError
from semmap.geometry import Array

Points: TypeAlias = NDArray[np.floating[Any]]
"""Coordinates of any float type."""

MAX_CELLS = 40_000_000
"""Of a floor raster; the free-space raster has a few times as many and must fit into memory."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Square cells over a horizontal rectangle; cell (i, j) covers x from ``x0 + i cell`` and y from ``y0 + j cell``.

    x0, y0 : lower corner [m].
    cell : side of a cell [m].
    shape : number of cells along x and y.
    """

    x0: float
    y0: float
    cell: float
    shape: tuple[int, int]

    @classmethod
    def around(cls, xy: Points, cell: float, margin: float) -> Grid:
        """Smallest grid that holds the points (n, 2) and ``margin`` [m] on every side.

        Raises `CloudError` where it would have too many cells: there are points far off the mine.
        """
        low, high = xy.min(axis=0) - margin, xy.max(axis=0) + margin
        low = np.floor(low / cell) * cell
        shape = np.ceil((high - low) / cell).astype(int) + 1
        if shape[0] * shape[1] > MAX_CELLS:
            size = " by ".join(f"{extent / 1000.0:.1f}" for extent in high - low)
            raise CloudError(f"stretches over {size} km", mend="remove stray points, or build the mine in parts")
        return cls(float(low[0]), float(low[1]), cell, (int(shape[0]), int(shape[1])))

    def coordinates(self, xy: Points) -> Array:
        """Real-valued cell coordinates (n, 2) of points (n, 2): the centre of cell (i, j) is (i, j)."""
        return (np.asarray(xy, dtype=np.float64) - (self.x0, self.y0)) / self.cell - 0.5

    def cells(self, xy: Points) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Flat cell number (n,) of points (n, 2), and which points lie inside (numbers of the others are 0)."""
        ij = np.floor((np.asarray(xy, dtype=np.float64) - (self.x0, self.y0)) / self.cell).astype(np.int64)
        inside = (ij[:, 0] >= 0) & (ij[:, 0] < self.shape[0]) & (ij[:, 1] >= 0) & (ij[:, 1] < self.shape[1])
        return np.where(inside, ij[:, 0] * self.shape[1] + ij[:, 1], 0), inside

    def centres(self, ij: NDArray[np.integer]) -> Array:
        """Centres (n, 2) [m] of cells (n, 2)."""
        return np.asarray((self.x0, self.y0) + (np.asarray(ij, dtype=np.float64) + 0.5) * self.cell)

    def sample(self, raster: Array, xy: Points) -> Array:
        """Values (n,) of a raster at points (n, 2), linear between cell centres, constant beyond the edge."""
        return np.asarray(map_coordinates(raster, self.coordinates(xy).T, order=1, mode="nearest"))

    def count(self, xy: Points) -> NDArray[np.int64]:
        """Number of points (n, 2) in each cell."""
        cells, inside = self.cells(xy)
        return np.bincount(cells[inside], minlength=self.shape[0] * self.shape[1]).reshape(self.shape)

    def lowest(self, points: Points) -> Array:
        """Lowest z of the points (n, 3) in each cell, +inf where there is none."""
        cells, inside = self.cells(points[:, :2])
        low = np.full(self.shape[0] * self.shape[1], np.inf)
        np.minimum.at(low, cells[inside], points[inside, 2].astype(np.float64))
        return low.reshape(self.shape)
