"""Intersections in stacked keyframes, found and described by the geometry that builds the map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from maps.describe import contour_at
from maps.free_space import View, free_space_of_views
from maps.intersections import find_intersections
from maps.settings import MapSettings
from maps.topology import roadway_topology
from semmap.errors import CloudError
from semmap.geometry import Array
from semmap.intersections import WallContour


@dataclass(frozen=True, slots=True, eq=False)
class ObservedIntersection:
    """One intersection as stacked keyframes show it, in their frame.

    p : (3,) geometric invariant point on the floor [m].
    kind : ``L, T, Y, X`` or ``multi``, of the branches seen.
    branch_bearings : (b,) [rad], counter-clockwise from x, ascending in [0, 2π).
    branch_widths : (b,) [m].
    contour : PWCV and CWC as seen from ``p``.
    quality : share of the directions from ``p`` in which the view tells wall from open roadway, 0 to 1.
    """

    p: Array
    kind: str
    branch_bearings: Array
    branch_widths: Array
    contour: WallContour
    quality: float


def observe_intersections(
    views: Sequence[View], settings: MapSettings | None = None
) -> list[ObservedIntersection]:
    """Intersections that a few stacked keyframes show, the best seen first.

    views : deskewed keyframe clouds in one gravity-aligned frame (z up, any yaw, any origin near them).
    Views that show no floor, or no intersection, give an empty list.
    """
    settings = settings or MapSettings()
    try:
        space = free_space_of_views(views, settings.free_space)
    except CloudError:
        return []
    crossings = find_intersections(roadway_topology(space, settings.topology), space, settings.topology)
    points = np.concatenate([view.points for view in views])
    reach = settings.contour.radius + settings.contour.wall_depth
    seen = []
    for crossing in crossings:
        near = points[np.abs(points[:, :2] - crossing.p[:2]).max(axis=1) < reach]
        contour = contour_at(crossing.p, near, space, settings.contour)
        bearings = np.array([branch.bearing for branch in crossing.branches])
        widths = np.array([branch.width for branch in crossing.branches])
        quality = float(contour.pwcv_observed.mean())
        seen.append(ObservedIntersection(crossing.p, crossing.kind, bearings, widths, contour, quality))
    return sorted(seen, key=lambda one: -one.quality)
