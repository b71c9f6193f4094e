"""LiDAR-inertial odometry: measurements in any order of arrival in, one pose a scan out."""

from __future__ import annotations

import bisect
from dataclasses import dataclass
from math import hypot

import numpy as np
from numpy.typing import NDArray

from localize.dust import Air
from localize.earth import Earth
from localize.filter import ErrorStateFilter, InertialTrack, joined
from localize.imu_buffer import ImuBuffer
from localize.local_map import LocalMap, ScanMatch
from localize.prism import Clock, FixOutcome, PrismFusion, without_earth_rate
from localize.range_check import Verdict
from localize.ranging import Ranging
from localize.recent_motion import RecentMotion
from localize.settings import KeyframeSettings, OdometrySettings, PrismSettings
from localize.slip import WheelFusion
from localize.state import GRAVITY, POSITION, ROTATION, NavState
from localize.uwb import Vertical
from semmap.geometry import Array, inverse, rotation_angle, skew, so3_log, transform
from semmap.measurements import ImuSample, Measurement, PrismFix, Scan, UwbRange, WheelSpeed
from semmap.rig import Rig

_TICK_NS = 100_000_000
"""Without a LiDAR poses come at this interval."""
_VERTICAL_STD, _LEVELLED_STD = 0.002, 0.0002
"""How well the axes of the map stand upright [rad], and those of a total station, which levels itself."""
_NO_MOTION = 22.5
"""Squared Mahalanobis distance beyond which what moved the last keyframe is no error of the way since (one of a
thousand is larger, with 6 degrees of freedom)."""
_GAP_NS = 50_000_000
"""A hole in the IMU's stamps longer than this is counted in ``gaps``; the rates are interpolated across it."""


@dataclass(frozen=True, slots=True)
class OdometryPose:
    """What the filter knows at the end of a scan.

    stamp_ns : time of the scan's end. T_odom_imu : (4, 4). covariance : (dim, dim), order of `localize.state`.
    state : the whole state. deskewed : (n, 3) points in the lidar frame at that time, of a keyframe all, else those
    that were used; empty without a scan.
    matched : scan points that met a plane; considered : scan points tried.
    keyframe : whether the filter moved far enough since the last one (paper 004 Eq. 8, 9).
    T_keyframe_imu : (4, 4) pose relative to the last keyframe; where that was moved meanwhile, as now known of both.
    since_keyframe : (6, 6) covariance of that, rotation first, right perturbation.
    scan_information : (6, 6) what the scan alone says of the pose, None without one (see `ScanMatch`).
    dust : share of the scan's near points that lie in dust, see `localize.dust`.
    """

    stamp_ns: int
    state: NavState
    covariance: Array
    deskewed: Array
    matched: int
    considered: int
    keyframe: bool
    T_keyframe_imu: Array
    since_keyframe: Array
    scan_information: Array | None
    dust: float = 0.0

    @property
    def T_odom_imu(self) -> Array:
        """Pose (4, 4)."""
        return self.state.T_odom_imu

    @property
    def position_std(self) -> float:
        """How well the filter knows the position in odom, per axis on average [m]."""
        return float(np.sqrt(np.trace(self.covariance[POSITION, POSITION]) / 3.0))

    @property
    def up_imu(self) -> Array:
        """Unit vector (3,) against gravity in the axes of the imu."""
        return np.asarray(-self.state.R.T @ self.state.g / np.linalg.norm(self.state.g))

    @property
    def up_std(self) -> float:
        """How well that is known [rad]."""
        s, up, length = self.state, self.up_imu, np.linalg.norm(self.state.g)
        J = np.hstack([skew(up), -(np.eye(3) - np.outer(up, up)) @ s.R.T / length])
        columns = np.r_[ROTATION, GRAVITY]
        return float(np.sqrt(0.5 * np.trace(J @ self.covariance[np.ix_(columns, columns)] @ J.T)))

    @property
    def points(self) -> NDArray[np.float32]:
        """The deskewed points (n, 3) in the imu frame."""
        return transform(self.state.T_imu_lidar, self.deskewed).astype(np.float32)


