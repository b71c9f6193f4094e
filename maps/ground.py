"""The floor as a height raster, from dense maps and from sparse stacked scans alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from maps.grid import Grid, Points
from maps.settings import FreeSpaceSettings
from semmap.errors import CloudError
from semmap.geometry import Array

_ENVELOPE_RADIUS_M = 3.0
_FLOOR_THICKNESS_M = 0.25
_STRAY_M, _COMMON_RANK = 0.5, 6
"""Deeper below the seventh lowest of the 25 cells around than this, a point is stray."""
_FILL_CELLS = ((1.0, 0.05), (4.0, 0.02))  # width of the mean, and the share of cells it must know


@dataclass(frozen=True, slots=True)
class Ground:
    """Height of the floor.

    grid : where the raster lies.
    height : (nx, ny) [m], filled from the nearest floor where none was seen.
    seen : (nx, ny) bool, where floor points are.
    """

    grid: Grid
    height: Array
    seen: NDArray[np.bool_]

    def at(self, xy: Points) -> Array:
        """Floor height (n,) [m] under points (n, 2), linear between cell centres."""
        return self.grid.sample(self.height, xy)


def ground_of(points: Points, settings: FreeSpaceSettings, *, around: Points | None = None) -> Ground:
    """Floor under a cloud (n, 3), z up: the lowest surface that is nowhere steeper than a roadway.

    The raster covers ``around`` (m, 3), the cloud itself by default. Raises `CloudError` where nothing looks like a
    floor.
    """
    if not len(points):
        raise CloudError("shows no floor", mend="check that z points up and the floor was scanned")
    grid = Grid.around((points if around is None else around)[:, :2], settings.ground_cell, margin=2.0)
    low = _lowest(points, grid)
    seen = np.isfinite(low) & (low <= _lower_envelope(low, grid.cell, settings.max_slope) + _FLOOR_THICKNESS_M)
    seen &= ~_stands_upright(points, grid, low)
    if not seen.any():
        raise CloudError("shows no floor", mend="check that z points up and the floor was scanned")
    return Ground(grid, _filled(low, seen), seen)


def _lowest(points: Points, grid: Grid) -> Array:
    """Lowest z of the points in each cell, less those far below what the neighbours have: reflections, not floor."""
    low = grid.lowest(points)
    common = ndimage.rank_filter(low, _COMMON_RANK, size=5, mode="constant", cval=np.inf)
    limit = np.where(np.isfinite(common), common - _STRAY_M, -np.inf)
    if not (low < limit).any():
        return low
    cells, inside = grid.cells(points[:, :2])
    return grid.lowest(points[inside & (points[:, 2] >= limit.ravel()[cells])])


def _lower_envelope(low: Array, cell: float, slope: float) -> Array:
    """Highest surface below ``low`` that rises by at most ``slope`` within a few metres."""
    reach = np.arange(-int(_ENVELOPE_RADIUS_M / cell), int(_ENVELOPE_RADIUS_M / cell) + 1) * cell
    distance = np.hypot(*np.meshgrid(reach, reach, indexing="ij"))
    return np.asarray(ndimage.grey_erosion(low, footprint=distance <= _ENVELOPE_RADIUS_M, structure=-slope * distance))


def _stands_upright(points: Points, grid: Grid, low: Array) -> NDArray[np.bool_]:
    """Cells where points fill the first metre above the lowest one: walls, seen or not down to the floor."""
    cells, inside = grid.cells(points[:, :2])
    above = points[:, 2] - low.ravel()[cells]
    in_band = inside & (above > _FLOOR_THICKNESS_M + 0.2 * grid.cell) & (above < 1.2)
    return np.bincount(cells[in_band], minlength=low.size).reshape(low.shape) > 0


def _filled(low: Array, seen: NDArray[np.bool_]) -> Array:
    """Heights smoothed where seen, and carried on where not: by ever wider means, at last from the nearest floor."""
    weight, value = seen.astype(np.float64), np.where(seen, low, 0.0)
    height, known = np.zeros_like(value), np.zeros_like(seen)
    for sigma, least in _FILL_CELLS:
        mass = ndimage.gaussian_filter(weight, sigma, truncate=3.0)
        mean = ndimage.gaussian_filter(value, sigma, truncate=3.0) / np.maximum(mass, 1e-9)
        height, known = np.where(known, height, mean), known | (mass > least)
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(height[tuple(nearest)])
