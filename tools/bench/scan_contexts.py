"""Scan Context of the same intersections from the same clouds, made up in several ways so that its best can be told.

Heights count from the floor. The centre is where the sensor is, or, as a gift, the invariant point that the wall
contours are made around. The map's cloud is taken as it is, or only what a LiDAR over the invariant point would see of
it. All heights count, or only those up to a man's, which every view shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from descriptors.scan_context import ScanContextSettings, context_distance, scan_context
from maps.observe import ObservedIntersection
from semmap.geometry import Array
from semmap.intersections import SemanticMap
from tools.bench.views import Approach
from tools.simulator.rigs import default_rig
from tools.simulator.settings import MotionSettings

_SETTINGS = ScanContextSettings(max_range=15.0, sensor_height=0.5)
"""The map keeps fifteen metres around each intersection."""
_BAND = (0.3, 2.3)
_PIXEL_RAD, _BEHIND_M = np.radians(2.0), 0.5
"""A point this much farther than the nearest in its direction is hidden."""


@dataclass(frozen=True, slots=True)
class Variant:
    """One way to make the contexts: centred on the point or the sensor, map as seen or whole, a band or all heights."""

    at_point: bool
    as_seen: bool
    band: bool

    def __str__(self) -> str:
        centre, cloud = ("point" if self.at_point else "sensor"), ("seen" if self.as_seen else "whole")
        return f"{centre}, {cloud}, {'band' if self.band else 'all heights'}"


VARIANTS = tuple(Variant(*(bool(number >> bit & 1) for bit in range(3))) for number in range(8))


class ScanContexts:
    """Contexts of all intersections of a map, in every variant."""

    def __init__(self, there: SemanticMap) -> None:
        self._stored = {
            (as_seen, band): [_context(_seen(one.cloud) if as_seen else one.cloud, band) for one in there.intersections]
            for as_seen in (False, True)
            for band in (False, True)
        }

    def similarities(self, view: Approach, seen: ObservedIntersection | None) -> Array:
        """One less the distance (variants, n) of a view to each intersection; 0 around a point that was not seen."""
        points = np.concatenate([one.points for one in view.views]).astype(np.float64)
        below = [0.0, 0.0, MotionSettings().height]
        queries = {
            (at_point, band): None if centre is None else _context(points - centre, band)
            for at_point, centre in ((True, None if seen is None else seen.p), (False, view.views[-1].p_sensor - below))
            for band in (False, True)
        }
        return np.array([_row(queries[v.at_point, v.band], self._stored[v.as_seen, v.band]) for v in VARIANTS])


def _row(query: NDArray[np.float32] | None, stored: list[NDArray[np.float32]]) -> Array:
    if query is None:
        return np.zeros(len(stored))
    return np.array([1.0 - context_distance(query, one)[0] for one in stored])


def _context(points: NDArray[np.floating], band: bool) -> NDArray[np.float32]:
    """Context of points (n, 3) relative to a point on the floor."""
    kept = (points[:, 2] > _BAND[0]) & (points[:, 2] < _BAND[1]) if band else slice(None)
    return scan_context(np.asarray(points[kept], dtype=np.float64), _SETTINGS)


def _seen(cloud: NDArray[np.floating]) -> NDArray[np.floating]:
    """The points (k, 3) of a cloud that a LiDAR at the height of a robot over its zero sees."""
    block = default_rig().lidar
    assert block is not None
    delta = cloud - [0.0, 0.0, MotionSettings().height]
    away = np.hypot(delta[:, 0], delta[:, 1])
    up, turn = np.arctan2(delta[:, 2], away), np.arctan2(delta[:, 1], delta[:, 0])
    low, high = np.radians(block.fov_deg)
    width = int(np.ceil(2.0 * np.pi / _PIXEL_RAD))
    pixel = (np.floor(up / _PIXEL_RAD) + width).astype(np.int64) * width + np.floor(turn / _PIXEL_RAD).astype(np.int64)
    pixel -= pixel.min(initial=0)
    nearest = np.full(pixel.max(initial=0) + 1, np.inf)
    np.minimum.at(nearest, pixel, away)
    return np.asarray(cloud[(up > low) & (up < high) & (away < nearest[pixel] + _BEHIND_M)])