class Odometry:
    """The filter with its local map and the sequencer that feeds it.

    A scan is used when the IMU covers its end; what arrives out of order before that is put in order, what arrives
    later is dropped and counted in ``dropped``.
    """

    def __init__(
        self,
        rig: Rig,
        settings: OdometrySettings,
        keyframes: KeyframeSettings,
        start: ErrorStateFilter,
        prism: PrismSettings | None = None,
    ) -> None:
        self.rig, self.settings, self.keyframes, self.filter = rig, settings, keyframes, start
        self.map = LocalMap(rig.lidar, settings) if rig.lidar is not None else None
        self.dropped: dict[str, int] = {}
        self.wheel = WheelFusion(rig.wheel, settings) if rig.wheel is not None else None
        self.gaps = 0
        self._imu = ImuBuffer()
        self._wheel: list[WheelSpeed] = []
        self._scans: list[Scan] = []
        self._T_odom_keyframe: Array | None = None
        self.ranging: Ranging | None = None
        self.judged: list[tuple[UwbRange, Verdict]] = []
        self._ranges: list[UwbRange] = []
        self._ranged = False
        self.earth = Earth.of(rig.earth)
        self.prism = PrismFusion(rig.total_station, prism or PrismSettings()) if rig.total_station is not None else None
        self.fixed: list[tuple[PrismFix, FixOutcome]] = []
        self._fixes: list[PrismFix] = []
        self._recent = RecentMotion()
        self.keyframe_due = False

    def locate(self, T_map_odom: Array, covariance: Array, ranging: Ranging | None, clock: Clock) -> None:
        """From now on ranges, and fixes as positions, are taken in.

        covariance : (6, 6) of the robot's place in the map, in the map's axes. clock : the total station's.
        """
        self.filter.locate(
            T_map_odom, covariance, range_scale_std=ranging.block.scale_std if ranging else 0.0,
            clock_offset=clock.offset_s, clock_offset_std=clock.std_s,
        )  # fmt: skip
        self.filter.update(Vertical(_VERTICAL_STD if self.prism is None else _LEVELLED_STD))
        without_earth_rate(self.filter, self.earth, self.rig.imu.gyro_bias_std, float(np.sqrt(covariance[2, 2])))
        self.ranging = ranging
        # those that still wait are the graph's
        self._fixes.clear()

    def add(self, measurement: Measurement) -> list[OdometryPose]:
        """Take one measurement in; returns the poses that became known (usually none or one)."""
        match measurement:
            case ImuSample():
                self._add_imu(measurement)
            case WheelSpeed() if self.wheel is not None:
                if self._in_time(measurement.stamp_ns, "wheel"):
                    bisect.insort(self._wheel, measurement, key=lambda m: m.stamp_ns)
            case UwbRange() if self.ranging is not None:
                if self._in_time(measurement.stamp_ns, "range"):
                    bisect.insort(self._ranges, measurement, key=lambda m: m.stamp_ns)
            case PrismFix() if self.prism is not None:
                if self._in_time(self._due_ns(measurement), "prism", back_to_ns=self._recent.since_ns):
                    bisect.insort(self._fixes, measurement, key=lambda m: m.stamp_ns)
            case Scan() if self.rig.lidar is not None:
                # there is but one pose at a time; all else may come at the time of the last
                if self._in_time(measurement.end_ns - 1, "scan"):
                    bisect.insort(self._scans, measurement, key=lambda m: m.end_ns)
            case _:
                return []
        return self._advance()

    def _add_imu(self, sample: ImuSample) -> None:
        if len(self._imu):
            after_ns = sample.stamp_ns - self._imu.last_ns
            if after_ns <= 0:
                self._count("imu")
                return
            self.gaps += after_ns > _GAP_NS
        self._imu.append(sample)

    def _in_time(self, stamp_ns: int, what: str, back_to_ns: int | None = None) -> bool:
        if stamp_ns >= (self.filter.stamp_ns if back_to_ns is None else back_to_ns):
            return True
        self._count(what)
        return False

    def _count(self, what: str) -> None:
        self.dropped[what] = self.dropped.get(what, 0) + 1

    def _advance(self) -> list[OdometryPose]:
        poses = []
        while len(self._imu):
            if self.rig.lidar is None:
                end_ns = self.filter.stamp_ns + _TICK_NS
            elif self._scans:
                end_ns = self._scans[0].end_ns
            else:
                break
            if self._imu.last_ns < end_ns:
                break
            poses.append(self._step(end_ns, self._scans.pop(0) if self.rig.lidar is not None else None))
        return poses

    def _step(self, end_ns: int, scan: Scan | None) -> OdometryPose:
        """One scan: propagate with the wheel on the way, deskew, match, extend the local map."""
        track = self._propagate(end_ns)
        deskewed = np.empty((0, 3))
        match = ScanMatch(0, 0, None)
        dust = 0.0
        T_imu_lidar = self.filter.state.T_imu_lidar
        if scan is not None and self.map is not None:
            scan = scan.since(track.zero_ns - _TICK_NS // 2)
            sparse = scan.thinned(self.settings.scan_points)
            deskewed = track.deskew(sparse.points, sparse.offsets_ns, sparse.stamp_ns, T_imu_lidar)
            air = Air(deskewed)
            if air.dusty:
                sparse, deskewed, dust = sparse.part(air.clear), deskewed[air.clear], air.dust
            surfaces = self.map.surfaces(sparse, deskewed)
            match = self.map.match(surfaces, self.filter)
            self.map.extend(surfaces, self.filter)
        covariance = self.filter.covariance_since_clone()
        way = inverse(self.filter.state.T_odom_clone) @ self.filter.state.T_odom_imu
        T_keyframe_imu = self._since_keyframe(way, covariance)
        keyframe = self._keyframe_rule(way)
        if keyframe and scan is not None and len(deskewed) < len(scan.points):
            deskewed = track.deskew(scan.points, scan.offsets_ns, scan.stamp_ns, T_imu_lidar)
            deskewed = deskewed[Air(deskewed).clear] if dust else deskewed
        return OdometryPose(
            end_ns, self.filter.state.copy(), self.filter.P.copy(), deskewed, match.matched, match.considered, keyframe,
            T_keyframe_imu, covariance, match.information, dust,
        )  # fmt: skip

    def _since_keyframe(self, way: Array, covariance: Array) -> Array:
        """Pose (4, 4) relative to the last keyframe, given the ``way`` from there by the filter and its ``covariance``.

        What odometry had slid before is no motion, when ranges, or the first rock after a smooth drift, tell of it:
        pose and last keyframe move together. What moves the keyframe by no more than the error of the way belongs to
        the way all the same: where scans hold the place, the keyframe was off by that.
        """
        if self._T_odom_keyframe is None:
            return np.eye(4)
        if self._ranged:
            return way
        odometrys = inverse(self._T_odom_keyframe) @ self.filter.state.T_odom_imu
        apart = inverse(way) @ odometrys
        moved = np.concatenate([so3_log(apart[:3, :3]), apart[:3, 3]])
        return odometrys if moved @ np.linalg.solve(covariance, moved) < _NO_MOTION else way

    def _keyframe_rule(self, way: Array) -> bool:
        """Whether this pose, so far on its ``way``, is a keyframe (paper 004 Eq. 8, 9); the first is."""
        moved = hypot(*way[:3, 3]) > self.keyframes.distance
        turned = rotation_angle(way[:3, :3]) > self.keyframes.angle
        if not (moved or turned or self.keyframe_due or self._T_odom_keyframe is None):
            return False
        self.keyframe_due = False
        self._T_odom_keyframe, self._ranged = self.filter.state.T_odom_imu, False
        self.filter.clone_pose()
        return True

    def _propagate(self, end_ns: int) -> InertialTrack:
        tracks: list[InertialTrack] = []
        while self._wheel and self._wheel[0].stamp_ns <= end_ns:
            reading = self._mean_wheel_speed(end_ns)
            self._take_sightings(reading.stamp_ns, tracks)
            if reading.stamp_ns > self.filter.stamp_ns:
                tracks.append(self._predict(reading.stamp_ns))
                if self.wheel is not None:
                    gyro = tracks[-1].rate[-1] + self.filter.state.gyro_bias
                    self.wheel.take(reading, gyro, self.filter)
        self._take_sightings(end_ns, tracks)
        if end_ns > self.filter.stamp_ns or not tracks:
            tracks.append(self._predict(end_ns))
        return joined(tracks)

    def _mean_wheel_speed(self, end_ns: int) -> WheelSpeed:
        """The readings of the next moment up to ``end_ns`` as one at their mean time, no surer than each: a wheel that
        slides a little does so in all of them."""
        until_ns = min(end_ns, self._wheel[0].stamp_ns + round(self.settings.wheel_interval_s * 1e9) - 1)
        count = bisect.bisect_right(self._wheel, until_ns, key=lambda reading: reading.stamp_ns)
        readings, self._wheel = self._wheel[:count], self._wheel[count:]
        first_ns = readings[0].stamp_ns
        later_ns = round(np.mean([reading.stamp_ns - first_ns for reading in readings]))
        return WheelSpeed(first_ns + later_ns, float(np.mean([reading.speed for reading in readings])))

    def _take_sightings(self, until_ns: int, tracks: list[InertialTrack]) -> None:
        """Ranges and fixes up to a time, each at its own, into the filter; ``tracks`` go on, and move with the pose."""
        while (sighting := self._next_sighting(until_ns)) is not None:
            if self._due_ns(sighting) > self.filter.stamp_ns:
                tracks.append(self._predict(self._due_ns(sighting)))
            before = inverse(self.filter.state.T_odom_imu)
            if self._taken(sighting):
                self._ranged = True
                moved = self.filter.state.T_odom_imu @ before
                tracks[:] = [track.moved(moved) for track in tracks]

    def _next_sighting(self, until_ns: int) -> UwbRange | PrismFix | None:
        waiting: list[list[UwbRange] | list[PrismFix]] = [one for one in (self._ranges, self._fixes) if one]
        if not waiting:
            return None
        first = min(waiting, key=lambda one: self._due_ns(one[0]))
        return first.pop(0) if self._due_ns(first[0]) <= until_ns else None

    def _due_ns(self, sighting: UwbRange | PrismFix) -> int:
        """When it was, as far as the clocks are known; of a fix that may be a while ago."""
        clock = Clock.of(self.filter) if isinstance(sighting, PrismFix) else None
        return sighting.stamp_ns if clock is None else clock.corrected_ns(sighting.stamp_ns)

    def _taken(self, sighting: UwbRange | PrismFix) -> bool:
        """Whether the filter took it as knowledge of the place."""
        if isinstance(sighting, UwbRange):
            assert self.ranging is not None
            verdict = self.ranging.take(sighting, self.filter, self.map)
            self.judged.append((sighting, verdict))
            return not verdict.refused
        assert self.prism is not None
        outcome = self.prism.take(sighting, self.filter, self._recent)
        if outcome is not None:
            self.fixed.append((sighting, outcome))
        return outcome is not None and outcome.used

    def _predict(self, end_ns: int) -> InertialTrack:
        """Propagate from the filter's time to ``end_ns``, with the IMU interpolated at both ends."""
        imu = self._imu.between(self.filter.stamp_ns, end_ns)
        turning, falling = self._earth_felt()
        track = self.filter.predict(imu.stamps_ns, imu.gyro - turning, imu.accel - falling)
        self._imu.forget_before(end_ns)
        if self.prism is not None:
            self._recent.add(track)
        return track

    def _earth_felt(self) -> tuple[Array, Array]:
        """What the turning earth adds to rate [rad/s] and specific force [m/s²] (002, under Eq. 20), (3,) each."""
        if not self.earth.rate.any():
            return np.zeros(3), np.zeros(3)
        state = self.filter.state
        rate = self.earth.rate_in_odom(-state.g / np.linalg.norm(state.g), state.T_map_odom)
        return state.R.T @ rate, state.R.T @ np.cross(2.0 * rate, state.v)
