"""Free space in plan view: where a robot can be, what bounds it, and what was not seen.

One raster type for a dense map and for a few stacked keyframes, so that everything behind it is one piece of code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from maps import floor_cells as surface
from maps._numba_rays import FREE, UNKNOWN, WALL, march, mark_seen
from maps.floor_cells import Sight
from maps.grid import Grid, Points
from maps.ground import Ground, ground_of
from maps.settings import FreeSpaceSettings
from semmap.errors import CloudError
from semmap.geometry import Array

_CROSS = ndimage.generate_binary_structure(2, 1)
_EIGHT = ndimage.generate_binary_structure(2, 2)
_RAYS = 720
_BINS = 360
_THIN, _THIN_M = 0.8, 1.0
"""Floor is thinly sampled where fewer than this share of its cells, averaged over some metres, hold a point."""


@dataclass(frozen=True, slots=True)
class View:
    """One deskewed keyframe cloud.

    points : (n, 3) [m] in a gravity-aligned frame, z up, the same for all views that are stacked.
    p_sensor : (3,) where the LiDAR was in that frame [m].
    """

    points: Points
    p_sensor: Array


@dataclass(frozen=True, slots=True, eq=False)
class FreeSpace:
    """Plan view of a mine, or of the part of it that stacked keyframes saw.

    grid : where the raster lies.
    cells : (nx, ny) uint8, ``FREE`` roadway, ``WALL``, or ``UNKNOWN``.
    clearance : (nx, ny) distance from each free cell to the nearest one that is not free [m].
    ground : floor height.
    """

    grid: Grid
    cells: NDArray[np.uint8]
    clearance: Array
    ground: Ground

    @property
    def free(self) -> NDArray[np.bool_]:
        """Roadway, (nx, ny)."""
        return np.asarray(self.cells == FREE)

    def surface(self) -> surface.FreeSpace:
        """The same as cells that know their neighbours, until everything behind has moved over to them."""
        return surface.FreeSpace.from_raster(
            self.cells,
            self.ground.at(self.grid.centres(np.argwhere(self.cells < 3))).reshape(self.grid.shape),
            cell=self.grid.cell,
            corner=(self.grid.x0, self.grid.y0),
        )

    def clearance_at(self, p: Array) -> float:
        """Distance [m] from a point (2,) to the nearest cell that is not free."""
        return float(self.grid.sample(self.clearance, p[None])[0])

    def frontier(self) -> NDArray[np.bool_]:
        """Cells (nx, ny) beside free space and away from walls: there it was not seen how the roadway goes on."""
        beside = ndimage.binary_dilation(self.free, _EIGHT) & (self.cells == UNKNOWN)
        return np.asarray(beside & ~ndimage.binary_dilation(self.cells == WALL, _EIGHT))

    def sight(self, xy: Array, angle: Array, limit: float) -> Sight:
        """Look from points (n, 2) along angles (n,) [rad], up to ``limit`` [m]."""
        x, y = ((np.asarray(xy, dtype=np.float64) - (self.grid.x0, self.grid.y0)) / self.grid.cell).T.copy()
        distance, at_wall = np.empty(len(x)), np.empty(len(x), dtype=bool)
        angle = np.ascontiguousarray(angle, dtype=np.float64)
        march(self.cells, x, y, angle, limit / self.grid.cell, distance, at_wall)
        return Sight(distance * self.grid.cell, at_wall)


def split_ground_and_walls(points: Points, settings: FreeSpaceSettings) -> FreeSpace:
    """Free space of a dense cloud (n, 3), z up: floor that has head-room. Raises `CloudError` without a floor."""
    ground = ground_of(points, settings)
    grid = _fine_grid(ground.grid, settings)
    height = points[:, 2] - ground.at(points[:, :2])
    wall = grid.count(points[_in_band(height, settings), :2]) > 0
    floor = grid.count(points[np.abs(height) < settings.wall_from, :2]) > 0
    return _free_space(_closed(floor, settings) & ~wall, wall, grid, ground, settings)


def free_space_of_views(views: Sequence[View], settings: FreeSpaceSettings) -> FreeSpace:
    """Free space that the views saw together: the union of what is in sight of each.

    Raises `CloudError` where they show no floor.
    """
    points = np.concatenate([view.points for view in views]) if views else np.zeros((0, 3))
    owner = np.repeat(np.arange(len(views)), [len(view.points) for view in views])
    delta = points - np.array([view.p_sensor for view in views]).reshape(-1, 3)[owner]
    away = np.hypot(delta[:, 0], delta[:, 1])
    near = away < settings.view_range
    if not near.any():
        raise CloudError("shows nothing near the sensor", field="views")
    ground = ground_of(points[near & _may_be_floor(delta, away)], settings, around=points[near])
    grid = _fine_grid(ground.grid, settings)
    height = points[near, 2] - ground.at(points[near, :2])
    wall = grid.count(points[near][_in_band(height, settings), :2]) > 0
    free = np.zeros(grid.shape, dtype=bool)
    for view, reach in zip(views, _reach(delta, away, owner, len(views)), strict=True):
        x, y = (view.p_sensor[:2] - (grid.x0, grid.y0)) / grid.cell
        mark_seen(free, wall, x, y, np.minimum(reach, settings.view_range) / grid.cell)
    return _free_space(free & ~wall, wall, grid, ground, settings)


def _closed(floor: NDArray[np.bool_], settings: FreeSpaceSettings) -> NDArray[np.bool_]:
    """Floor without the holes that the sampling left: small ones, and wide ones where the floor is thinly sampled."""
    little, wide = (
        ndimage.binary_closing(floor, _CROSS, iterations=round(0.5 * gap / settings.cell))
        for gap in (settings.max_gap, settings.max_gap_sparse)
    )
    sigma = _THIN_M / settings.cell
    covered = ndimage.gaussian_filter(floor.astype(np.float32), sigma, truncate=2.0)
    all_of_it = ndimage.gaussian_filter(wide.astype(np.float32), sigma, truncate=2.0)
    return np.asarray(np.where(covered < _THIN * all_of_it, wide, little))


def _fine_grid(ground: Grid, settings: FreeSpaceSettings) -> Grid:
    """The floor's grid in finer cells."""
    factor = max(1, round(ground.cell / settings.cell))
    return Grid(ground.x0, ground.y0, ground.cell / factor, (ground.shape[0] * factor, ground.shape[1] * factor))


