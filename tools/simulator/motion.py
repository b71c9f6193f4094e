"""Motion along a smooth path: pose and all derivatives at any time, in closed form.

The path is a quintic B-spline ``p(q)``, the progress along it another, ``q(t)``. Heading and slope follow
from the path, wobble is a sum of sines of the distance travelled, vibration a sum of sines of time; nothing
is differenced.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from localize.earth import Earth
from semmap.geometry import Array, inverse, se3
from semmap.rig import STANDARD_GRAVITY
from tools.simulator.angles import Angles, direction
from tools.simulator.route import CONTROL_STEP
from tools.simulator.settings import MotionSettings
from tools.simulator.spline import UniformSpline
from tools.simulator.vibration import oil_pumps

_TIME_STEP = 0.25
_STOP_S = 1.0
"""[s] at rest at the end of the route."""
_SIDE_ACCELERATION = 1.0
"""[m/s²] most in a bend."""
_WOBBLE_WAVELENGTHS = np.array([3.0, 12.0])
_VIBRATION_HZ = np.array([15.0, 60.0])
_WAVES = 6

Derivatives = tuple[Array, Array, Array]


@dataclass(frozen=True, slots=True, eq=False)
class MotionState:
    """Motion of the IMU at n times.

    position, velocity, acceleration : (n, 3) in the map frame [m, m/s, m/s²].
    R_map_imu : (n, 3, 3); angular_velocity, angular_acceleration : (n, 3) in the imu frame [rad/s, rad/s²].
    """

    position: Array
    velocity: Array
    acceleration: Array
    R_map_imu: Array
    angular_velocity: Array
    angular_acceleration: Array

    def poses(self) -> Array:
        """``T_map_imu`` (n, 4, 4)."""
        return se3(self.R_map_imu, self.position)

    def specific_force(self) -> Array:
        """What an ideal accelerometer reads (n, 3), ``R^T (a - g)`` with g downwards [m/s², imu frame]."""
        a = self.acceleration + np.array([0.0, 0.0, STANDARD_GRAVITY])
        return np.asarray(np.einsum("nji,nj->ni", self.R_map_imu, a))

    def felt(self, earth: Earth) -> tuple[Array, Array]:
        """What an ideal IMU reads on a turning earth: rates (n, 3) [rad/s] and specific force (n, 3) [m/s²]."""
        v = self.velocity
        turning = earth.rate + v @ earth.transport.T
        a = self.acceleration - [0.0, 0.0, -earth.gravity] + np.cross(turning + earth.rate, v)
        in_imu = [np.einsum("nji,nj->ni", self.R_map_imu, x) for x in (turning, a)]
        return self.angular_velocity + in_imu[0], in_imu[1]

    def point(self, p_imu: Array) -> Array:
        """Positions (n, 3) in the map frame of a point fixed to the body, ``p_imu`` (3,)."""
        return np.asarray(self.position + self.R_map_imu @ np.asarray(p_imu))

    def of(self, T_imu_other: Array) -> MotionState:
        """Motion of another frame (4, 4) that is fixed to the body."""
        R, p = T_imu_other[:3, :3], T_imu_other[:3, 3]
        w, a = self.angular_velocity, self.angular_acceleration
        swung = np.cross(a, p) + np.cross(w, np.cross(w, p))
        return MotionState(
            self.point(p),
            self.velocity + np.einsum("nij,nj->ni", self.R_map_imu, np.cross(w, p)),
            self.acceleration + np.einsum("nij,nj->ni", self.R_map_imu, swung),
            self.R_map_imu @ R,
            w @ R,
            a @ R,
        )

    def shaken(self, shake: Derivatives) -> MotionState:
        """Moved by as much (n, 3), with its two derivatives."""
        x, v, a = shake
        return replace(self, position=self.position + x, velocity=self.velocity + v, acceleration=self.acceleration + a)

    def point_velocity(self, p_imu: Array) -> Array:
        """Velocities (n, 3) of that point, in the imu frame: ``R^T v + ω x p`` (paper 000, Eq. 10)."""
        v_imu = np.einsum("nji,nj->ni", self.R_map_imu, self.velocity)
        return np.asarray(v_imu + np.cross(self.angular_velocity, p_imu))


class Motion:
    """The motion over a route: from rest, at cruising speed where the bends allow it, to rest.

    Parameters
    ----------
    controls : (n, 3) control points of the path, half a metre apart, map frame; see `control_points`.
    settings : speed, limits, wobble, vibration.
    seed : of the phases of wobble and vibration.
    T_imu_wheel : (4, 4) of a wheel that the robot stands on: it goes where it heads, and the floor's bumps pitch it;
        else the IMU goes along the path, and roll and pitch are about it.

    Attributes
    ----------
    duration_s : from standing still to standing still; length : of the path [m].
    """

    def __init__(self, controls: Array, settings: MotionSettings, seed: int, T_imu_wheel: Array | None = None) -> None:
        self._origin = np.round(controls.mean(axis=0))
        self._T_imu_wheel = T_imu_wheel
        self._path = UniformSpline(controls - self._origin, CONTROL_STEP, ends="straight")
        times, progress, self.length = _scheduled(self._path, settings)
        count = int(np.ceil(times[-1] / _TIME_STEP)) + 1
        self._progress = UniformSpline(
            np.interp(np.arange(count) * _TIME_STEP, times, progress), _TIME_STEP, ends="rest"
        )
        self.duration_s = self._progress.end
        self._follow_slope = settings.follow_slope
        rng = np.random.default_rng([seed, 5])
        over_path, over_time = 2.0 * np.pi / _WOBBLE_WAVELENGTHS, 2.0 * np.pi * _VIBRATION_HZ
        self._wobble = _Sines.draw(rng, over_path, np.radians(settings.wobble_deg))
        if settings.pumps:
            self._shaking, self._twisting = _pumping(settings, seed)
        else:
            self._shaking = _Sines.draw(rng, over_time, settings.vibration_accel, integrals=2)
            self._twisting = _Sines.draw(rng, over_time, settings.vibration_gyro, integrals=1)

    def __call__(self, t: Array) -> MotionState:
        """State at times ``t`` (n,) [s] since the start, clamped to the motion's duration."""
        t = np.asarray(t, dtype=np.float64)
        q = tuple(self._progress(t, order)[:, None] for order in range(3))
        path = tuple(self._path(q[0][:, 0], order) for order in range(4))
        if self._T_imu_wheel is not None:
            path = self._over_bumps(path, q[0][:, 0])
        angles = self._angles(path, q) + Angles(*self._twisting(t))
        position, velocity, acceleration = _in_time((path[0], path[1], path[2]), q)
        motion = MotionState(
            position + self._origin,
            velocity,
            acceleration,
            angles.rotation(),
            angles.angular_velocity(),
            angles.angular_acceleration(),
        )
        if self._T_imu_wheel is not None:
            motion = motion.of(inverse(self._T_imu_wheel))
        return motion.shaken(self._shaking(t))

    def _over_bumps(self, path: tuple[Array, ...], q: Array) -> tuple[Array, ...]:
        """The wheel's path, with three derivatives: below the IMU's, over bumps as steep as the wobble's pitch."""
        assert self._T_imu_wheel is not None
        slope, height = self._wobble(q), self._wobble.integral()(q)[0]
        below = self._T_imu_wheel[2, 3]
        up = (below - height[:, 1], -slope[0][:, 1], -slope[1][:, 1], -slope[2][:, 1])
        return tuple(along + h[:, None] * [0.0, 0.0, 1.0] for along, h in zip(path, up, strict=True))

    def _angles(self, path: tuple[Array, ...], q: tuple[Array, ...]) -> Angles:
        """Yaw along the path, pitch along its slope if that is followed, wobble of roll and pitch.

        A wheel follows the slope, and its pitch is the bumps'.
        """
        x, y, z = ((path[1][:, axis], path[2][:, axis], path[3][:, axis]) for axis in range(3))
        yaw = direction(x, y)
        over_path = [np.zeros((len(q[0]), 3)) for _ in range(3)]
        for order in range(3):
            over_path[order][:, 2] = yaw[order]
        on_wheel = self._T_imu_wheel is not None
        if self._follow_slope or on_wheel:
            for order, slope in enumerate(direction(_length(x, y), z)):
                over_path[order][:, 1] = -slope
        for order, wobble in enumerate(self._wobble(q[0][:, 0])):
            over_path[order][:, : 1 if on_wheel else 2] += wobble[:, : 1 if on_wheel else 2]
        return Angles(*_in_time((over_path[0], over_path[1], over_path[2]), q))


