"""What is stored of an intersection: its wall contours, the cloud around it, and how well it is seen.

A `Place` is all of the free space that takes; it is small and pickles, so that every intersection can be described
where its points are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from descriptors.settings import ContourSettings
from descriptors.wall_contour import ray_angles, wall_contour
from maps.floor_patch import FloorPatch
from maps.free_space import FreeSpace, Sight
from maps.grid import Points
from maps.intersections import Crossing
from maps.settings import MapSettings
from semmap.geometry import Array
from semmap.intersections import Intersection, WallContour

_HEADROOM_M = 2.0
"""The headroom of an intersection is the median within this of its point."""


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """An intersection and its surroundings.

    crossing : where and what it is.
    sight : along `descriptors.wall_contour.ray_angles` from its point.
    floor : the level around it, as far as `description_radius`.
    headroom : from floor to roof [m], infinite where no roof was seen.
    """

    crossing: Crossing
    sight: Sight
    floor: FloorPatch
    headroom: float


def description_radius(settings: MapSettings) -> float:
    """How far from its point in plan view the points lie that describe an intersection [m]."""
    return max(settings.cloud_radius, settings.contour.radius + settings.contour.wall_depth)


def place_of(crossing: Crossing, space: FreeSpace, settings: MapSettings) -> Place:
    """What `describe` needs to know of the free space around a crossing."""
    near = space.around(crossing.p, _HEADROOM_M)
    headroom = float(np.median(space.headroom[near])) if len(near) else np.inf
    floor = FloorPatch.around(crossing.p, description_radius(settings), space)
    return Place(crossing, look_round(crossing.p, space, settings.contour), floor, headroom)


def describe(number: int, place: Place, points: Points, origin: Array, settings: MapSettings) -> Intersection:
    """The intersection ``number`` of the map, from the points around it, in any order.

    points : (n, 3) relative to ``origin`` (3,) [m], at least all within `description_radius` of the crossing in plan;
        those farther off or on other levels are left out.
    """
    crossing = place.crossing
    points = points[place.floor.on_level(points)].astype(np.float64)
    delta = points[np.lexsort(points.T)] - crossing.p
    surface = np.column_stack([delta[:, :2], place.floor.heights(delta + crossing.p)])
    contour = contour_of(surface, place.sight, settings.contour)
    kept = delta[np.hypot(delta[:, 0], delta[:, 1]) < settings.cloud_radius]
    return Intersection(
        id=number,
        p_map=crossing.p + origin,
        kind=crossing.kind,
        branch_bearings=np.array([branch.bearing for branch in crossing.branches]),
        branch_widths=np.array([branch.width for branch in crossing.branches]),
        quality=crossing.sureness * completeness(contour, place.headroom, settings.contour),
        contour=contour,
        cloud=thinned(kept, settings.cloud_voxel),
    )


def look_round(p: Array, space: FreeSpace, settings: ContourSettings) -> Sight:
    """All that is in sight of ``p`` (3,) on the floor, up to the radius of the contours."""
    angles = ray_angles(settings)
    return space.sight(np.repeat(p[None], len(angles), axis=0), angles, settings.radius)


def contour_of(surface: Array, sight: Sight, settings: ContourSettings) -> WallContour:
    """Wall contours of a place.

    surface : (n, 3) the points around it: x and y relative to it, and height above the floor [m].
    """
    reach = settings.radius + settings.wall_depth
    near = surface[np.hypot(surface[:, 0], surface[:, 1]) < reach]
    return wall_contour(near, sight.distance, sight.at_wall, settings)


def completeness(contour: WallContour, headroom: float, settings: ContourSettings) -> float:
    """Share of the directions and of the height layers under the roof in which wall is told from open roadway."""
    under_roof = min(max((headroom - settings.layer_from) / settings.layer_height, 1.0), settings.layers)
    return float(contour.cwc_observed[: int(under_roof)].mean())


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
        """Points (k, 3) within ``radius`` [m] of ``p`` (3,) in plan view, float64."""
        low = np.floor((p[:2] - radius - self._low) / self._cell).astype(int)
        high = np.floor((p[:2] + radius - self._low) / self._cell).astype(int)
        rows = range(max(low[0], 0), high[0] + 1)
        columns = np.clip([low[1], high[1]], 0, self._columns - 1)
        runs = [np.searchsorted(self._sorted, row * self._columns + columns + (0, 1)) for row in rows]
        chosen = np.concatenate([self._order[a:b] for a, b in runs]) if runs else self._order[:0]
        near = self._points[np.sort(chosen)].astype(np.float64)
        return np.asarray(near[np.sum((near[:, :2] - p[:2]) ** 2, axis=1) < radius**2])
