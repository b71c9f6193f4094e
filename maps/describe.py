"""What is stored of an intersection: its wall contours and the cloud around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from descriptors.settings import ContourSettings
from descriptors.wall_contour import ray_angles, wall_contour
from maps.free_space import FreeSpace
from maps.grid import Points
from semmap.geometry import Array
from semmap.intersections import WallContour

_BELOW_M, _ABOVE_M = 3.0, 10.0


def on_floor(points: Points, space: FreeSpace) -> Array:
    """The points (n, 3) with their height above the floor in place of z."""
    return np.column_stack([points[:, :2], points[:, 2] - space.ground.at(points[:, :2])])


def contour_at(p: Array, surface: Array, space: FreeSpace, settings: ContourSettings) -> WallContour:
    """Wall contours as seen from ``p`` (3,) in free space.

    surface : (n, 3) the points around it, x, y and height above the floor, see `on_floor`.
    """
    angles = ray_angles(settings)
    sight = space.sight(np.repeat(p[None, :2], len(angles), axis=0), angles, settings.radius)
    return wall_contour(surface - [p[0], p[1], 0.0], sight.distance, sight.at_wall, settings)


def thinned(points: Points, voxel: float) -> NDArray[np.float32]:
    """Means (m, 3) of the points (n, 3) in each voxel [m], in the order of the voxels."""
    keys = np.floor(points / voxel).astype(np.int64)
    keys -= keys.min(axis=0, initial=0)
    size = keys.max(axis=0, initial=0) + 1
    flat = (keys[:, 0] * size[1] + keys[:, 1]) * size[2] + keys[:, 2]
    _, owner = np.unique(flat, return_inverse=True)
    count = np.bincount(owner)
    means = [np.bincount(owner, points[:, axis]) / count for axis in range(3)]
    return np.stack(means, axis=-1).astype(np.float32)


class Neighbourhoods:
    """Points of a map by place: those around a point are found without a look at all of them.

    Parameters
    ----------
    points : (n, 3) [m]. cell : side of the squares the points are sorted into [m].
    """

    def __init__(self, points: Points, cell: float = 5.0) -> None:
        self._low = points[:, :2].min(axis=0).astype(np.float64)
        self._cell = cell
        cells = np.floor((points[:, :2] - self._low) / cell).astype(np.int64)
        self._columns = int(cells[:, 1].max()) + 1
        flat = cells[:, 0] * self._columns + cells[:, 1]
        self._order = np.argsort(flat, kind="stable")
        self._sorted = flat[self._order]
        self._points = points

    def around(self, p: Array, radius: float) -> Array:
        """Points (k, 3) within ``radius`` [m] of ``p`` (3,) in plan view and on its level, float64."""
        low = np.floor((p[:2] - radius - self._low) / self._cell).astype(int)
        high = np.floor((p[:2] + radius - self._low) / self._cell).astype(int)
        rows = range(max(low[0], 0), high[0] + 1)
        columns = np.clip([low[1], high[1]], 0, self._columns - 1)
        runs = [np.searchsorted(self._sorted, row * self._columns + columns + (0, 1)) for row in rows]
        chosen = np.concatenate([self._order[a:b] for a, b in runs]) if runs else self._order[:0]
        near = self._points[np.sort(chosen)].astype(np.float64)
        rise = near[:, 2] - p[2]
        inside = (np.sum((near[:, :2] - p[:2]) ** 2, axis=1) < radius**2) & (rise > -_BELOW_M) & (rise < _ABOVE_M)
        return np.asarray(near[inside])