@dataclass(frozen=True, slots=True, eq=False)
class _Sines:
    """Three sums of sines: ``frequencies``, ``amplitudes``, ``phases`` (w, 3)."""

    frequencies: Array
    amplitudes: Array
    phases: Array

    @classmethod
    def draw(cls, rng: np.random.Generator, band: Array, rms: float, *, integrals: int = 0) -> _Sines:
        """Random sines in ``band`` [rad per unit]; the ``integrals``-th derivative of each sum has this RMS."""
        frequencies = rng.uniform(band.min(), band.max(), size=(_WAVES, 3))
        amplitudes = rms * np.sqrt(2.0 / _WAVES) / frequencies**integrals
        return cls(frequencies, amplitudes, rng.uniform(0.0, 2.0 * np.pi, size=(_WAVES, 3)))

    def integral(self) -> _Sines:
        """Sines whose derivative these are."""
        return _Sines(self.frequencies, self.amplitudes / self.frequencies, self.phases - 0.5 * np.pi)

    def __call__(self, x: Array) -> Derivatives:
        """Values (n, 3) and two derivatives at ``x`` (n,)."""
        if not self.amplitudes.any():
            zero = np.zeros((len(x), 3))
            return zero, zero, zero
        w = self.frequencies
        phase = x[:, None, None] * w + self.phases
        sine, cosine = self.amplitudes * np.sin(phase), self.amplitudes * np.cos(phase)
        return sine.sum(axis=1), (w * cosine).sum(axis=1), -(w * w * sine).sum(axis=1)


