"""UWB ranges and prism fixes pin the track: they find odom's place in the map, and hold it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from localize.anchoring import Alignment
from localize.journal import Journal
from localize.odometry import Odometry, OdometryPose
from localize.prism import Clock, PrismPosition, start_from
from localize.ranging import Ranging
from localize.recent_motion import PointPath
from localize.settings import LocalizeSettings
from localize.sightings import Sighting, Sightings, align_moving, align_standing
from localize.start import StartingOdometry
from localize.track import Track
from localize.watch import ModeWatch
from semmap.geometry import Array, inverse, rotation_between, se3, transform
from semmap.measurements import PrismFix, UwbRange
from semmap.rig import Rig

_UP = np.array([0.0, 0.0, 1.0])
_ANYWHERE_M = 30.0
_ONE_CLOCK = 30
"""Fixes in the graph share the error of the total station's clock: each counts as if its variance were so many times as
large, or as many times as fixes are pinned at once."""
_CLOCK_OFF_S, _CLOCK_STD_S = 0.05, 0.01
"""A clock that is off by more, and known better, is worth telling."""
_SETTLING = 10
"""Steps of the graph from a place that an alignment found: ranges are bent, and it may be decimetres off."""


class SightingPins:
    """Shares ranges and fixes out between filter and graph, each counted once.

    Parameters
    ----------
    shift : (3,) subtracted from map coordinates.

    Attributes
    ----------
    sightings : those of the present leg.
    """

    def __init__(
        self, rig: Rig, settings: LocalizeSettings, track: Track, journal: Journal, watch: ModeWatch, shift: Array
    ) -> None:
        self.rig, self.settings = rig, settings
        self._track, self._journal, self._watch, self._shift = track, journal, watch, shift
        self._anchors_that_are: dict[str, set[int]] = {"blocked": set(), "silent": set()}
        self._clock = Clock(0.0, rig.total_station.time_offset_std if rig.total_station is not None else 0.0)
        self._odometry: StartingOdometry | None = None
        self._clock_told = False

    def begin_leg(self, odometry: StartingOdometry) -> None:
        """The odometry begins anew, wherever the robot is."""
        self._clock = self.clock
        self._odometry = odometry
        self.sightings = Sightings(self.rig, self.settings.sightings, self._shift, self._hidden)
        self._T_odom_unmoved = np.eye(4)

    @property
    def _engine(self) -> Odometry | None:
        """The odometry, once it has started."""
        return self._odometry.odometry if self._odometry is not None else None

    @property
    def clock(self) -> Clock:
        """The total station's, as far as it is known."""
        known = Clock.of(self._engine.filter) if self._engine is not None else None
        return known or self._clock

    def told_clock(self) -> dict[str, float] | None:
        """What is to be added to the total station's stamps and how well that is known, for a summary; None without."""
        if self.rig.total_station is None:
            return None
        return {"offset_s": self.rig.total_station.time_offset_s + self.clock.offset_s, "std_s": self.clock.std_s}

    @property
    def unknown_anchors(self) -> set[int]:
        """Ids heard that the rig has no anchor for."""
        return self.sightings.unknown_anchors

    def is_odometrys(self, measurement: UwbRange | PrismFix) -> bool:
        """Whether the filter takes it too: its share of them; and any fix while nobody knows where odom lies, which
        then tells it whether the machine stands."""
        shared = self.sightings.shared
        its_turn = self.sightings.add(measurement)
        return its_turn or (isinstance(measurement, PrismFix) and self.rig.total_station is not None and not shared)

    def take(self, pose: OdometryPose) -> None:
        """What was sighted until a pose pins the track, or finds its place."""
        self._T_odom_unmoved = pose.T_odom_imu @ inverse(self._track.unmoved)
        self._note_ranges()
        self._note_fixes()
        self._pin_or_align(pose)
        self._anchor_standing(pose)
        self._anchor_moving(pose)

    def _hidden(self, tags: Array, anchors: Array) -> NDArray[np.bool_]:
        """Between which tags and anchors (n, 3), in the odom that sightings come in, the LiDAR has seen rock."""
        engine, T = self._engine, self._T_odom_unmoved
        if engine is None or engine.map is None:
            return np.zeros(len(tags), np.bool_)
        return engine.map.hides(transform(T, tags), transform(T, anchors), engine.filter.state.T_odom_map)

    def _pin_or_align(self, pose: OdometryPose) -> None:
        sightings = self.sightings.reached(pose.stamp_ns, self._track.unmoved, pose.state.T_imu_tag[:3, 3], self.clock)
        if not sightings or self._track.newest is None:
            return
        if self._track.graph.anchored:
            for sighting in sightings:
                self._pin(sighting, pose)
            return
        R_level_odom = rotation_between(self._track.newest.up_odom, _UP)
        alignment = self.sightings.align(R_level_odom, pose.position_std, self._clock.std_s)
        if alignment is not None:
            T_map_odom = alignment.T_map_level @ se3(R_level_odom, np.zeros(3))
            self._track.anchor(T_map_odom, pose.stamp_ns, "ranges and fixes")
            if alignment.clock_std:
                self._clock = Clock(self._clock.offset_s + alignment.clock_offset, alignment.clock_std)
            kept = self.sightings.later(self.sightings.kept, alignment.clock_offset)
            seen = self.sightings.in_sight(kept, T_map_odom)
            for sighting in seen:
                self._pin(sighting, None, at_once=len(seen))
            self._pin_bent(alignment)
            self._found(pose, "ranges and fixes")

    def _pin_bent(self, alignment: Alignment) -> None:
        """Tell the graph, which thinks in the first order, what the ranges say in the second."""
        if alignment.bent is None:
            return
        graph, kept = self._track.graph, self.sightings.kept
        stamps = [stamp for stamp, _ in self._track.keyframes]
        index = max(0, int(np.searchsorted(stamps, kept[len(kept) // 2].stamp_ns, side="right")) - 1)
        along = np.outer(alignment.bent, alignment.bent)
        covariance = alignment.bent_std**2 * along + _ANYWHERE_M**2 * (np.eye(3) - along)
        graph.pin_position(index, np.zeros(3), graph.pose(index)[:3, 3], covariance)

    def _anchor_standing(self, pose: OdometryPose) -> None:
        """A machine that stands in sight of the total station and knows north (paper 002, static initialization)."""
        engine, standing = self._engine, self._odometry.standing if self._odometry is not None else None
        graph, keyframe = self._track.graph, self._track.newest
        found = standing.alignment() if standing is not None else None
        if engine is None or standing is None or found is None or keyframe is None or graph.anchored:
            return
        if not pose.keyframe:
            # a place to pin what is known now, however far odometry has slid meanwhile
            engine.keyframe_due = True
            return
        fixes = self.sightings.of_standing(standing.since_ns)
        if fixes is None:
            return
        R_level_odom, T_odom_imu = rotation_between(keyframe.up_odom, _UP), keyframe.T_odom_imu
        here = replace(fixes[1], p_odom=transform(T_odom_imu, standing.p_imu_prism[None])[0])
        alignment = align_standing(found, here, T_odom_imu, R_level_odom)
        newest, by = len(graph) - 1, "earth rate and fixes"
        self._track.anchor(alignment.T_map_level @ se3(R_level_odom, np.zeros(3)), pose.stamp_ns, by)
        graph.pin_heading(newest, graph.pose(newest), found.heading_std)
        stamps = [stamp for stamp, _ in self._track.keyframes]
        first = max(0, int(np.searchsorted(stamps, standing.since_ns)))
        for index, fix in ((min(first, newest), fixes[0]), (newest, fixes[1])):
            variance = fix.std**2 + self.settings.graph.drift_position**2
            graph.pin_position(index, standing.p_imu_prism, fix.p_map, variance * np.eye(3))
        self._found(pose, by)

    def _anchor_moving(self, pose: OdometryPose) -> None:
        """A machine whose LiDAR is blind, but which the total station sees drive: the INS/total-station filter starts
        the odometry (paper 002 II-B)."""
        engine, moving = self._engine, self._odometry.moving if self._odometry is not None else None
        graph, keyframe = self._track.graph, self._track.newest
        if engine is None or moving is None or keyframe is None or graph.anchored:
            return
        found = moving.place(pose.stamp_ns) if pose.dust or self.rig.lidar is None else None
        if found is None:
            return
        if not pose.keyframe:
            engine.keyframe_due = True
            return
        R_level_odom = rotation_between(keyframe.up_odom, _UP)
        T_map_level = align_moving(found, keyframe.T_odom_imu, R_level_odom)
        newest, by = len(graph) - 1, "INS and fixes on the way"
        self._track.anchor(T_map_level @ se3(R_level_odom, np.zeros(3)), pose.stamp_ns, by)
        graph.pin_heading(newest, found.state.T_map_imu, found.heading_std)
        graph.pin_position(newest, moving.p_imu_prism, found.p_map_prism, found.covariance)
        # where samples are cleaned a second at a time the odometry is further already, and has slid meanwhile
        now, state = moving.place(engine.filter.stamp_ns), engine.filter.state
        if now is not None:
            R_level_odom = rotation_between(-state.g, _UP)
            T_map_odom = align_moving(now, state.T_odom_imu, R_level_odom) @ se3(R_level_odom, np.zeros(3))
            self._share(engine, T_map_odom, np.zeros((6, 6)))
            start_from(engine.filter, now.state, now.clock_offset, 4.0 * now.P)
            if engine.map is not None:
                engine.map.begin()
        self._found(pose, by)

    def _found(self, pose: OdometryPose, by: str) -> None:
        self._track.graph.solve(steps=_SETTLING)
        self._track.solve()
        self.share_place()
        self._journal.enter("tracking", pose.stamp_ns, f"aligned by {by}")

    def share_place(self) -> None:
        """Tell the filter where odom lies, once: from then on it takes its part of ranges and fixes.

        It is told the graph's place at the last keyframe with twice its deviations. What the place was found by is
        counted in the graph; the filter needs it to begin with, and soon knows better by itself.
        """
        uwb, engine, at = self.rig.uwb, self._engine, self._track.at
        total_station = self.rig.total_station
        if (uwb is None and total_station is None) or engine is None or at is None or self.sightings.shared:
            return
        turned = np.kron(np.eye(2), at.T_map_imu[:3, :3])
        place = 4.0 * turned @ at.covariance @ turned.T
        # the place was found by the tag where the rig has it
        place[3:, 3:] += self.settings.odometry.extrinsics.tag.position_std**2 * np.eye(3)
        self._share(engine, self._track.T_map_odom(), place)

    def _share(self, engine: Odometry, T_map_odom: Array, covariance: Array) -> None:
        """Tell the filter where odom lies; ``covariance`` (6, 6) of the robot's place, in the map's axes."""
        uwb, station = self.rig.uwb, self.rig.total_station
        most = station.time_offset_std if station is not None else 0.0
        ranging = Ranging(uwb, self.sightings.anchors, self.settings.ranges) if uwb is not None else None
        # what the clock was found by is counted in the graph, too
        engine.locate(T_map_odom, covariance, ranging, Clock(self.clock.offset_s, min(2.0 * self.clock.std_s, most)))
        self.sightings.shared = True

    def _note_ranges(self) -> None:
        """What the filter thought of the ranges it was given."""
        engine = self._engine
        if engine is None or engine.ranging is None:
            return
        for reading, verdict in engine.judged:
            if not verdict.refused:
                self._watch.fitted("uwb", reading.anchor, reading.stamp_ns)
                continue
            off = {"off_m": verdict.innovation, "why": verdict.refused}
            self._journal.event(reading.stamp_ns, "range_refused", anchor=reading.anchor, **off)
        engine.judged.clear()
        self._note_anchors(engine.ranging, engine.filter.stamp_ns)

    def _note_fixes(self) -> None:
        """What the filter thought of the fixes it was given."""
        engine = self._engine
        for fix, outcome in engine.fixed if engine is not None else []:
            if outcome.used:
                self._watch.fitted("prism", None, fix.stamp_ns)
            else:
                self._journal.event(fix.stamp_ns, "prism_refused", anchor=None, off_m=outcome.off_m)
        if engine is not None:
            engine.fixed.clear()
            self._note_clock(engine.filter.stamp_ns)

    def _note_clock(self, stamp_ns: int) -> None:
        """A clock that is off, by so much that one should know, and for sure."""
        clock, station = self.clock, self.rig.total_station
        sure = clock.std_s < _CLOCK_STD_S and abs(clock.offset_s) > _CLOCK_OFF_S
        if sure and station is not None and not self._clock_told:
            mend = "set total_station.time_offset_s"
            self._journal.event(stamp_ns, "prism_clock_off", **(self.told_clock() or {}), mend=mend)
            self._clock_told = True

    def _note_anchors(self, ranging: Ranging, stamp_ns: int) -> None:
        """Anchors that became blocked, fell silent, or are heard again."""
        for kind, now in (("blocked", ranging.check.blocked), ("silent", ranging.check.silent(stamp_ns))):
            before = self._anchors_that_are[kind]
            for anchor in sorted(now ^ before):
                change = f"anchor_{kind}" if anchor in now else f"anchor_no_longer_{kind}"
                self._journal.event(stamp_ns, change, anchor=anchor)
            self._anchors_that_are[kind] = now
        if ranging.doubts > self._journal.counts["range_doubts"]:
            self._journal.event(stamp_ns, "ranges_contradict")
            self._journal.counts["range_doubts"] = ranging.doubts

    def _pin(self, sighting: Sighting, pose: OdometryPose | None, at_once: int = 1) -> None:
        """A range or fix as a factor on the keyframe before it; with the ``pose`` it came by, if it fits; or one of so
        many ``at_once``, which share the errors of way and clock."""
        graph, at = self._track.graph, self._track.at
        index, p_imu, way = self._from_keyframe(sighting, pose)
        predicted = transform(graph.pose(index), p_imu[None])[0]
        error = predicted - sighting.p_map
        distance = self._true_distance(sighting)
        off = abs(float(np.linalg.norm(error)) - distance)
        s, kind = self.settings.ranges, "prism" if sighting.anchor is None else "range"
        std, least = float(np.hypot(sighting.std, at.position_std if at is not None else 0.0)), s.min_gate
        if sighting.anchor is None:
            R = graph.pose(index)[:3, :3]
            along = self._along(sighting, index)
            least, std = s.min_prism_gate, float(np.sqrt(std**2 + np.trace(way) + along @ along))
            off, std = self._off_filter(sighting, pose, off, std)
        refused = {"anchor": sighting.anchor, "off_m": float(off)}
        # ranges that align odom fit at once, or not at all
        if (pose is not None or sighting.anchor is not None) and off > max(least, s.max_innovation * std):
            if pose is not None:  # events are in order of time
                self._journal.event(sighting.stamp_ns, f"{kind}_refused", **refused)
            return
        if sighting.anchor in self._anchors_that_are["blocked"]:
            self._journal.event(sighting.stamp_ns, "range_refused", **refused, why="blocked")
            return
        T_map_unmoved = graph.pose(index) @ inverse(self._track.leg.unmoved[index])
        if pose is not None and not self.sightings.in_sight([sighting], T_map_unmoved):
            self._journal.event(sighting.stamp_ns, "range_refused", **refused, why="rock")
            return
        if sighting.anchor is None:
            variance = sighting.std**2 * sighting.alike + self.settings.graph.drift_position**2
            by_clock = max(at_once, _ONE_CLOCK) * np.outer(along, along)
            by_way = at_once * (R @ way @ R.T)
            graph.pin_position(index, p_imu, sighting.p_map, variance * np.eye(3) + by_way + by_clock)
        else:
            noise = sighting.std * np.sqrt(sighting.alike)
            graph.pin_range(index, p_imu, sighting.anchor, sighting.p_map, distance, noise)
        self._watch.fitted("prism" if sighting.anchor is None else "uwb", sighting.anchor, sighting.stamp_ns)
        self._journal.counts["pins"] += 1
        self._track.dirty = True

    def _off_filter(self, fix: Sighting, pose: OdometryPose | None, off: float, std: float) -> tuple[float, float]:
        """How far a fix is off where the filter has the prism, and how well it knows that; it knows better than the
        graph, which may have begun with a wrong heading."""
        engine, station = self._engine, self.rig.total_station
        if pose is None or engine is None or station is None or engine.filter.state.T_map_odom is None:
            return off, std
        T_map_unmoved = engine.filter.state.T_map_odom @ self._T_odom_unmoved
        predicted = transform(T_map_unmoved, fix.p_odom[None])[0]
        model = PrismPosition(fix.p_map, PointPath.fixed(np.array(station.p_imu_prism)), fix.std)
        off = float(np.linalg.norm(predicted - fix.p_map))
        return off, float(np.hypot(fix.std, model.predicted_std(engine.filter)))

    def _along(self, fix: Sighting, index: int) -> Array:
        """What the clock may be off by puts a fix off by (3,), in the map [m]."""
        R_map_odom = self._track.graph.pose(index)[:3, :3] @ self._track.leg.unmoved[index][:3, :3].T
        return np.asarray(R_map_odom @ fix.v_odom * self.clock.std_s)

    def _from_keyframe(self, sighting: Sighting, pose: OdometryPose | None) -> tuple[int, Array, Array]:
        """The keyframe before a sighting, the sighted point (3,) in its axes, and what the way from there is off by:
        (3, 3), for a fix; of a range it is little beside the noise."""
        stamps = [stamp for stamp, _ in self._track.keyframes]
        index = max(0, int(np.searchsorted(stamps, sighting.stamp_ns, side="right")) - 1)
        p_imu = transform(inverse(self._track.leg.unmoved[index]), sighting.p_odom[None])[0]
        if sighting.anchor is not None:
            return index, p_imu, np.zeros((3, 3))
        if pose is not None and index == len(stamps) - 1 - pose.keyframe:
            T_keyframe_imu, covariance = pose.T_keyframe_imu, pose.since_keyframe
        elif index + 1 < len(stamps):
            # that of the whole way to the next keyframe, which is no less
            T_keyframe_imu, covariance = self._track.graph.link(index + 1)
        else:
            return index, p_imu, np.zeros((3, 3))
        R = T_keyframe_imu[:3, :3]
        return index, p_imu, R @ covariance[3:, 3:] @ R.T

    def _true_distance(self, sighting: Sighting) -> float:
        """As the filter has come to know the radios."""
        engine = self._engine
        if sighting.anchor is None or engine is None:
            return sighting.distance
        return engine.filter.true_distance(sighting.anchor, sighting.distance)
