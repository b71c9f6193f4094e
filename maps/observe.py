"""Intersections in stacked keyframes, found and described by the geometry that builds the map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from maps.describe import contour_of, description_radius, look_round
from maps.floor_patch import FloorPatch
from maps.free_space import FreeSpace
from maps.intersections import Crossing, find_alternatives
from maps.settings import MapSettings, TopologySettings
from maps.sureness import CLOSE_CALL
from maps.topology import roadway_topology
from maps.views import View, free_space_of_views
from semmap.errors import CloudError
from semmap.geometry import Array
from semmap.intersections import WallContour

_LEAST_QUALITY = 0.4
"""What less is seen of all around is nothing to go by."""


@dataclass(frozen=True, slots=True, eq=False)
class ObservedIntersection:
    """One intersection as stacked keyframes show it, in their frame.

    p : (3,) geometric invariant point on the floor [m].
    kind : ``L, T, Y, X`` or ``multi``, of the branches seen.
    branch_bearings : (b,) [rad], counter-clockwise from x, ascending in [0, 2π).
    branch_widths : (b,) [m].
    contour : PWCV and CWC as seen from ``p``.
    quality : share of the directions from ``p`` in which the view tells wall from open roadway, 0 to 1.
    parts : the nodes of the view's own topology it is made of. Where it is a close call whether neighbouring nodes are
        one intersection or two there is a reading of each kind; readings that share a part exclude one another, and the
        one that matches the map best counts.
    """

    p: Array
    kind: str
    branch_bearings: Array
    branch_widths: Array
    contour: WallContour
    quality: float
    parts: frozenset[int]


def observe_intersections(views: Sequence[View], settings: MapSettings | None = None) -> list[ObservedIntersection]:
    """Intersections near a few stacked keyframes, the best seen first.

    views : deskewed keyframe clouds in one gravity-aligned frame (z up, any yaw, any origin near them).
    Views that show no floor, or no intersection, give an empty list.
    """
    settings = settings or MapSettings()
    try:
        space = free_space_of_views(views, settings.free_space)
    except CloudError:
        return []
    topology = _as_seen(settings.topology)
    crossings = find_alternatives(roadway_topology(space, topology), space, topology)
    sensors = np.array([view.p_sensor for view in views])
    near = [one for one in crossings if np.hypot(*(sensors - one.p)[:, :2].T).min() < settings.observe_range]
    if not near:
        return []
    surface = _on_floor(np.concatenate([view.points for view in views]), near, space, settings)
    seen = [_observed(one, surface, space, settings) for one in near]
    return sorted((one for one in seen if one.quality >= _LEAST_QUALITY), key=lambda one: -one.quality)


def _as_seen(settings: TopologySettings) -> TopologySettings:
    """The map's settings for views: they show less, so what just misses being a branch or a corner in a map is one.

    Into an opening one sees from before it only as far as its near corner allows; and of the leg behind a corner only
    the outer wall, so that the middle of what is seen leans towards the line of sight and the corner looks less sharp.
    """
    return settings.model_copy(
        update={
            "min_branch": settings.min_branch / CLOSE_CALL,
            "min_aspect": settings.min_aspect / CLOSE_CALL,
            "open_branch": settings.open_branch / CLOSE_CALL,
            "corner_deg": settings.corner_deg / CLOSE_CALL,
        }
    )


def _on_floor(points: Array, crossings: Sequence[Crossing], space: FreeSpace, settings: MapSettings) -> Array:
    """The points (n, 3) around some crossings, with their height above the floor in place of z."""
    p = np.array([crossing.p for crossing in crossings])
    spread = float(np.abs(p - p[0]).max())
    floor = FloorPatch.around(p[0], spread + description_radius(settings), space)
    points = points[floor.on_level(points)]
    return np.column_stack([points[:, :2], floor.heights(points)])


def _observed(crossing: Crossing, surface: Array, space: FreeSpace, settings: MapSettings) -> ObservedIntersection:
    sight = look_round(crossing.p, space, settings.contour)
    contour = contour_of(surface - [*crossing.p[:2], 0.0], sight, settings.contour)
    return ObservedIntersection(
        p=crossing.p,
        kind=crossing.kind,
        branch_bearings=np.array([branch.bearing for branch in crossing.branches]),
        branch_widths=np.array([branch.width for branch in crossing.branches]),
        contour=contour,
        quality=float(contour.pwcv_observed.mean()),
        parts=crossing.nodes,
    )
