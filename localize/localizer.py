"""The online way of paper 004: measurements in, a pose in the map out, at every scan."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from localize.beside import RecognitionBeside
from localize.breaks import BreakWatch
from localize.frames import going_on, in_map, round_origin, shifted
from localize.graph import PoseGraph
from localize.hypotheses import carried
from localize.keyframes import Keyframe, Keyframes
from localize.legs import Leg, joined, trajectory
from localize.links import LinkCovariances
from localize.matcher import Expected, IntersectionMatcher, Place, Sight
from localize.odometry import OdometryPose
from localize.prism import PrismPosition, start_from
from localize.ranging import Ranging
from localize.recognition import Recognition, Verdict
from localize.results import Event, LocalizationResult, State, Update
from localize.settings import LocalizeSettings
from localize.sightings import Sighting, Sightings, align_moving, align_standing
from localize.start import StartingOdometry
from localize.watch import ModeWatch
from semmap.geometry import Array, inverse, rotation_between, se3, transform
from semmap.intersections import SemanticMap
from semmap.measurements import ImuSample, Measurement, PrismFix, UwbRange
from semmap.rig import Rig

_UP = np.array([0.0, 0.0, 1.0])


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
        self._shift = round_origin(rig, semantic_map)
        self._keyframes = Keyframes(self.settings.keyframes)
        self._legs: list[Leg] = []
        self._past: Counter[str] = Counter()
        """What the odometries that broke off counted."""
        self._at: Expected | None = None
        """The newest keyframe in the map."""
        self._judged = -1
        """The last keyframe of the leg of which it is known what it saw."""
        self._breaks = BreakWatch(self.settings.breaks)
        self._watch = ModeWatch(self.settings, lidar=rig.lidar is not None)
        self._begin_leg()
        self._recognition = Recognition(self.settings.proof)
        self._beside: RecognitionBeside | None = None
        if semantic_map is not None:
            matcher = IntersectionMatcher(semantic_map, self.settings, self._shift)
            self._beside = RecognitionBeside(matcher, self.settings.matcher.lag_scans)
        self._referenced = semantic_map is not None or rig.uwb is not None or rig.total_station is not None
        self._newest: Keyframe | None = None
        self._T_odom_leg = np.eye(4)
        self._state: State = "unknown"
        self._odometry_track: list[tuple[int, Array]] = []
        self._realtime_track: list[tuple[int, Array]] = []
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
        self._pins_dirty = False

    def add(self, measurement: Measurement) -> Update | None:
        """Take one measurement in, in order of arrival; returns an update when a scan was completed by it."""
        if isinstance(measurement, UwbRange | PrismFix) and not self._is_odometrys(measurement):
            return None
        if isinstance(measurement, PrismFix):
            measurement = PrismFix(measurement.stamp_ns, measurement.p_map - self._shift)
        if isinstance(measurement, ImuSample):
            silence_s = self._breaks.silence_s(measurement.stamp_ns)
            if silence_s:
                self._begin_again(measurement.stamp_ns, f"nothing from the IMU for {silence_s:.1f} s")
        update = None
        for pose in self._odometry.add(measurement):
            if self._breaks.leaves_map(pose, len(self._keyframe_track)):
                self._begin_again(pose.stamp_ns, "the scans do not meet the local map")
                break
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

    def _begin_again(self, stamp_ns: int, why: str) -> None:
        """The odometry has broken off: a new leg, wherever the robot is."""
        for pose in self._odometry.finish():
            self._reached(pose)
        if self._leg.odometry:
            self._leg.odometry.pop()  # a scan of both places, or the last before a silence
        self._event(stamp_ns, "odometry_broken", why=why)
        self._past += self._odometry_counts() + Counter(odometry_breaks=1)
        self._recognition.forget()
        if self._beside is not None:
            self._beside.forget()
        self._begin_leg()
        if self._state != "unknown":
            self._set_state("lost", stamp_ns, why)

    def finish(self) -> LocalizationResult:
        """End the run: smooth the whole track and hand everything over."""
        for pose in self._odometry.finish():
            self._reached(pose)
        if self._beside is not None:
            self._judge(self._beside.due())
            self._beside.close()
        odometry = trajectory("odom", self._odometry_track)
        frame = "map" if self._referenced else "odom"
        final = joined([leg.smoothed() for leg in self._legs], "map") if self._referenced else odometry
        if self._referenced:
            final = replace(final, poses=shifted(final.poses, self._shift))
        return LocalizationResult(
            final, trajectory(frame, self._realtime_track), odometry, tuple(self._events), self._summary(),
            tuple(self._watch.uncertainty),
        )  # fmt: skip

    @property
    def _leg(self) -> Leg:
        """The present one."""
        return self._legs[-1]

    @property
    def _graph(self) -> PoseGraph:
        return self._leg.graph

    @property
    def _keyframe_track(self) -> list[tuple[int, Array]]:
        return self._leg.keyframes

    def _begin_leg(self) -> None:
        """The odometry begins anew, wherever the robot is."""
        s = self.settings
        self._odometry = StartingOdometry(
            self.rig, s.odometry, s.keyframes, denoise=s.denoise, prism=s.prism,
            heading_std=s.sightings.align_yaw_std,
        )  # fmt: skip
        self._sightings = Sightings(self.rig, self.settings.sightings, self._shift)
        self._keyframes.forget()
        self._at, self._judged = None, -1
        self._links = LinkCovariances(self.settings.graph, self.settings.degeneracy.scan)
        self._breaks.begin_again()
        self._watch.begin_again()
        bias_std = self.rig.uwb.bias_std if self.rig.uwb else 0.0
        self._legs.append(Leg(PoseGraph(self.settings.graph, range_bias_std=bias_std), self._keyframes.count))

    def _reached(self, pose: OdometryPose) -> Update:
        """The steps of paper 004 section 3 for one scan."""
        if not self._leg.odometry and self._odometry_track:
            self._T_odom_leg = going_on(self._odometry_track[-1][1], pose.T_odom_imu)
        self._leg.odometry.append((pose.stamp_ns, pose.T_odom_imu))
        self._odometry_track.append((pose.stamp_ns, self._T_odom_leg @ pose.T_odom_imu))
        self._counts["scans"] += 1
        if pose.keyframe:
            self._newest = self._add_keyframe(pose)
            self._look_for_intersections()
        if self._beside is not None:
            self._judge(self._beside.due(self._counts["scans"]))
        self._note_ranges()
        self._note_fixes()
        self._take_sightings(pose)
        self._anchor_standing(pose)
        self._anchor_moving(pose)
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
            keyframe.T_odom_imu, keyframe.up_odom, pose.T_keyframe_imu, self._links.of(pose), pose.up_std
        )
        self._links.keyframe(pose)
        self._keyframe_track.append((keyframe.stamp_ns, keyframe.T_odom_imu))
        unmoved = self._leg.unmoved
        unmoved.append(unmoved[-1] @ pose.T_keyframe_imu if unmoved else pose.T_odom_imu)
        self._counts["keyframes"] += 1
        if self._at is not None:
            self._at = carried(self._at, *self._graph.link(len(self._graph) - 1))
            self._pins_dirty = True
        return keyframe

    def _look_for_intersections(self) -> None:
        """Have the newest keyframe looked at, in view of where the robot is, or may be, as far as is known now."""
        if self._beside is None:
            return
        others = [self._at] if self._at is not None else self._recognition.hypotheses.expected
        if self._at is None:
            for index in range(self._judged + 1, len(self._graph)):
                others = [carried(at, *self._graph.link(index)) for at in others]
        self._beside.look(self._keyframes.last, self._at, others, self._counts["scans"])

    def _judge(self, looks: list[tuple[Keyframe, list[Sight]]]) -> None:
        """Decide what keyframes saw, in their order."""
        for keyframe, sights in looks:
            self._counts["intersections_seen"] += len(sights)
            self._judged = keyframe.index - self._leg.first_keyframe
            if self._judged > 0:
                self._recognition.hypotheses.carry(*self._graph.link(self._judged))
            for sight in sights:
                verdict = self._recognition.judge(sight, self._track(keyframe.index - self._leg.first_keyframe))
                told = {**verdict.event, "stamp_ns": self._leg.odometry[-1][0]}
                self._events.append({**told, "pins": [self._told(pin) for pin in verdict.pins]})
                self._follow(verdict, self._leg.odometry[-1][0])

    def _track(self, index: int) -> Expected | None:
        """Where a keyframe of the leg is taken to be."""
        if self._at is None or index == len(self._graph) - 1:
            return self._at
        return Expected(self._graph.pose(index), self._graph.covariance(index))

    def _told(self, pin: Place) -> Event:
        """A pin for the events."""
        p_map = (pin.T_map_imu[:3, 3] + self._shift).round(3).tolist()
        stamp_ns, _ = self._keyframe_track[pin.keyframe - self._leg.first_keyframe]
        return {"stamp_ns": stamp_ns, "keyframe": pin.keyframe, "id": pin.intersection, "p_map": p_map}

    def _follow(self, verdict: Verdict, stamp_ns: int) -> None:
        """Do what a verdict says."""
        if verdict.elsewhere:
            self._leave_track(verdict.pins, stamp_ns)
        if verdict.pins:
            self._pin_intersections(verdict.pins, stamp_ns)
            self._set_state("tracking", stamp_ns, "intersection proven")
        elif verdict.doubt and self._state == "tracking":
            self._set_state("suspect", stamp_ns, verdict.doubt)

    def _leave_track(self, pins: tuple[Place, ...], stamp_ns: int) -> None:
        """The robot is proven to be elsewhere: the track ended somewhere, or was wrong if one intersection made it."""
        self._set_state("lost", stamp_ns, "the robot is proven to be elsewhere")
        before = self._leg
        self._judged += before.first_keyframe
        self._legs.append(before.split(pins[0].keyframe))
        self._judged -= self._leg.first_keyframe
        self._at = None
        if len(before.pinned) < 2:
            self._counts["pins"] -= before.graph.pins
            self._recognised -= before.pinned
            before.graph.unanchor()

    def _pin_intersections(self, pins: tuple[Place, ...], stamp_ns: int) -> None:
        leg, last = self._leg, pins[-1]
        if not self._graph.anchored:
            _, T_odom_imu = leg.keyframes[last.keyframe - leg.first_keyframe]
            self._anchor(last.T_map_imu @ inverse(T_odom_imu), stamp_ns, "intersection")
        for pin in pins:
            index = pin.keyframe - leg.first_keyframe
            self._graph.pin_intersection(index, pin.intersection, pin.T_map_intersection, pin.T_map_imu, pin.covariance)
            leg.last_pin_ns = max(leg.last_pin_ns, leg.keyframes[index][0])
            leg.pinned.add(pin.intersection)
            self._recognised.add(pin.intersection)
            self._counts["pins"] += 1
        self._solve()
        self._share_place()

    def _take_sightings(self, pose: OdometryPose) -> None:
        sightings = self._sightings.reached(pose.stamp_ns, self._unmoved(pose))
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

    def _anchor_moving(self, pose: OdometryPose) -> None:
        """A machine whose LiDAR is blind, but which the total station sees drive: the INS/total-station filter starts
        the odometry (paper 002 II-B)."""
        engine, moving = self._odometry.odometry, self._odometry.moving
        if engine is None or moving is None or self._graph.anchored or not (pose.dust or self.rig.lidar is None):
            return
        found = moving.place(pose.stamp_ns)
        if found is None:
            return
        if not pose.keyframe:
            engine.keyframe_due = True
            return
        R_level_odom = rotation_between(-pose.state.g, _UP)
        T_map_level, newest = align_moving(found, pose.T_odom_imu, R_level_odom), len(self._graph) - 1
        by = "INS and fixes on the way"
        self._anchor(T_map_level @ se3(R_level_odom, np.zeros(3)), pose.stamp_ns, by)
        self._graph.pin_heading(newest, found.state.T_map_imu, found.heading_std)
        self._graph.pin_position(newest, moving.p_imu_prism, found.p_map_prism, found.covariance)
        # where samples are cleaned a second at a time the odometry is further already, and has slid meanwhile
        now, state = moving.place(engine.filter.stamp_ns), engine.filter.state
        if now is not None:
            R_level_odom = rotation_between(-state.g, _UP)
            T_map_odom = align_moving(now, state.T_odom_imu, R_level_odom) @ se3(R_level_odom, np.zeros(3))
            self._share(T_map_odom, np.zeros((6, 6)))
            start_from(engine.filter, now.state, 4.0 * now.P)
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
        total_station = self.rig.total_station
        if (uwb is None and total_station is None) or engine is None or self._at is None or self._sightings.shared:
            return
        turned = np.kron(np.eye(2), self._at.T_map_imu[:3, :3])
        self._share(self._T_map_odom(), 4.0 * turned @ self._at.covariance @ turned.T)

    def _share(self, T_map_odom: Array, covariance: Array) -> None:
        """Tell the filter where odom lies; ``covariance`` (6, 6) of the robot's place, in the map's axes."""
        uwb, engine = self.rig.uwb, self._odometry.odometry
        assert engine is not None
        ranging = Ranging(uwb, self._sightings.anchors, self.settings.ranges) if uwb is not None else None
        engine.locate(T_map_odom, covariance, ranging)
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
        s, kind = self.settings.ranges, "prism" if sighting.anchor is None else "range"
        std, least = float(np.hypot(sighting.std, self._at.position_std if self._at is not None else 0.0)), s.min_gate
        if sighting.anchor is None:
            least, std = s.min_prism_gate, float(np.hypot(std, np.sqrt(np.trace(way))))
            off, std = self._off_filter(sighting, pose, off, std)
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

    def _off_filter(self, fix: Sighting, pose: OdometryPose | None, off: float, std: float) -> tuple[float, float]:
        """How far a fix is off where the filter has the prism, and how well it knows that; it knows better than the
        graph, which may have begun with a wrong heading."""
        engine, station = self._odometry.odometry, self.rig.total_station
        if pose is None or engine is None or station is None or engine.filter.state.T_map_odom is None:
            return off, std
        T_map_unmoved = engine.filter.state.T_map_odom @ pose.T_odom_imu @ inverse(self._unmoved(pose))
        predicted = transform(T_map_unmoved, fix.p_odom[None])[0]
        model = PrismPosition(fix.p_map, np.array(station.p_imu_prism), fix.std)
        off = float(np.linalg.norm(predicted - fix.p_map))
        return off, float(np.hypot(fix.std, model.predicted_std(engine.filter)))

    def _unmoved(self, pose: OdometryPose) -> Array:
        """Pose (4, 4) of the newest scan in odom, had no range or fix ever moved it."""
        newest = self._leg.unmoved[-1]
        return newest if pose.keyframe else newest @ pose.T_keyframe_imu

    def _from_keyframe(self, sighting: Sighting, pose: OdometryPose | None) -> tuple[int, Array, Array]:
        """The keyframe before a sighting, the sighted point (3,) in its axes, and what the way from there is off by:
        (3, 3), for a fix that came with the newest scan."""
        stamps = [stamp for stamp, _ in self._keyframe_track]
        index = max(0, int(np.searchsorted(stamps, sighting.stamp_ns, side="right")) - 1)
        p_imu = transform(inverse(self._leg.unmoved[index]), sighting.p_odom[None])[0]
        if pose is None or sighting.anchor is not None or index != len(stamps) - 1 - pose.keyframe:
            return index, p_imu, np.zeros((3, 3))
        R = pose.T_keyframe_imu[:3, :3]
        return index, p_imu, R @ pose.since_keyframe[3:, 3:] @ R.T

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
        if uwb is None or uwb.center is None or uwb.max_range is None or self._at is None:
            return None
        p_map = transform(self._T_map_odom(), pose.state.p[None])[0] + self._shift
        return float(np.linalg.norm(p_map - uwb.center) / uwb.max_range)

    def _anchor(self, T_map_odom: Array, stamp_ns: int, by: str) -> None:
        self._graph.anchor(T_map_odom)
        self._event(stamp_ns, "anchored", by=by)

    def _solve(self) -> None:
        self._graph.solve()
        last = len(self._graph) - 1
        self._at = Expected(self._graph.pose(last), self._graph.covariance(last))
        self._pins_dirty = False

    def _T_map_odom(self) -> Array:
        assert self._at is not None
        return self._at.T_map_imu @ inverse(self._keyframe_track[-1][1])

    def _publish(self, pose: OdometryPose) -> Update:
        """What is known now; nothing in the map while that is unknown or in doubt."""
        T_odom_imu = self._odometry_track[-1][1]
        state: State = "suspect" if self._breaks.strayed and self._state == "tracking" else self._state
        T_map_imu = covariance = None
        if not self._referenced:
            self._realtime_track.append((pose.stamp_ns, T_odom_imu))
        elif self._at is not None and state == "tracking":
            now = self._now(pose, self._at)
            T_map_imu, covariance = shifted(now.T_map_imu[None], self._shift)[0], now.covariance
            self._realtime_track.append((pose.stamp_ns, T_map_imu))
        return Update(pose.stamp_ns, T_odom_imu, T_map_imu, covariance, state)

    def _now(self, pose: OdometryPose, at: Expected) -> Expected:
        """Where the robot is, from the newest keyframe; where the LiDAR is blind by what IMU and fixes tell the filter:
        from one blind keyframe to the next the graph knows little of what hangs together in it."""
        if self.rig.total_station is not None and pose.state.T_map_odom is not None and self._links.blind(pose):
            return Expected(*in_map(pose.state, pose.covariance))
        return at if pose.keyframe else carried(at, pose.T_keyframe_imu, self._links.of(pose))

    def _set_state(self, state: State, stamp_ns: int, why: str) -> None:
        if state != self._state:
            self._event(stamp_ns, "state", before=self._state, after=state, why=why)
            self._state = state

    def _event(self, stamp_ns: int, kind: str, **data: Any) -> None:
        self._events.append({"stamp_ns": int(stamp_ns), "kind": kind, **data})

    def _odometry_counts(self) -> Counter[str]:
        """What the present odometry counted."""
        engine = self._odometry.odometry
        if engine is None:
            return Counter()
        slips = sum(change.slipping for change in engine.wheel.changes) if engine.wheel is not None else 0
        dropped = {f"dropped {what}": count for what, count in engine.dropped.items()}
        return Counter({"wheel_slips": slips, "imu_gaps": engine.gaps, **dropped})

    def _summary(self) -> dict[str, Any]:
        engine = self._odometry.odometry
        counted = self._past + self._odometry_counts()
        return {
            **self._counts,
            "intersections_recognised": sorted(self._recognised),
            "dropped": {key[8:]: n for key, n in counted.items() if key.startswith("dropped ")},
            "wheel_slips": counted["wheel_slips"],
            "wheel_scale": engine.filter.state.wheel_scale if engine and engine.wheel else None,
            "imu_gaps": counted["imu_gaps"],
            "odometry_breaks": counted["odometry_breaks"],
            "unknown_anchors": sorted(self._sightings.unknown_anchors),
            "state": self._state,
            "anchored": any(leg.graph.anchored for leg in self._legs),
        }
