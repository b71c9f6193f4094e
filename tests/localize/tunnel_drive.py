"""A drive through a tunnel for the tests of wheel and slip: IMU, wheel, and a LiDAR that sees walls and floor only."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from localize.filter import ErrorStateFilter, Information, information, start_covariance
from localize.settings import OdometrySettings
from localize.slip import WheelFusion
from localize.state import POSITION, ROTATION, SCALE, NavState
from semmap.geometry import Array, so3_log
from semmap.measurements import WheelSpeed
from semmap.rig import ImuBlock, WheelBlock

IMU = ImuBlock(topic="/imu", gyro_bias_std=0.002, accel_bias_std=0.03)
WHEEL = WheelBlock(topic="/wheel", p_imu_wheel=(-0.1, 0.0, -0.35))
RATE, STEP = 200, 20
"""IMU samples a second, and from one wheel reading to the next."""
G = np.array([0.0, 0.0, -9.80665])

Profile = Callable[[float], float]


@dataclass
class Walls:
    """Attitude and place across the tunnel, as walls and floor give them, and along it where ``along_std`` is given."""

    R: Array
    p: Array
    along_std: float | None

    def linearize(self, state: NavState) -> Information:
        axes = [1, 2] if self.along_std is None else [0, 1, 2]
        r = np.concatenate([so3_log(self.R.T @ state.R), (state.p - self.p)[axes]])
        H = np.zeros((len(r), 6))
        H[:3, :3] = np.eye(3)
        H[3:, 3:] = np.eye(3)[axes]
        std = [0.002] * 3 + [0.005] * 2 if self.along_std is None else [0.002] * 3 + [self.along_std] + [0.005] * 2
        return information(r, H, np.diag(np.square(std)), np.r_[ROTATION, POSITION])


@dataclass
class Step:
    """One tenth of a second: time [s], error of the distance [m] and its deviation, the wheel's scale and its own."""

    t: float
    off_m: float
    along_std: float
    scale: float
    scale_std: float
    wheel: WheelFusion

    @property
    def gripped_s(self) -> float:
        return self.wheel.gripped_ns * 1e-9


def drive(
    seed: int, seconds: float, *, speed: Profile, slip: Profile, scale: float = 1.0, seen: Profile = lambda t: 0.0
) -> Iterator[Step]:
    """Drive along x at ``speed`` [m/s] by time; the wheel reads ``1 + slip`` times ``scale`` too much, and where
    ``seen`` the LiDAR sees along the tunnel as well."""
    rng = np.random.default_rng([seed, 77])
    settings = OdometrySettings()
    R, g = np.eye(3), G
    start = NavState(
        R=R, p=np.zeros(3), v=np.array([speed(0.0), 0.0, 0.0]), gyro_bias=np.zeros(3), accel_bias=np.zeros(3), g=g,
        T_imu_lidar=np.eye(4), T_imu_tag=np.eye(4), T_imu_wheel=WHEEL.T_imu_wheel, T_odom_clone=np.eye(4),
        T_odom_map=np.eye(4), map_centre=np.zeros(3),
    )  # fmt: skip
    P = start_covariance(IMU, tilt_std=0.01, velocity_std=0.1, g=g, mountings=settings.extrinsics)
    P[SCALE, SCALE] = settings.wheel_scale_std**2
    filter, wheel = ErrorStateFilter(start, P, 0, IMU), WheelFusion(WHEEL, settings)
    bias = np.concatenate([IMU.gyro_bias_std * rng.normal(size=3), IMU.accel_bias_std * rng.normal(size=3)])
    walk = np.repeat([IMU.gyro_bias_walk, IMU.accel_bias_walk], 3) / np.sqrt(RATE)
    white = np.repeat([IMU.gyro_noise, IMU.accel_noise], 3) * np.sqrt(RATE)
    x = 0.0
    last = None
    for k in range(int(seconds * RATE / STEP)):
        t = (k * STEP + np.arange(STEP + 1)) / RATE
        v = np.array([speed(one) for one in t])
        force = np.stack([np.gradient(v, t), np.zeros_like(t), np.full_like(t, -g[2])], axis=1)
        bias = bias + walk * np.sqrt(STEP) * rng.normal(size=6)
        noisy = np.hstack([np.zeros_like(force), force]) + bias + white * rng.normal(size=(STEP + 1, 6))
        if last is not None:
            noisy[0] = last
        last = noisy[-1]
        track = filter.predict(np.rint(t * 1e9).astype(np.int64), noisy[:, :3], noisy[:, 3:])
        x += float(np.trapezoid(v, t))
        now = t[-1]
        p = np.array([x, 0.0, 0.0]) + 0.005 * rng.normal(size=3)
        filter.update(Walls(R, p, 0.01 if seen(now) else None))
        reading = v[-1] * (1.0 + slip(now)) / scale + WHEEL.speed_std * rng.normal()
        wheel.take(WheelSpeed(int(now * 1e9), reading), track.rate[-1] + filter.state.gyro_bias, filter)
        state, std = filter.state, np.sqrt(np.diag(filter.P))
        yield Step(now, state.p[0] - x, std[POSITION][0], state.wheel_scale, std[SCALE][0], wheel)
