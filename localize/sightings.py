"""UWB ranges and prism fixes: what sees the robot from the map frame, tied to the odometry at their own time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from localize.anchoring import Alignment, Hidden, align_fixes, align_ranges
from localize.moving_start import MovingPlace
from localize.prism import Clock
from localize.settings import SightingSettings
from localize.static_alignment import StaticAlignment
from semmap.geometry import Array, interpolate_poses, inverse, se3, transform, yaw_of, yaw_rotation
from semmap.measurements import PrismFix, UwbRange
from semmap.rig import Rig

_NEW, _FEW = 6, 12
"""So many new sightings, or a tenth of the last ones, are worth another look; so few fixes may tell where odom lies."""
_ALL = 10
"""Times as many sightings are kept as the first alignment looks at: they are pinned once it is there."""
_LATE = 5.0
"""Intervals after which a fix is the first for a while."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """One range or fix with the place in odom of the point that was sighted.

    p_odom : (3,) tag or prism. anchor : id, or None for a prism fix. p_map : (3,) of the anchor or the prism.
    distance : measured range [m], 0 for a fix. std : [m]. alike : how many readings share one error.
    v_odom : (3,) how fast the point moved in odom, of a fix [m/s].
    """

    stamp_ns: int
    p_odom: Array
    anchor: int | None
    p_map: Array
    distance: float
    std: float
    alike: float = 1.0
    v_odom: Array = field(default_factory=lambda: np.zeros(3))

    def later(self, seconds: float) -> Sighting:
        """The same, of so much later [s]."""
        later_ns = round(seconds * 1e9)
        return replace(self, stamp_ns=self.stamp_ns + later_ns, p_odom=self.p_odom + seconds * self.v_odom)


class Sightings:
    """Holds ranges and fixes until the odometry has come by, and aligns odom with the map from them.

    shift : (3,) subtracted from map coordinates, so that everything beyond works with small numbers.
    hidden : tells of tags (n, 3) and anchors (n, 3), in the odom that sightings come in, between which there is rock.
    """

    def __init__(self, rig: Rig, settings: SightingSettings, shift: Array, hidden: Hidden) -> None:
        self.rig, self.settings, self._hidden = rig, settings, hidden
        self._anchors = {i: p - shift for i, p in rig.uwb.anchor_positions().items()} if rig.uwb else {}
        self._shift = shift
        self._waiting: deque[tuple[UwbRange | PrismFix, float]] = deque()
        self._taken_ns: dict[int | None, int] = {}
        self._poses: deque[tuple[int, Array]] = deque(maxlen=200)
        self._kept: deque[Sighting] = deque(maxlen=_ALL * settings.window)
        self._apart: deque[Sighting] = deque(maxlen=settings.window)
        """Of those kept, one of each source in an interval."""
        self._apart_ns: dict[int | None, int] = {}
        self._sighted, self._tried = 0, 0
        self.unknown_anchors: set[int] = set()
        self.shared = False
        """Whether the filter takes its part of ranges and fixes."""
        self._filters_last_ns: dict[int | None, int] = {}
        self._graph_had: dict[int | None, bool] = {}

    @property
    def anchors(self) -> dict[int, Array]:
        """Anchor id -> place (3,) in the shifted map."""
        return dict(self._anchors)

    def add(self, measurement: UwbRange | PrismFix) -> bool:
        """Take a range or fix in, or say that it is the filter's: each is counted once.

        What the rig has no block for, or no anchor, is left out. Readings of one source within ``interval_s`` share
        one error: all are used and count as one. Of fixes, before anything is anchored, one of them will do.
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
        since_s = (measurement.stamp_ns - self._taken_ns.get(source, -(1 << 62))) * 1e-9
        if source is None and not self.shared and 0.0 <= since_s < self.settings.interval_s:
            return False
        self._taken_ns[source] = measurement.stamp_ns
        if self.shared and self._is_filters_turn(source, measurement.stamp_ns):
            return True
        self._waiting.append((measurement, max(1.0, self.settings.interval_s / max(since_s, 1e-3))))
        return False

    def _is_filters_turn(self, anchor: int | None, stamp_ns: int) -> bool:
        """One reading of an anchor, or fix, per interval, and every other one where they come more slowly than that.

        A fix after a while without any is the filter's: before it has that, the way since the keyframe is not known
        well enough for a fix that is.
        """
        since_ns = stamp_ns - self._filters_last_ns.get(anchor, -(1 << 62))
        late = anchor is None and since_ns > _LATE * self.settings.interval_s * 1e9
        turn = late or (since_ns >= self.settings.interval_s * 1e9 and self._graph_had.get(anchor, False))
        self._graph_had[anchor] = not turn
        if turn:
            self._filters_last_ns[anchor] = stamp_ns
        return turn

    def reached(
        self, stamp_ns: int, T_odom_imu: Array, p_imu_tag: Array | None = None, clock: Clock | None = None
    ) -> list[Sighting]:
        """The odometry came to a pose: what was sighted until then.

        p_imu_tag : (3,) where it has found the tag to be; None takes the rig at its word. clock : the total station's.
        """
        self._poses.append((stamp_ns, T_odom_imu))
        waiting = [(m, alike, _when(m, clock or Clock())) for m, alike in self._waiting]
        ready = [one for one in waiting if self._poses[0][0] <= one[2] <= stamp_ns]
        self._waiting = deque((m, alike) for m, alike, when_ns in waiting if when_ns > stamp_ns)
        if not ready:
            return []
        stamps = np.array([stamp for stamp, _ in self._poses], np.int64)
        poses = np.array([pose for _, pose in self._poses])
        when = np.array([when_ns for _, _, when_ns in ready], np.int64)
        after = np.clip(np.searchsorted(stamps, when), 1, max(len(stamps) - 1, 1))
        sightings = [
            self._sighting(m, when_ns, T, poses[max(k - 1, 0) : k + 1], stamps[max(k - 1, 0) : k + 1], alike, p_imu_tag)
            for (m, alike, when_ns), T, k in zip(ready, interpolate_poses(stamps, poses, when), after, strict=True)
        ]
        self._kept.extend(sightings)
        for sighting in sightings:
            since_s = (sighting.stamp_ns - self._apart_ns.get(sighting.anchor, -(1 << 62))) * 1e-9
            if since_s >= self.settings.interval_s:
                self._apart_ns[sighting.anchor] = sighting.stamp_ns
                self._apart.append(sighting)
                self._sighted += 1
        return sightings

    def _sighting(
        self,
        m: UwbRange | PrismFix,
        stamp_ns: int,
        T_odom_imu: Array,
        around: Array,
        around_ns: NDArray[np.int64],
        alike: float,
        p_imu_tag: Array | None,
    ) -> Sighting:
        """With the pose of its time, and the poses (2, 4, 4) of the scans before and after it."""
        if isinstance(m, UwbRange):
            assert self.rig.uwb is not None
            p_imu = np.array(self.rig.uwb.p_imu_tag) if p_imu_tag is None else p_imu_tag
            tag = transform(T_odom_imu, p_imu[None])[0]
            std = self.rig.uwb.range_std
            return Sighting(m.stamp_ns, tag, m.anchor, self._anchors[m.anchor], m.distance, std, alike)
        assert self.rig.total_station is not None
        lever, std = np.array([self.rig.total_station.p_imu_prism]), self.rig.total_station.point_std
        moved = transform(around[-1], lever)[0] - transform(around[0], lever)[0]
        v = moved / max((around_ns[-1] - around_ns[0]) * 1e-9, 1e-3)
        return Sighting(stamp_ns, transform(T_odom_imu, lever)[0], None, m.p_map - self._shift, 0.0, std, alike, v)

    @property
    def kept(self) -> list[Sighting]:
        """The last sightings, oldest first."""
        return list(self._kept)

    def later(self, sightings: list[Sighting], seconds: float) -> list[Sighting]:
        """The same, with fixes that were so much later than their stamps say [s]; what was long ago, as it moved."""
        if not seconds or self.rig.total_station is None:
            return sightings
        stamps = np.array([stamp for stamp, _ in self._poses], np.int64)
        poses, lever = np.array([pose for _, pose in self._poses]), np.array([self.rig.total_station.p_imu_prism])
        moved = [one if one.anchor is not None else one.later(seconds) for one in sightings]
        when = np.array([one.stamp_ns for one in moved], np.int64)
        at = interpolate_poses(stamps, poses, when)
        return [
            replace(one, p_odom=transform(T, lever)[0])
            if one.anchor is None and stamps[0] <= one.stamp_ns <= stamps[-1]
            else one
            for one, T in zip(moved, at, strict=True)
        ]

    def align(self, R_level_odom: Array, odometry_std: float = 0.0, clock_std: float = 0.0) -> Alignment | None:
        """Where gravity-levelled odom lies in the map, once the sightings tell it surely; None before.

        odometry_std : how well odometry says it knows the place in odom [m]. clock_std : what the total station's clock
        may be off by, beyond what is known [s].
        """
        if self._sighted < self._tried + max(_NEW, len(self._apart) // 10):
            return None
        self._tried = self._sighted
        s = self.settings
        fixes = [sighting for sighting in self._apart if sighting.anchor is None]
        ranges = [sighting for sighting in self._apart if sighting.anchor is not None]
        # the fewer, the less odometry has slid since: once it did, all of them never fit again
        of_fixes = (
            self._aligned_by_fixes(fixes[-count:], R_level_odom, odometry_std, clock_std)
            for count in (_FEW, 2 * _FEW, len(fixes))
        )
        for alignment in (*of_fixes, self._align_ranges(ranges, R_level_odom)):
            if alignment and alignment.sure(yaw_std=s.align_yaw_std, position_std=s.align_position_std):
                return alignment
        return None

    def _aligned_by_fixes(
        self, fixes: list[Sighting], R_level_odom: Array, odometry_std: float, clock_std: float
    ) -> Alignment | None:
        """Twice where the clock is off: where the prism was then is known better than by its speed."""
        first = _align_fixes(fixes, R_level_odom, odometry_std, clock_std)
        if first is None or not first.clock_offset:
            return first
        fixes = self.later(fixes, first.clock_offset)
        again = _align_fixes(fixes, R_level_odom, odometry_std, clock_std)
        return again and replace(again, clock_offset=first.clock_offset + again.clock_offset)

    def _align_ranges(self, ranges: list[Sighting], R_level_odom: Array) -> Alignment | None:
        found = self._aligned_by(ranges, R_level_odom)
        if found is None:
            return None
        seen = self.in_sight(ranges, found.T_map_level @ se3(R_level_odom, np.zeros(3)))
        return found if len(seen) == len(ranges) else self._aligned_by(seen, R_level_odom)

    def in_sight(self, sightings: list[Sighting], T_map_odom: Array) -> list[Sighting]:
        """Those that did not come through rock, with odom at ``T_map_odom`` (4, 4): the others read too long."""
        ranges = [sighting for sighting in sightings if sighting.anchor is not None]
        if not ranges:
            return sightings
        at = transform(inverse(T_map_odom), np.array([sighting.p_map for sighting in ranges]))
        blocked = self._hidden(np.array([sighting.p_odom for sighting in ranges]), at)
        through = {id(sighting) for sighting, hit in zip(ranges, blocked, strict=True) if hit}
        return [sighting for sighting in sightings if id(sighting) not in through]

    def _aligned_by(self, ranges: list[Sighting], R_level_odom: Array) -> Alignment | None:
        if not ranges or self.rig.uwb is None:
            return None
        p_odom, anchors = np.array([r.p_odom for r in ranges]), np.array([r.p_map for r in ranges])
        distances = np.array([r.distance for r in ranges])

        def hidden(tags: Array, anchors: Array) -> NDArray[np.bool_]:
            return self._hidden(tags @ R_level_odom, anchors @ R_level_odom)

        p_level, uwb = p_odom @ R_level_odom.T, self.rig.uwb
        return align_ranges(p_level, anchors, distances, uwb.range_std, uwb.bias_std, hidden)

    def of_standing(self, since_ns: int) -> tuple[Sighting, Sighting] | None:
        """The kept fixes from a time on, during which the prism stood, as two: the first half and the rest."""
        fixes = [sighting for sighting in self._kept if sighting.anchor is None and sighting.stamp_ns >= since_ns]
        if len(fixes) < 2:
            return None
        half = len(fixes) // 2
        return _mean_fix(fixes[:half]), _mean_fix(fixes[half:])


def align_standing(found: StaticAlignment, fix: Sighting, T_odom_imu: Array, R_level_odom: Array) -> Alignment:
    """The place of gravity-levelled odom for a machine that stands and knows its heading and its prism's place."""
    R = yaw_rotation(yaw_of(found.R_map_imu) - yaw_of(R_level_odom @ T_odom_imu[:3, :3]))
    return Alignment(se3(R, fix.p_map - R @ R_level_odom @ fix.p_odom), found.heading_std, fix.std)


def align_moving(found: MovingPlace, T_odom_imu: Array, R_level_odom: Array) -> Array:
    """``T_map_level`` (4, 4) of gravity-levelled odom for a machine whose pose in the map is known."""
    R = yaw_rotation(yaw_of(found.state.R) - yaw_of(R_level_odom @ T_odom_imu[:3, :3]))
    return se3(R, found.state.p - R @ R_level_odom @ T_odom_imu[:3, 3])


def _mean_fix(fixes: list[Sighting]) -> Sighting:
    """One of some of a prism that stands; medians, for fixes of something else that shines."""
    p_odom, p_map = (np.median([getattr(fix, name) for fix in fixes], axis=0) for name in ("p_odom", "p_map"))
    return replace(fixes[-1], p_odom=p_odom, p_map=p_map, std=1.25 * fixes[-1].std / np.sqrt(len(fixes)), alike=1.0)


def _align_fixes(fixes: list[Sighting], R_level_odom: Array, odometry_std: float, clock_std: float) -> Alignment | None:
    if not fixes:
        return None
    p_odom, v_odom, p_map = (np.array([getattr(f, name) for f in fixes]) for name in ("p_odom", "v_odom", "p_map"))
    R = R_level_odom.T
    return align_fixes(p_odom @ R, p_map, fixes[0].std, odometry_std, v_odom @ R, clock_std)


def _when(m: UwbRange | PrismFix, clock: Clock) -> int:
    """Stamp on the robot's clock [ns]."""
    return clock.corrected_ns(m.stamp_ns) if isinstance(m, PrismFix) else m.stamp_ns