def _in_band(height: Array, settings: FreeSpaceSettings) -> NDArray[np.bool_]:
    return np.asarray((height > settings.wall_from) & (height < settings.wall_to))


def _may_be_floor(delta: Array, away: Array) -> NDArray[np.bool_]:
    """Points below their sensor by more than any roadway climbs on the way to them: (n,) bool."""
    return np.asarray(-delta[:, 2] > 0.3 - 0.3 * away)


def _reach(delta: Array, away: Array, owner: NDArray[np.int64], views: int) -> Array:
    """Longest horizontal distance (views, rays) [m] seen in each direction; 0 where nothing came back."""
    turn = np.arctan2(delta[:, 1], delta[:, 0]) / (2.0 * np.pi)
    bins = np.floor(turn * _BINS).astype(np.int64) % _BINS
    longest = np.zeros(views * _BINS)
    np.maximum.at(longest, owner * _BINS + bins, away)
    return np.repeat(longest.reshape(views, _BINS), _RAYS // _BINS, axis=1)


def _free_space(
    free: NDArray[np.bool_], wall: NDArray[np.bool_], grid: Grid, ground: Ground, settings: FreeSpaceSettings
) -> FreeSpace:
    """Free space without slivers, and without obstacles in it that are smaller than a pillar."""
    free = ndimage.binary_opening(free, _EIGHT)
    labels, count = ndimage.label(~free)
    area = np.bincount(labels.ravel(), minlength=count + 1) * grid.cell**2
    free |= (area < settings.max_clutter)[labels]
    cells = np.where(wall, np.uint8(WALL), np.uint8(UNKNOWN))
    cells[free] = FREE
    clearance = np.asarray(ndimage.distance_transform_edt(free)) * grid.cell
    return FreeSpace(grid, cells, clearance, ground)
