"""The online way of paper 004: measurements in, a pose in the map out, at every scan."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from localize.graph import PoseGraph
from localize.keyframes import Keyframe, Keyframes
from localize.matcher import IntersectionMatcher, Recognition
from localize.odometry import OdometryPose
from localize.prism import PrismPosition
from localize.ranging import Ranging
from localize.results import Event, LocalizationResult, State, Update
from localize.settings import LocalizeSettings
from localize.sightings import Sighting, Sightings, align_standing
from localize.smoothing import smoothed
from localize.start import StartingOdometry
from localize.watch import ModeWatch
from semmap.geometry import Array, adjoint, inverse, rotation_between, se3, transform
from semmap.intersections import SemanticMap
from semmap.measurements import Measurement, PrismFix, UwbRange
from semmap.rig import Rig
from semmap.trajectory import Trajectory

_UP = np.array([0.0, 0.0, 1.0])
_ROUND_M = 1000.0
"""Map coordinates are worked with relative to a multiple of this."""


class Localizer:
    """Localizes one robot against a semantic map; the same object serves a file, a live feed and a test.

    Parameters
    ----------
    rig : the sensors; blocks that are absent are not used.
    semantic_map : the database, or None for odometry (with UWB or a total station in the rig: in the map all the same).
    settings : `LocalizeSettings`.

    What enters where, each measurement once:

    ==============  ======================  ==========================================
    measurement     filter                  graph
    ==============  ======================  ==========================================
    IMU             propagation             -
    LiDAR scan      point to local map      - (its effect comes as relative poses)
    wheel speed     velocity at the wheel   - (likewise)
    UWB range       one of an anchor in     the others, those of a moment as one; one in
                    half a second, once     half a second until then (they align odom
                    the map is known        with the map)
    prism fix       one in half a second,   the others, likewise; where the machine
                    once the map is known;  knows north standing, its heading
                    until then: it stands
    intersection    -                       pose from ICP to the database's cloud
    ==============  ======================  ==========================================
    """

    def __init__(
        self, rig: Rig, semantic_map: SemanticMap | None = None, settings: LocalizeSettings | None = None
    ) -> None:
        self.rig, self.settings = rig, settings or LocalizeSettings()
        self._shift = _round_origin(rig, semantic_map)
        s = self.settings
        self._odometry = StartingOdometry(rig, s.odometry, s.keyframes, denoise=s.denoise, prism=s.prism)
        self._keyframes = Keyframes(self.settings.keyframes)
        self._graph = PoseGraph(self.settings.graph)
        self._sightings = Sightings(rig, self.settings.sightings, self._shift)
        self._matcher = IntersectionMatcher(semantic_map, self.settings, self._shift) if semantic_map else None
        self._referenced = semantic_map is not None or rig.uwb is not None or rig.total_station is not None
        self._newest: Keyframe | None = None
        self._covariance = np.eye(6)
        self._state: State = "unknown"
        self._odometry_track: list[tuple[int, Array]] = []
        self._realtime_track: list[tuple[int, Array]] = []
        self._keyframe_track: list[tuple[int, Array]] = []
        self._events: list[Event] = []
        self._counts: dict[str, int] = {
            "scans": 0,
            "keyframes": 0,
            "intersections_seen": 0,
            "pins": 0,
            "range_doubts": 0,
        }
        self._anchors_that_are: dict[str, set[int]] = {"blocked": set(), "silent": set()}
        self._recognised: set[int] = set()
        self._watch = ModeWatch(self.settings, lidar=rig.lidar is not None)
        self._pins_dirty = False

    def add(self, measurement: Measurement) -> Update | None:
        """Take one measurement in, in order of arrival; returns an update when a scan was completed by it."""
        if isinstance(measurement, UwbRange | PrismFix) and not self._is_odometrys(measurement):
            return None
        if isinstance(measurement, PrismFix):
            measurement = PrismFix(measurement.stamp_ns, measurement.p_map - self._shift)
        update = None
        for pose in self._odometry.add(measurement):
            update = self._reached(pose)
        return update

    @property
    def scans(self) -> int:
        """Poses that became known so far."""
        return self._counts["scans"]

    def _is_odometrys(self, measurement: UwbRange | PrismFix) -> bool:
        """Whether the filter takes it too: its share of them; and any fix while nobody knows where odom lies, which
        then tells it whether the machine stands."""
        shared = self._sightings.shared
        its_turn = self._sightings.add(measurement)
        return its_turn or (isinstance(measurement, PrismFix) and self.rig.total_station is not None and not shared)

    def finish(self) -> LocalizationResult:
        """End the run: smooth the whole track and hand everything over."""
        for pose in self._odometry.finish():
            self._reached(pose)
        odometry = _trajectory("odom", self._odometry_track)
        frame = "map" if self._referenced else "odom"
        trajectory = odometry
        if self._graph.anchored:
            keyframe_poses = _shifted(self._graph.poses(), self._shift)
            trajectory = smoothed(odometry, np.array([s for s, _ in self._keyframe_track], np.int64), keyframe_poses)
        elif self._referenced:
            trajectory = _trajectory("map", [])
        realtime = _trajectory(frame, self._realtime_track)
        return LocalizationResult(
            trajectory, realtime, odometry, tuple(self._events), self._summary(), tuple(self._watch.uncertainty)
        )

    def _reached(self, pose: OdometryPose) -> Update:
        """The steps of paper 004 section 3 for one scan."""
        self._odometry_track.append((pose.stamp_ns, pose.T_odom_imu))
        self._counts["scans"] += 1
        if pose.keyframe:
            self._newest = self._add_keyframe(pose)
            self._recognise_intersection(self._newest)
        self._note_ranges()
        self._note_fixes()
        self._take_sightings(pose)
        self._anchor_standing(pose)
        if self._pins_dirty:
            self._solve()
            self._share_place()
        self._note_mode(pose)
        update = self._publish(pose)
        self._watch.note_uncertainty(pose, update)
        return update

    def _add_keyframe(self, pose: OdometryPose) -> Keyframe:
        keyframe = self._keyframes.add(pose)
        self._graph.add_keyframe(
            keyframe.T_odom_imu, keyframe.up_odom, pose.T_keyframe_imu, self._link_covariance(pose), pose.up_std
        )
        self._keyframe_track.append((keyframe.stamp_ns, keyframe.T_odom_imu))
        self._counts["keyframes"] += 1
        if self._graph.anchored:
            self._pins_dirty = True
        return keyframe

    def _link_covariance(self, pose: OdometryPose) -> Array:
        """Covariance of the pose relative to the last keyframe, such that a chain of them adds up honestly.

        The filter's own is right for one link (measured on rough and smooth walls), but one link's error in position
        tends to be the next one's as well: along a smooth drift nearly the whole error goes one way.
        """
        g = self.settings.graph
        drift = np.repeat([g.drift_rotation, g.drift_position], 3) ** 2
        stretch = np.repeat([1.0, np.sqrt(g.link_correlation)], 3)
        covariance: Array = pose.since_keyframe * np.outer(stretch, stretch) + np.diag(drift)
        return covariance

    def _recognise_intersection(self, keyframe: Keyframe) -> None:
        if self._matcher is None:
            return
        guess = self._T_map_odom() if self._graph.anchored else None
        std = float(np.sqrt(np.trace(self._covariance[3:, 3:]))) if guess is not None else np.inf
        recognition = self._matcher.recognise(self._keyframes.stack(), keyframe, guess, std)
        self._events.extend(recognition.events)
        self._counts["intersections_seen"] += recognition.seen
        if recognition.contradicts and self._state == "tracking":
            self._set_state("suspect", keyframe.stamp_ns, "an intersection fits elsewhere")
        if recognition.pins:
            self._pin_intersection(recognition)

    def _pin_intersection(self, recognition: Recognition) -> None:
        if not self._graph.anchored:
            last = recognition.pins[-1]
            stamp_ns, T_odom_imu = self._keyframe_track[last.keyframe]
            self._anchor(last.T_map_imu @ inverse(T_odom_imu), stamp_ns, "intersection")
        for pin in recognition.pins:
            self._graph.pin_pose(pin.keyframe, pin.T_map_imu, pin.covariance)
            self._recognised.add(pin.intersection)
            self._counts["pins"] += 1
        self._pins_dirty = True
        self._set_state("tracking", self._keyframe_track[-1][0], "intersection proven")

    def _take_sightings(self, pose: OdometryPose) -> None:
        sightings = self._sightings.reached(pose.stamp_ns, pose.T_odom_imu)
        if not sightings or self._newest is None:
            return
        if self._graph.anchored:
            for sighting in sightings:
                self._pin_sighting(sighting, pose)
            return
        R_level_odom = rotation_between(self._newest.up_odom, _UP)
        alignment = self._sightings.align(R_level_odom, pose.position_std)
        if alignment is not None:
            self._anchor(alignment.T_map_level @ se3(R_level_odom, np.zeros(3)), pose.stamp_ns, "ranges and fixes")
            for sighting in self._sightings.kept:
                self._pin_sighting(sighting, None)
            self._found(pose, "ranges and fixes")

    def _anchor_standing(self, pose: OdometryPose) -> None:
        """A machine that stands in sight of the total station and knows north (paper 002, static initialization)."""
        engine, standing = self._odometry.odometry, self._odometry.standing
        found = standing.alignment() if standing is not None else None
        if engine is None or standing is None or found is None or self._graph.anchored:
            return
        if not pose.keyframe:
            # a place to pin what is known now, however far odometry has slid meanwhile
            engine.keyframe_due = True
            return
        fixes = self._sightings.of_standing(standing.since_ns)
        if fixes is None:
            return
        R_level_odom = rotation_between(-pose.state.g, _UP)
        here = replace(fixes[1], p_odom=transform(pose.T_odom_imu, standing.p_imu_prism[None])[0])
        alignment = align_standing(found, here, pose.T_odom_imu, R_level_odom)
        newest, by = len(self._graph) - 1, "earth rate and fixes"
        self._anchor(alignment.T_map_level @ se3(R_level_odom, np.zeros(3)), pose.stamp_ns, by)
        self._graph.pin_heading(newest, self._graph.pose(newest), found.heading_std)
        first = max(0, int(np.searchsorted([stamp for stamp, _ in self._keyframe_track], standing.since_ns)))
        for index, fix in ((min(first, newest), fixes[0]), (newest, fixes[1])):
            variance = fix.std**2 + self.settings.graph.drift_position**2
            self._graph.pin_position(index, standing.p_imu_prism, fix.p_map, variance * np.eye(3))
        self._found(pose, by)

    def _found(self, pose: OdometryPose, by: str) -> None:
        self._solve()
        self._share_place()
        self._set_state("tracking", pose.stamp_ns, f"aligned by {by}")

    def _share_place(self) -> None:
        """Tell the filter where odom lies, once: from then on it takes its part of ranges and fixes.

        It is told the graph's place at the last keyframe with twice its deviations. What the place was found by is
        counted in the graph; the filter needs it to begin with, and soon knows better by itself.
        """
        uwb, engine = self.rig.uwb, self._odometry.odometry
        if (uwb is None and self.rig.total_station is None) or engine is None or self._sightings.shared:
            return
        R = self._graph.pose(len(self._graph) - 1)[:3, :3]
        turned = np.kron(np.eye(2), R)
        ranging = Ranging(uwb, self._sightings.anchors, self.settings.ranges) if uwb is not None else None
        engine.locate(self._T_map_odom(), 4.0 * turned @ self._covariance @ turned.T, ranging)
        self._sightings.shared = True

    def _note_ranges(self) -> None:
        """What the filter thought of the ranges it was given."""
        engine = self._odometry.odometry
        if engine is None or engine.ranging is None:
            return
        for reading, verdict in engine.judged:
            if not verdict.refused:
                self._watch.fitted("uwb", reading.anchor, reading.stamp_ns)
                continue
            off = {"off_m": verdict.innovation, "why": verdict.refused}
            self._event(reading.stamp_ns, "range_refused", anchor=reading.anchor, **off)
        engine.judged.clear()
        self._note_anchors(engine.ranging, engine.filter.stamp_ns)

    def _note_fixes(self) -> None:
        """What the filter thought of the fixes it was given."""
        engine = self._odometry.odometry
        for fix, outcome in engine.fixed if engine is not None else []:
            if outcome.used:
                self._watch.fitted("prism", None, fix.stamp_ns)
            else:
                self._event(fix.stamp_ns, "prism_refused", anchor=None, off_m=outcome.off_m)
        if engine is not None:
            engine.fixed.clear()

    def _note_anchors(self, ranging: Ranging, stamp_ns: int) -> None:
        """Anchors that became blocked, fell silent, or are heard again."""
        for kind, now in (("blocked", ranging.check.blocked), ("silent", ranging.check.silent(stamp_ns))):
            before = self._anchors_that_are[kind]
            for anchor in sorted(now ^ before):
                self._event(stamp_ns, f"anchor_{kind}" if anchor in now else f"anchor_no_longer_{kind}", anchor=anchor)
            self._anchors_that_are[kind] = now
        if ranging.doubts > self._counts["range_doubts"]:
            self._event(stamp_ns, "ranges_contradict")
            self._counts["range_doubts"] = ranging.doubts

    def _pin_sighting(self, sighting: Sighting, pose: OdometryPose | None) -> None:
        """A range or fix as a factor on the keyframe before it; with the ``pose`` it came by, if it fits."""
        index, p_imu, way = self._from_keyframe(sighting, pose)
        predicted = transform(self._graph.pose(index), p_imu[None])[0]
        error = predicted - sighting.p_map
        distance = self._true_distance(sighting)
        off = abs(float(np.linalg.norm(error)) - distance)
        s, kind = self.settings.sightings, "prism" if sighting.anchor is None else "range"
        std = float(np.sqrt(sighting.std**2 + np.trace(self._covariance[3:, 3:])))
        least = s.min_gate
        if sighting.anchor is None:
            least, std = s.min_prism_gate, float(np.hypot(std, np.sqrt(np.trace(way))))
            off, std = self._off_filter(sighting, off, std)
        if pose is not None and off > max(least, s.max_innovation * std):
            self._event(sighting.stamp_ns, f"{kind}_refused", anchor=sighting.anchor, off_m=float(off))
            return
        if sighting.anchor in self._anchors_that_are["blocked"]:
            self._event(sighting.stamp_ns, "range_refused", anchor=sighting.anchor, off_m=float(off), why="blocked")
            return
        if sighting.anchor is None:
            variance = sighting.std**2 * sighting.alike + self.settings.graph.drift_position**2
            R = self._graph.pose(index)[:3, :3]
            self._graph.pin_position(index, p_imu, sighting.p_map, variance * np.eye(3) + R @ way @ R.T)
        else:
            noise = sighting.std * np.sqrt(sighting.alike)
            self._graph.pin_range(index, p_imu, sighting.anchor, sighting.p_map, distance, noise)
        self._watch.fitted("prism" if sighting.anchor is None else "uwb", sighting.anchor, sighting.stamp_ns)
        self._counts["pins"] += 1
        self._pins_dirty = True

    def _off_filter(self, fix: Sighting, off: float, std: float) -> tuple[float, float]:
        """How far a fix is off where the filter has the prism, and how well it knows that; it knows better than the
        graph, which may have begun with a wrong heading."""
        engine, station = self._odometry.odometry, self.rig.total_station
        if engine is None or station is None or engine.filter.state.T_map_odom is None:
            return off, std
        predicted = transform(engine.filter.state.T_map_odom, fix.p_odom[None])[0]
        model = PrismPosition(fix.p_map, np.array(station.p_imu_prism), fix.std)
        return float(np.linalg.norm(predicted - fix.p_map)), float(
            np.hypot(fix.std, model.predicted_std(engine.filter))
        )

    def _from_keyframe(self, sighting: Sighting, pose: OdometryPose | None) -> tuple[int, Array, Array]:
        """The keyframe before a sighting, the sighted point (3,) in its axes, and what the way from there is off by.

        By the way as now known, where it came with the newest scan: what the filter learnt since has moved odom.
        """
        stamps = [stamp for stamp, _ in self._keyframe_track]
        index = max(0, int(np.searchsorted(stamps, sighting.stamp_ns, side="right")) - 1)
        newest = len(stamps) - 1 - (pose.keyframe if pose is not None else 0)
        if pose is None or sighting.anchor is not None or index != newest:
            p_imu = transform(inverse(self._keyframe_track[index][1]), sighting.p_odom[None])[0]
            return index, p_imu, np.zeros((3, 3))
        T_keyframe_odom = pose.T_keyframe_imu @ inverse(pose.T_odom_imu)
        R = pose.T_keyframe_imu[:3, :3]
        return index, transform(T_keyframe_odom, sighting.p_odom[None])[0], R @ pose.since_keyframe[3:, 3:] @ R.T

    def _true_distance(self, sighting: Sighting) -> float:
        """As the filter has come to know the radios."""
        engine = self._odometry.odometry
        if sighting.anchor is None or engine is None:
            return sighting.distance
        return engine.filter.true_distance(sighting.anchor, sighting.distance)

    def _note_mode(self, pose: OdometryPose) -> None:
        engine = self._odometry.odometry
        wheel = engine.wheel if engine is not None else None
        self._events.extend(self._watch.reached(pose, wheel, outside=self._outside_sphere(pose)))

    def _outside_sphere(self, pose: OdometryPose) -> float | None:
        """How far from the middle of the anchors' sphere over its radius (Eq. 18); None where place or sphere are not
        known."""
        uwb = self.rig.uwb
        if uwb is None or uwb.center is None or uwb.max_range is None or not self._graph.anchored:
            return None
        p_map = transform(self._T_map_odom(), pose.state.p[None])[0] + self._shift
        return float(np.linalg.norm(p_map - uwb.center) / uwb.max_range)

    def _anchor(self, T_map_odom: Array, stamp_ns: int, by: str) -> None:
        self._graph.anchor(T_map_odom)
        self._event(stamp_ns, "anchored", by=by)

    def _solve(self) -> None:
        self._graph.solve()
        self._covariance = self._graph.covariance(len(self._graph) - 1)
        self._pins_dirty = False

    def _T_map_odom(self) -> Array:
        index = len(self._graph) - 1
        return self._graph.pose(index) @ inverse(self._keyframe_track[index][1])

    def _publish(self, pose: OdometryPose) -> Update:
        """What is known now; nothing in the map while that is unknown or in doubt."""
        T_map_imu = covariance = None
        if not self._referenced:
            self._realtime_track.append((pose.stamp_ns, pose.T_odom_imu))
        elif self._graph.anchored and self._state == "tracking" and self._newest is not None:
            since = np.eye(4) if pose.keyframe else pose.T_keyframe_imu
            T_map_imu = _shifted((self._graph.pose(len(self._graph) - 1) @ since)[None], self._shift)[0]
            carried = adjoint(inverse(since))
            covariance = carried @ self._covariance @ carried.T
            if not pose.keyframe:
                covariance = covariance + self._link_covariance(pose)
            self._realtime_track.append((pose.stamp_ns, T_map_imu))
        return Update(pose.stamp_ns, pose.T_odom_imu, T_map_imu, covariance, self._state)

    def _set_state(self, state: State, stamp_ns: int, why: str) -> None:
        if state != self._state:
            self._event(stamp_ns, "state", before=self._state, after=state, why=why)
            self._state = state

    def _event(self, stamp_ns: int, kind: str, **data: Any) -> None:
        self._events.append({"stamp_ns": int(stamp_ns), "kind": kind, **data})

    def _summary(self) -> dict[str, Any]:
        engine = self._odometry.odometry
        return {
            **self._counts,
            "intersections_recognised": sorted(self._recognised),
            "dropped": dict(engine.dropped) if engine else {},
            "wheel_slips": sum(change.slipping for change in engine.wheel.changes) if engine and engine.wheel else 0,
            "wheel_scale": engine.filter.state.wheel_scale if engine and engine.wheel else None,
            "imu_gaps": engine.gaps if engine else 0,
            "unknown_anchors": sorted(self._sightings.unknown_anchors),
            "state": self._state,
            "anchored": self._graph.anchored,
        }


def _round_origin(rig: Rig, semantic_map: SemanticMap | None) -> Array:
    """A round point near everything surveyed (3,), so that the graph works with small numbers."""
    if semantic_map is not None:
        return np.asarray(semantic_map.origin, dtype=np.float64)
    if rig.uwb is not None:
        surveyed = np.mean(list(rig.uwb.anchors.values()), axis=0)
    elif rig.total_station is not None:
        surveyed = np.array(rig.total_station.position)
    else:
        return np.zeros(3)
    rounded: Array = _ROUND_M * np.round(surveyed / _ROUND_M)
    return rounded


def _shifted(poses: Array, shift: Array) -> Array:
    moved = poses.copy()
    moved[:, :3, 3] += shift
    return moved


def _trajectory(frame: str, track: list[tuple[int, Array]]) -> Trajectory:
    stamps = np.array([stamp for stamp, _ in track], np.int64)
    return Trajectory(frame, stamps, np.array([pose for _, pose in track]).reshape(-1, 4, 4))
