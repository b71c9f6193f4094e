"""UWB ranges and prism fixes: what sees the robot from the map frame, tied to the odometry at their own time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from localize.anchoring import Alignment, align_fixes, align_ranges
from localize.settings import SightingSettings
from semmap.geometry import Array, interpolate_poses, transform
from semmap.measurements import PrismFix, UwbRange
from semmap.rig import Rig


@dataclass(frozen=True, slots=True)
class Sighting:
    """One range or fix with the place in odom of the point that was sighted.

    p_odom : (3,) tag or prism. anchor : id, or None for a prism fix. p_map : (3,) of the anchor or the prism.
    distance : measured range [m], 0 for a fix. std : [m].
    """

    stamp_ns: int
    p_odom: Array
    anchor: int | None
    p_map: Array
    distance: float
    std: float


class Sightings:
    """Holds ranges and fixes until the odometry has come by, and aligns odom with the map from them.

    shift : (3,) subtracted from map coordinates, so that everything beyond works with small numbers.
    """

    def __init__(self, rig: Rig, settings: SightingSettings, shift: Array) -> None:
        self.rig, self.settings = rig, settings
        self._anchors = {i: p - shift for i, p in rig.uwb.anchor_positions().items()} if rig.uwb else {}
        self._shift = shift
        self._waiting: deque[UwbRange | PrismFix] = deque()
        self._taken_ns: dict[int | None, int] = {}
        self._poses: deque[tuple[int, Array]] = deque(maxlen=100)
        self._kept: deque[Sighting] = deque(maxlen=settings.window)
        self._tried = 0
        self.unknown_anchors: set[int] = set()
        self.shared = False
        """Whether the filter takes every other range of an anchor."""
        self._filters_turn: dict[int, bool] = {}

    @property
    def anchors(self) -> dict[int, Array]:
        """Anchor id -> place (3,) in the shifted map."""
        return dict(self._anchors)

    def add(self, measurement: UwbRange | PrismFix) -> bool:
        """Take a range or fix in, or say that it is the filter's: each is counted once.

        What the rig has no block for, or no anchor, is left out.
        """
        if isinstance(measurement, UwbRange):
            if self.rig.uwb is None:
                return False
            if measurement.anchor not in self._anchors:
                self.unknown_anchors.add(measurement.anchor)
                return False
        elif self.rig.total_station is None:
            return False
        source = measurement.anchor if isinstance(measurement, UwbRange) else None
        since = measurement.stamp_ns - self._taken_ns.get(source, -(1 << 62))
        # readings of one source a moment apart share one error
        if 0 <= since < self.settings.interval_s * 1e9:
            return False
        self._taken_ns[source] = measurement.stamp_ns
        if source is not None and self.shared:
            self._filters_turn[source] = not self._filters_turn.get(source, False)
            if self._filters_turn[source]:
                return True
        self._waiting.append(measurement)
        return False

    def reached(self, stamp_ns: int, T_odom_imu: Array) -> list[Sighting]:
        """The odometry came to a pose: what was sighted until then."""
        self._poses.append((stamp_ns, T_odom_imu))
        ready = [m for m in self._waiting if m.stamp_ns <= stamp_ns]
        self._waiting = deque(m for m in self._waiting if m.stamp_ns > stamp_ns)
        ready = [m for m in ready if m.stamp_ns >= self._poses[0][0]]
        if not ready:
            return []
        stamps = np.array([stamp for stamp, _ in self._poses], np.int64)
        poses = np.array([pose for _, pose in self._poses])
        at = interpolate_poses(stamps, poses, np.array([m.stamp_ns for m in ready], np.int64))
        sightings = [self._sighting(m, T) for m, T in zip(ready, at, strict=True)]
        self._kept.extend(sightings)
        return sightings

    def _sighting(self, m: UwbRange | PrismFix, T_odom_imu: Array) -> Sighting:
        if isinstance(m, UwbRange):
            assert self.rig.uwb is not None
            tag = transform(T_odom_imu, np.array([self.rig.uwb.p_imu_tag]))[0]
            return Sighting(m.stamp_ns, tag, m.anchor, self._anchors[m.anchor], m.distance, self.rig.uwb.range_std)
        assert self.rig.total_station is not None
        prism = transform(T_odom_imu, np.array([self.rig.total_station.p_imu_prism]))[0]
        return Sighting(m.stamp_ns, prism, None, m.p_map - self._shift, 0.0, self.rig.total_station.point_std)

    @property
    def kept(self) -> list[Sighting]:
        """The last sightings, oldest first."""
        return list(self._kept)

    def align(self, R_level_odom: Array) -> Alignment | None:
        """Where gravity-levelled odom lies in the map, once the sightings tell it surely; None before."""
        if len(self._kept) < self._tried + 6:
            return None
        self._tried = len(self._kept)
        s = self.settings
        fixes = [sighting for sighting in self._kept if sighting.anchor is None]
        ranges = [sighting for sighting in self._kept if sighting.anchor is not None]
        for alignment in (_align_fixes(fixes, R_level_odom), _align_ranges(ranges, R_level_odom)):
            if alignment and alignment.sure(yaw_std=s.align_yaw_std, position_std=s.align_position_std):
                return alignment
        return None


def _align_fixes(fixes: list[Sighting], R_level_odom: Array) -> Alignment | None:
    if not fixes:
        return None
    p_odom, p_map = np.array([f.p_odom for f in fixes]), np.array([f.p_map for f in fixes])
    return align_fixes(p_odom @ R_level_odom.T, p_map, fixes[0].std)


def _align_ranges(ranges: list[Sighting], R_level_odom: Array) -> Alignment | None:
    if not ranges:
        return None
    p_odom, anchors = np.array([r.p_odom for r in ranges]), np.array([r.p_map for r in ranges])
    distances = np.array([r.distance for r in ranges])
    return align_ranges(p_odom @ R_level_odom.T, anchors, distances, ranges[0].std)
