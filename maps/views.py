"""Free space that a few stacked keyframes saw together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from maps._numba_rays import FREE, UNKNOWN, WALL, mark_seen
from maps.free_space import FreeSpace
from maps.grid import Grid, Points
from maps.ground import Ground, ground_of
from maps.settings import FreeSpaceSettings
from semmap.errors import CloudError
from semmap.geometry import Array

_EIGHT = ndimage.generate_binary_structure(2, 2)
_RAYS = 720
_BINS = 360


@dataclass(frozen=True, slots=True)
class View:
    """One deskewed keyframe cloud.

    points : (n, 3) [m] in a gravity-aligned frame, z up, the same for all views that are stacked.
    p_sensor : (3,) where the LiDAR was in that frame [m].
    """

    points: Points
    p_sensor: Array


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
    height = np.full(grid.shape, np.nan)
    height[free] = ground.at(grid.centres(np.argwhere(free)))
    return FreeSpace.from_raster(cells, height, cell=grid.cell, corner=(grid.x0, grid.y0))
