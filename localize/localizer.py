"""The online way of paper 004: measurements in, a pose in the map out, at every scan."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localize.breaks import BreakWatch
from localize.frames import going_on, in_map, round_origin, shifted
from localize.hypotheses import carried
from localize.intersection_pins import IntersectionPins
from localize.journal import Journal
from localize.keyframes import Keyframes
from localize.known import MapIntersections
from localize.legs import joined, trajectory
from localize.links import LinkCovariances
from localize.loops import LoopPins
from localize.matcher import Expected, IntersectionMatcher
from localize.mountings import estimated_mountings
from localize.odometry import OdometryPose
from localize.results import LocalizationResult, State, Update
from localize.settings import LocalizeSettings
from localize.sighting_pins import SightingPins
from localize.start import StartingOdometry
from localize.track import Track
from localize.watch import ModeWatch
from semmap.geometry import Array, transform
from semmap.intersections import SemanticMap
from semmap.measurements import ImuSample, Measurement, PrismFix, UwbRange
from semmap.rig import Rig


class Localizer:
    """Localizes one robot against a semantic map; the same object serves a file, a live feed and a test.

    Parameters
    ----------
    rig : the sensors; blocks that are absent are not used.
    semantic_map : the database; None: the intersections found on the way are, and with UWB or a total station in the
        rig it is in the map all the same.
    settings : `LocalizeSettings`.
    on_keyframe : called with the stamp of each keyframe [ns] and all of its points (n, 3), deskewed, in the imu frame.

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
    intersection    -                       pose from ICP to the database's cloud, or
                                            to that of its first passage
    ==============  ======================  ==========================================
    """

    def __init__(
        self,
        rig: Rig,
        semantic_map: SemanticMap | None = None,
        settings: LocalizeSettings | None = None,
        *,
        on_keyframe: Callable[[int, NDArray[np.float32]], None] | None = None,
    ) -> None:
        self.rig, self.settings, self._on_keyframe = rig, settings or LocalizeSettings(), on_keyframe
        self._shift = round_origin(rig, semantic_map)
        self._journal = Journal()
        bias_std = rig.uwb.bias_std if rig.uwb else 0.0
        self._track = Track(self.settings.graph, self._journal, range_bias_std=bias_std)
        self._keyframes = Keyframes(self.settings.keyframes)
        self._breaks = BreakWatch(self.settings.breaks)
        self._watch = ModeWatch(self.settings, lidar=rig.lidar is not None)
        self._sightings = SightingPins(rig, self.settings, self._track, self._journal, self._watch, self._shift)
        self._intersections = self._intersection_pins(semantic_map)
        self._referenced = semantic_map is not None or rig.uwb is not None or rig.total_station is not None
        self._own_frame = not self._referenced and self._intersections is not None
        """Whether the run is in a frame of its own that loops correct."""
        self._past: Counter[str] = Counter()
        """What the odometries that broke off counted."""
        self._T_odom_leg = np.eye(4)
        self._odometry_track: list[tuple[int, Array]] = []
        self._realtime_track: list[tuple[int, Array]] = []
        self._begin_leg()

    def _intersection_pins(self, semantic_map: SemanticMap | None) -> IntersectionPins | None:
        s = self.settings
        if semantic_map is not None:
            matcher = IntersectionMatcher(MapIntersections(semantic_map, self._shift), s)
            return IntersectionPins(matcher, s, self._track, self._journal, self._shift)
        loops = s.loops.close and self.rig.lidar is not None
        return LoopPins(s, self._track, self._journal, self._shift) if loops else None

    def add(self, measurement: Measurement) -> Update | None:
        """Take one measurement in, in order of arrival; returns an update when a scan was completed by it."""
        if isinstance(measurement, UwbRange | PrismFix) and not self._sightings.is_odometrys(measurement):
            return None
        if isinstance(measurement, PrismFix):
            measurement = PrismFix(measurement.stamp_ns, measurement.p_map - self._shift)
        if isinstance(measurement, ImuSample):
            silence_s = self._breaks.silence_s(measurement.stamp_ns)
            if silence_s:
                self._begin_again(measurement.stamp_ns, f"nothing from the IMU for {silence_s:.1f} s")
        update = None
        for pose in self._odometry.add(measurement):
            if self._breaks.leaves_map(pose, len(self._track.keyframes)):
                self._begin_again(pose.stamp_ns, "the scans do not meet the local map")
                break
            update = self._reached(pose)
        return update

    @property
    def scans(self) -> int:
        """Poses that became known so far."""
        return self._journal.counts["scans"]

    def _reached(self, pose: OdometryPose) -> Update:
        """The steps of paper 004 section 3 for one scan."""
        self._add_pose(pose)
        if pose.keyframe:
            self._add_keyframe(pose)
            if self._intersections is not None:
                self._intersections.look(self._keyframes)
        if self._intersections is not None and self._intersections.judge():
            self._sightings.share_place()
        self._sightings.take(pose)
        if self._track.dirty:
            self._track.solve()
            self._sightings.share_place()
        self._note_mode(pose)
        update = self._publish(pose)
        self._watch.note_uncertainty(pose, update)
        return update

    def finish(self) -> LocalizationResult:
        """End the run: smooth the whole track and hand everything over."""
        for pose in self._odometry.finish():
            self._reached(pose)
        if self._intersections is not None:
            self._intersections.finish()
        odometry = trajectory("odom", self._odometry_track)
        frame = "map" if self._referenced else "odom"
        final = odometry
        if self._referenced or self._own_frame:
            final = joined([leg.smoothed() for leg in self._track.legs], frame)
            final = replace(final, poses=shifted(final.poses, self._shift))
        return LocalizationResult(
            final, trajectory(frame, self._realtime_track), odometry, tuple(self._journal.events), self._summary(),
            tuple(self._watch.uncertainty), tuple(self._journal.overlays),
            tuple(one for leg in self._track.legs for one in leg.covariances()),
        )  # fmt: skip

    def _begin_leg(self) -> None:
        """The odometry begins anew, wherever the robot is."""
        s = self.settings
        self._odometry = StartingOdometry(
            self.rig, s.odometry, s.keyframes, denoise=s.denoise, prism=s.prism,
            heading_std=s.sightings.align_yaw_std,
        )  # fmt: skip
        self._links = LinkCovariances(s.graph, s.degeneracy.scan)
        self._keyframes.forget()
        self._breaks.begin_again()
        self._watch.begin_again()
        self._track.begin_leg(self._keyframes.count)
        self._sightings.begin_leg(self._odometry)
        if self._intersections is not None:
            self._intersections.begin_leg()

    def _begin_again(self, stamp_ns: int, why: str) -> None:
        """The odometry has broken off: a new leg, wherever the robot is."""
        for pose in self._odometry.finish():
            self._reached(pose)
        if self._intersections is not None:
            self._intersections.end_leg()
        if self._track.leg.odometry:
            self._track.leg.odometry.pop()  # a scan of both places, or the last before a silence
        self._journal.event(stamp_ns, "odometry_broken", why=why)
        self._past += self._odometry_counts() + Counter(odometry_breaks=1)
        self._begin_leg()
        if self._journal.state != "unknown":
            self._journal.enter("lost", stamp_ns, why)

    def _add_pose(self, pose: OdometryPose) -> None:
        leg = self._track.leg
        if not leg.odometry and self._odometry_track:
            self._T_odom_leg = going_on(self._odometry_track[-1][1], pose.T_odom_imu)
        leg.odometry.append((pose.stamp_ns, leg.unmoved_to(pose.T_odom_imu, pose.T_keyframe_imu)))
        self._odometry_track.append((pose.stamp_ns, self._T_odom_leg @ pose.T_odom_imu))
        self._journal.counts["scans"] += 1

    def _add_keyframe(self, pose: OdometryPose) -> None:
        if self._on_keyframe is not None:
            self._on_keyframe(pose.stamp_ns, pose.points)
        keyframe = self._keyframes.add(pose, self._track.unmoved)
        self._track.add_keyframe(keyframe, pose, self._links.of(pose))
        self._links.keyframe(pose)
        if self._own_frame and not any(leg.graph.anchored for leg in self._track.legs):
            self._track.stay()

    def _note_mode(self, pose: OdometryPose) -> None:
        engine = self._odometry.odometry
        wheel = engine.wheel if engine is not None else None
        self._journal.events.extend(self._watch.reached(pose, wheel, outside=self._outside_sphere(pose)))

    def _outside_sphere(self, pose: OdometryPose) -> float | None:
        """How far from the middle of the anchors' sphere over its radius (Eq. 18); None where place or sphere are not
        known."""
        uwb = self.rig.uwb
        if uwb is None or uwb.center is None or uwb.max_range is None or self._track.at is None:
            return None
        p_map = transform(self._track.T_map_odom(), pose.state.p[None])[0] + self._shift
        return float(np.linalg.norm(p_map - uwb.center) / uwb.max_range)

    def _publish(self, pose: OdometryPose) -> Update:
        """What is known now; nothing in the map while that is unknown or in doubt."""
        T_odom_imu, at = self._odometry_track[-1][1], self._track.at
        state: State = self._journal.state
        if self._breaks.strayed and state == "tracking":
            state = "suspect"
        if not self._referenced and not self._own_frame:
            self._realtime_track.append((pose.stamp_ns, T_odom_imu))
            return Update(pose.stamp_ns, T_odom_imu, None, None, state)
        if at is None or (self._referenced and state != "tracking"):
            return Update(pose.stamp_ns, T_odom_imu, None, None, state)
        now = self._now(pose, at)
        T_map_imu = shifted(now.T_map_imu[None], self._shift)[0]
        self._realtime_track.append((pose.stamp_ns, T_map_imu))
        if self._own_frame:
            return Update(pose.stamp_ns, T_odom_imu, None, None, state, T_map_imu)
        return Update(pose.stamp_ns, T_odom_imu, T_map_imu, now.covariance, state)

    def _now(self, pose: OdometryPose, at: Expected) -> Expected:
        """Where the robot is, from the newest keyframe; where the LiDAR is blind by what IMU and fixes tell the filter:
        from one blind keyframe to the next the graph knows little of what hangs together in it."""
        if self.rig.total_station is not None and pose.state.T_map_odom is not None and self._links.blind(pose):
            return Expected(*in_map(pose.state, pose.covariance))
        return at if pose.keyframe else carried(at, pose.T_keyframe_imu, self._links.of(pose).covariance)

    def _odometry_counts(self) -> Counter[str]:
        """What the present odometry counted."""
        engine = self._odometry.odometry
        if engine is None:
            return Counter()
        slips = sum(change.slipping for change in engine.wheel.changes) if engine.wheel is not None else 0
        dropped = {f"dropped {what}": count for what, count in engine.dropped.items()}
        return Counter({"wheel_slips": slips, "imu_gaps": engine.gaps, **dropped})

    def _mountings(self) -> dict[str, dict[str, Any]]:
        """Those that are estimated."""
        engine = self._odometry.odometry
        if engine is None:
            return {}
        return estimated_mountings(engine.filter.state, engine.filter.P, self.settings.odometry.extrinsics)

    def _summary(self) -> dict[str, Any]:
        engine = self._odometry.odometry
        counted = self._past + self._odometry_counts()
        return {
            **self._journal.counts,
            "intersections_recognised": sorted(self._journal.recognised),
            "dropped": {key[8:]: n for key, n in counted.items() if key.startswith("dropped ")},
            "wheel_slips": counted["wheel_slips"],
            "wheel_scale": engine.filter.state.wheel_scale if engine and engine.wheel else None,
            "mountings": self._mountings(),
            "prism_clock_offset": self._sightings.told_clock(),
            "imu_gaps": counted["imu_gaps"],
            "odometry_breaks": counted["odometry_breaks"],
            "unknown_anchors": sorted(self._sightings.unknown_anchors),
            "state": self._journal.state,
            "anchored": self._referenced and any(leg.graph.anchored for leg in self._track.legs),
        }
