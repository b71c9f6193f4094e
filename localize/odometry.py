"""LiDAR-inertial odometry: measurements in any order of arrival in, one pose a scan out."""

from __future__ import annotations

import bisect
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localize.filter import ErrorStateFilter, InertialTrack, joined
from localize.local_map import LocalMap
from localize.settings import KeyframeSettings, OdometrySettings
from localize.state import NavState
from localize.wheel import WheelVelocity
from semmap.geometry import Array, inverse, rotation_angle, transform
from semmap.measurements import ImuSample, Measurement, Scan, WheelSpeed
from semmap.rig import Rig

_TICK_NS = 100_000_000
"""Without a LiDAR poses come at this interval."""
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
    since_keyframe : (6, 6) covariance of the pose relative to the last keyframe, rotation first, right perturbation.
    """

    stamp_ns: int
    state: NavState
    covariance: Array
    deskewed: Array
    matched: int
    considered: int
    keyframe: bool
    since_keyframe: Array

    @property
    def T_odom_imu(self) -> Array:
        """Pose (4, 4)."""
        return self.state.T_odom_imu

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
        self, rig: Rig, settings: OdometrySettings, keyframes: KeyframeSettings, start: ErrorStateFilter
    ) -> None:
        self.rig, self.settings, self.keyframes, self.filter = rig, settings, keyframes, start
        self.map = LocalMap(rig.lidar, settings) if rig.lidar is not None else None
        self.dropped: dict[str, int] = {}
        self.slips = self.gaps = 0
        self._imu: list[ImuSample] = []
        self._imu_stamps: list[int] = []
        self._wheel: list[WheelSpeed] = []
        self._scans: list[Scan] = []
        self._last_wheel_ns = -(1 << 62)
        self.last_wheel_used_ns = -(1 << 62)
        self._any_keyframe = False

    def add(self, measurement: Measurement) -> list[OdometryPose]:
        """Take one measurement in; returns the poses that became known (usually none or one)."""
        match measurement:
            case ImuSample():
                self._add_imu(measurement)
            case WheelSpeed() if self.rig.wheel is not None:
                if self._in_time(measurement.stamp_ns, "wheel"):
                    bisect.insort(self._wheel, measurement, key=lambda m: m.stamp_ns)
            case Scan() if self.rig.lidar is not None:
                if self._in_time(measurement.end_ns, "scan"):
                    bisect.insort(self._scans, measurement, key=lambda m: m.end_ns)
            case _:
                return []
        return self._advance()

    def _add_imu(self, sample: ImuSample) -> None:
        if self._imu_stamps and sample.stamp_ns <= self._imu_stamps[-1]:
            self._count("imu")
            return
        if self._imu_stamps and sample.stamp_ns - self._imu_stamps[-1] > _GAP_NS:
            self.gaps += 1
        self._imu.append(sample)
        self._imu_stamps.append(sample.stamp_ns)

    def _in_time(self, stamp_ns: int, what: str) -> bool:
        if stamp_ns > self.filter.stamp_ns:
            return True
        self._count(what)
        return False

    def _count(self, what: str) -> None:
        self.dropped[what] = self.dropped.get(what, 0) + 1

    def _advance(self) -> list[OdometryPose]:
        poses = []
        while self._imu_stamps:
            if self.rig.lidar is None:
                end_ns = self.filter.stamp_ns + _TICK_NS
            elif self._scans:
                end_ns = self._scans[0].end_ns
            else:
                break
            if self._imu_stamps[-1] < end_ns:
                break
            poses.append(self._step(end_ns, self._scans.pop(0) if self.rig.lidar is not None else None))
        return poses

    def _step(self, end_ns: int, scan: Scan | None) -> OdometryPose:
        """One scan: propagate with the wheel on the way, deskew, match, extend the local map."""
        track = self._propagate(end_ns)
        deskewed = np.empty((0, 3))
        matched = considered = 0
        T_imu_lidar = self.filter.state.T_imu_lidar
        if scan is not None and self.map is not None:
            scan = scan.since(track.zero_ns - _TICK_NS // 2)
            sparse = scan.thinned(self.settings.scan_points)
            deskewed = track.deskew(sparse.points, sparse.offsets_ns, sparse.stamp_ns, T_imu_lidar)
            surfaces = self.map.surfaces(sparse, deskewed)
            matched, considered = self.map.match(surfaces, self.filter)
            self.map.extend(surfaces, self.filter)
        keyframe, since_keyframe = self._keyframe_rule()
        if keyframe and scan is not None:
            deskewed = track.deskew(scan.points, scan.offsets_ns, scan.stamp_ns, T_imu_lidar)
        return OdometryPose(
            end_ns, self.filter.state.copy(), self.filter.P.copy(), deskewed, matched, considered, keyframe,
            since_keyframe,
        )  # fmt: skip

    def _keyframe_rule(self) -> tuple[bool, Array]:
        """Whether this pose is a keyframe (paper 004 Eq. 8, 9; the first is), and its covariance since the last one."""
        s, covariance = self.filter.state, self.filter.covariance_since_clone()
        dT = inverse(s.T_odom_clone) @ s.T_odom_imu
        moved = np.linalg.norm(dT[:3, 3]) > self.keyframes.distance
        turned = rotation_angle(dT[:3, :3]) > self.keyframes.angle
        if not (moved or turned or not self._any_keyframe):
            return False, covariance
        self._any_keyframe = True
        self.filter.clone_pose()
        return True, covariance

    def _propagate(self, end_ns: int) -> InertialTrack:
        tracks = []
        while self._wheel and self._wheel[0].stamp_ns <= end_ns:
            reading = self._wheel.pop(0)
            if reading.stamp_ns - self._last_wheel_ns < self.settings.wheel_interval_s * 1e9:
                continue
            if reading.stamp_ns > self.filter.stamp_ns:
                tracks.append(self._predict(reading.stamp_ns))
                self._last_wheel_ns = reading.stamp_ns
                self._take_wheel(reading, tracks[-1].rate[-1] + self.filter.state.gyro_bias)
        if end_ns > self.filter.stamp_ns or not tracks:
            tracks.append(self._predict(end_ns))
        return joined(tracks)

    def _predict(self, end_ns: int) -> InertialTrack:
        """Propagate from the filter's time to ``end_ns``, with the IMU interpolated at both ends."""
        begin_ns = self.filter.stamp_ns
        first = max(0, bisect.bisect_right(self._imu_stamps, begin_ns) - 1)
        last = bisect.bisect_left(self._imu_stamps, end_ns)
        samples = self._imu[first : last + 1]
        stamps = np.array([sample.stamp_ns for sample in samples], np.int64)
        gyro, accel = np.array([s.gyro for s in samples]), np.array([s.accel for s in samples])
        inside = stamps[(stamps > begin_ns) & (stamps < end_ns)]
        at = np.concatenate([[begin_ns], inside, [end_ns]]).astype(np.int64)
        t, x = (stamps - stamps[0]) * 1e-9, (at - stamps[0]) * 1e-9
        track = self.filter.predict(
            at,
            np.stack([np.interp(x, t, gyro[:, axis]) for axis in range(3)], axis=-1),
            np.stack([np.interp(x, t, accel[:, axis]) for axis in range(3)], axis=-1),
        )
        del self._imu[:first], self._imu_stamps[:first]
        return track

    def _take_wheel(self, reading: WheelSpeed, gyro: Array) -> None:
        assert self.rig.wheel is not None
        s = self.settings
        forward = np.hypot(self.rig.wheel.speed_std, s.wheel_scale_std * reading.speed)
        model = WheelVelocity(reading.speed, gyro, np.array([forward, s.sideways_std, s.sideways_std]))
        if model.forward_mahalanobis2(self.filter.state, self.filter.P) > s.slip_gate:
            self.slips += 1
            return
        self.filter.update(model)
        self.last_wheel_used_ns = reading.stamp_ns