def _pumping(settings: MotionSettings, seed: int) -> tuple[_Sines, _Sines]:
    """What the oil pumps do to position [m] and angles [rad]."""
    pumps = oil_pumps(seed, gyro_rms=settings.vibration_gyro, accel_rms=settings.vibration_accel)
    w = np.repeat(2.0 * np.pi * pumps.hz[:, None], 3, axis=1)
    # a sine's second derivative is itself, backwards; a cosine is a sine's first
    return (
        _Sines(w, pumps.shaking / w**2, pumps.shaking_phase + np.pi),
        _Sines(w, pumps.turning / w, pumps.turning_phase),
    )


def _in_time(f: Derivatives, q: tuple[Array, ...]) -> Derivatives:
    """Chain rule: ``f(q)`` and its derivatives by q into derivatives by time."""
    return f[0], f[1] * q[1], f[2] * q[1] ** 2 + f[1] * q[2]


def _length(x: Derivatives, y: Derivatives) -> Derivatives:
    """``sqrt(x² + y²)`` and its two derivatives."""
    length = np.hypot(x[0], y[0])
    first = (x[0] * x[1] + y[0] * y[1]) / length
    second = (x[1] ** 2 + y[1] ** 2 + x[0] * x[2] + y[0] * y[2] - first**2) / length
    return length, first, second


def _scheduled(path: UniformSpline, settings: MotionSettings) -> tuple[Array, Array, float]:
    """Times (n,) [s] at which the path parameter reaches values (n,), and the metres driven.

    Once from end to end; or from place to place of the schedule, with rests there, forwards or in reverse.
    """
    q = np.linspace(0.0, path.end, max(3, round(path.end / 0.1) + 1))
    along = _distances(path, q)
    if not settings.schedule:
        legs = [(q, 0.0)]
    else:
        places = [0.0, *(min(metres, along[-1]) for metres, _ in settings.schedule)]
        ends = np.interp(places, along, q)
        count = [max(3, round(abs(b - a) / 0.1) + 1) for a, b in pairwise(places)]
        legs = [
            (np.linspace(a, b, n), rest_s)
            for (a, b), n, (_, rest_s) in zip(pairwise(ends), count, settings.schedule, strict=True)
        ]
    times, progress, length = [np.array([settings.still_s])], [q[:1]], 0.0
    for at, rest_s in legs:
        durations, metres = _timetable(path, at, settings)
        times += [times[-1][-1] + np.cumsum(durations)]
        progress += [at[1:]]
        times += [times[-1][-1:] + rest_s] * (rest_s > 0.0)
        progress += [at[-1:]] * (rest_s > 0.0)
        length += metres
    times.append(times[-1][-1:] + _STOP_S)
    progress.append(progress[-1][-1:])
    return np.concatenate(times), np.concatenate(progress), length


def _distances(path: UniformSpline, q: Array) -> Array:
    """Metres (n,) along the path at parameters (n,), whichever way these go."""
    pace = np.linalg.norm(path(q, 1), axis=1)
    return np.concatenate([[0.0], np.cumsum(0.5 * (pace[1:] + pace[:-1]) * np.abs(np.diff(q)))])


def _timetable(path: UniformSpline, q: Array, settings: MotionSettings) -> tuple[Array, float]:
    """Durations (n - 1,) [s] from rest to rest between path parameters (n,), and their way [m].

    The speed is limited by the cruising speed and the bends; then by the acceleration, forwards and
    backwards.
    """
    first, second = path(q, 1), path(q, 2)
    pace = np.linalg.norm(first, axis=1)
    bend = np.linalg.norm(np.cross(first, second), axis=1) / pace**3
    distance = _distances(path, q)
    bend = np.maximum(bend, 1e-6)
    square = (
        np.minimum(settings.speed, np.minimum(settings.max_yaw_rate / bend, np.sqrt(_SIDE_ACCELERATION / bend))) ** 2
    )
    square[[0, -1]] = 0.0
    gain = 2.0 * settings.max_accel * distance
    square = np.minimum.accumulate(square - gain) + gain
    square = np.minimum.accumulate((square + gain)[::-1])[::-1] - gain
    speed = np.sqrt(np.maximum(square, 0.0))
    return 2.0 * np.diff(distance) / (speed[1:] + speed[:-1]), float(distance[-1])
