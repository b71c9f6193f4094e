"""The start, from rest or in motion: the first stretch is run several times until speed and vertical fit it.

At rest the scans repeat themselves, and the speed is known before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from localize.dust import Air
from localize.earth import Earth
from localize.filter import ErrorStateFilter, start_covariance
from localize.first_motion import first_velocity
from localize.moving_start import MovingStart
from localize.odometry import Odometry, OdometryPose
from localize.rest import MOVED_M, still_seconds
from localize.settings import DenoiseSettings, KeyframeSettings, OdometrySettings, PrismSettings
from localize.standing import Standing
from localize.state import GYRO_BIAS, SCALE, NavState
from semmap.geometry import Array, rotation_between, se3
from semmap.measurements import ImuSample, Measurement, PrismFix, Scan, WheelSpeed
from semmap.rig import Rig

if TYPE_CHECKING:
    from localize.denoise_online import OnlineDenoiser

_PASSES = 3
_UP = np.array([0.0, 0.0, 1.0])


class StartingOdometry:
    """`Odometry` that starts itself: it holds the first stretch back, finds speed and tilt, and goes on from there.

    odom is the imu's place at the first IMU sample, turned so that z points up as far as the accelerometer tells;
    what is left of the lean is in the state's gravity.
    """

    def __init__(
        self,
        rig: Rig,
        settings: OdometrySettings,
        keyframes: KeyframeSettings,
        *,
        denoise: DenoiseSettings | None = None,
        prism: PrismSettings | None = None,
        heading_std: float = 0.03,
    ) -> None:
        self.rig, self.settings, self.keyframes = rig, settings, keyframes
        self.prism = prism or PrismSettings()
        denoise = denoise or DenoiseSettings()
        self.earth, self.standing = Earth.of(rig.earth), Standing.of(rig, denoise)
        self.moving = MovingStart.of(rig, heading_std)
        self._denoiser = _denoiser(denoise) if rig.imu.engines else None
        self.odometry: Odometry | None = None
        self._held: list[Measurement] = []
        self.T_odom_start: Array = np.eye(4)
        """Pose (4, 4) of the imu at the first sample; it defines odom."""

    def add(self, measurement: Measurement) -> list[OdometryPose]:
        """Take one measurement in; the poses of the first stretch come all at once at its end.

        Where engines shake the IMU, its samples are cleaned first: poses come later by the filter's ``latency_s``.
        """
        if isinstance(measurement, PrismFix):
            for one in (self.standing, self.moving):
                if one is not None:
                    one.add_fix(measurement)
        if not isinstance(measurement, ImuSample):
            return self._add(measurement)
        if self.standing is not None:
            self.standing.add_sample(measurement)
        if self._denoiser is None:
            return self._add(measurement)
        return [pose for sample in self._denoiser.add(measurement) for pose in self._add(sample)]

    def _add(self, measurement: Measurement) -> list[OdometryPose]:
        if isinstance(measurement, ImuSample) and self.moving is not None:
            self.moving.add_sample(measurement)
        if self.odometry is not None:
            return self.odometry.add(measurement)
        self._held.append(measurement)
        if not isinstance(measurement, ImuSample):
            return []
        first = next(m for m in self._held if isinstance(m, ImuSample))
        if measurement.stamp_ns - first.stamp_ns < self.settings.start_s * 1e9:
            return []
        return self._begin()

    def finish(self) -> list[OdometryPose]:
        """The poses that still wait: for cleaned samples, or for the end of the first stretch."""
        rest = self._denoiser.finish() if self._denoiser is not None else []
        return [pose for sample in rest for pose in self._add(sample)] + self._begin()

    def _begin(self) -> list[OdometryPose]:
        """End the first stretch here."""
        imu = _increasing(self._held)
        if self.odometry is not None or len(imu) < 2:
            return []
        held, self._held = self._held, []
        R = rotation_between(np.mean([sample.accel for sample in imu], axis=0), _UP)
        velocity_std = self._velocity_std(held)
        at_rest = velocity_std < self.settings.start_velocity_std
        v = np.zeros(3) if at_rest else R @ self._first_velocity(held)
        poses: list[OdometryPose] = []
        for _ in range(_PASSES):
            start = self._filter(R, v, imu[0].stamp_ns, velocity_std)
            self.odometry = Odometry(self.rig, self.settings, self.keyframes, start, self.prism)
            self.T_odom_start = se3(R, np.zeros(3))
            poses = [pose for m in held if _usable(m, imu[0].stamp_ns) for pose in self.odometry.add(m)]
            R, refined = self._refined(R, v, poses, imu)
            v = v if at_rest else refined
        return poses

    def _velocity_std(self, held: list[Measurement]) -> float:
        """What is known of the speed at the start [m/s]: at rest, that a motion would have shown in the scans."""
        # dust looks alike from everywhere
        still_s = still_seconds([m.part(Air(m.points).clear) for m in held if isinstance(m, Scan)])
        return min(self.settings.start_velocity_std, MOVED_M / max(still_s, 1e-9))

    def _first_velocity(self, held: list[Measurement]) -> Array:
        """A first guess (3,) of the velocity in the axes of the imu [m/s]: the wheel's, else that between scans."""
        speed = next((m.speed for m in held if isinstance(m, WheelSpeed)), None)
        if speed is not None and self.rig.wheel is not None:
            return self.rig.wheel.T_imu_wheel[:3, 0] * speed
        found = None
        if self.rig.lidar is not None:
            found = first_velocity([m for m in held if isinstance(m, Scan)], self.rig.lidar.T_imu_lidar)
        return np.zeros(3) if found is None else found

    def _refined(self, R: Array, v: Array, poses: list[OdometryPose], imu: list[ImuSample]) -> tuple[Array, Array]:
        """Start attitude and velocity that the first stretch ended up with, carried back to its beginning."""
        if len(poses) < 4:
            return R, v
        end = poses[-1].state
        back = self._filter(R, np.zeros(3), imu[0].stamp_ns, self.settings.start_velocity_std)
        back.state.gyro_bias, back.state.accel_bias, back.state.g = end.gyro_bias, end.accel_bias, end.g
        used = [sample for sample in imu if sample.stamp_ns <= poses[-1].stamp_ns]
        back.predict(
            np.array([sample.stamp_ns for sample in used]),
            np.array([sample.gyro for sample in used]),
            np.array([sample.accel for sample in used]),
        )
        level = rotation_between(-end.g, _UP)
        return level @ R, level @ (end.v - back.state.v)

    def _filter(self, R: Array, v: Array, stamp_ns: int, velocity_std: float) -> ErrorStateFilter:
        rig, s = self.rig, self.settings
        state = NavState(
            R=R.copy(), p=np.zeros(3), v=v.copy(), gyro_bias=np.zeros(3), accel_bias=np.zeros(3),
            g=-self.earth.gravity * _UP,
            T_imu_lidar=rig.lidar.T_imu_lidar if rig.lidar else np.eye(4),
            T_imu_tag=se3(np.eye(3), rig.uwb.p_imu_tag) if rig.uwb else np.eye(4),
            T_imu_wheel=rig.wheel.T_imu_wheel if rig.wheel else np.eye(4),
            T_odom_clone=np.eye(4), T_odom_map=np.eye(4), map_centre=np.zeros(3),
        )  # fmt: skip
        P = start_covariance(
            rig.imu, tilt_std=s.start_tilt_std, velocity_std=velocity_std, g=state.g, mountings=s.extrinsics
        )
        # until north is known, the horizontal part of the earth's rate is in the bias
        P[GYRO_BIAS, GYRO_BIAS] += float(np.sum(self.earth.rate[:2] ** 2)) * np.eye(3)
        if rig.wheel is not None:
            P[SCALE, SCALE] = s.wheel_scale_std**2
        return ErrorStateFilter(state, P, stamp_ns, rig.imu)


def _denoiser(settings: DenoiseSettings) -> OnlineDenoiser:
    # its library takes a second to load, which those who need none should not wait for
    from localize.denoise_online import OnlineDenoiser

    return OnlineDenoiser(settings)


def _increasing(held: list[Measurement]) -> list[ImuSample]:
    """IMU samples without those that repeat a stamp or go back."""
    imu: list[ImuSample] = []
    for m in held:
        if isinstance(m, ImuSample) and (not imu or m.stamp_ns > imu[-1].stamp_ns):
            imu.append(m)
    return imu


def _usable(m: Measurement, begin_ns: int) -> bool:
    return not isinstance(m, Scan) or m.stamp_ns + int(m.offsets_ns.min(initial=0)) >= begin_ns
