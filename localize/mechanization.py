"""Inertial navigation with coning and sculling from two intervals (paper 002 Eq. 8 to 12), on a turning earth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localize._numba_mechanization import mechanize
from localize.earth import Earth
from semmap.geometry import Array, se3


@dataclass(frozen=True, slots=True, eq=False)
class Increments:
    """Integrals over the intervals between n + 1 stamps, in the imu frame.

    stamps_ns : (n + 1,). angle : (n, 3) of the rate [rad]. velocity : (n, 3) of the specific force [m/s].
    """

    stamps_ns: NDArray[np.int64]
    angle: Array
    velocity: Array

    @classmethod
    def of_samples(cls, stamps_ns: NDArray[np.int64], gyro: Array, accel: Array) -> Increments:
        """From samples (n + 1, 3) [rad/s, m/s²] without bias, that change evenly from one to the next."""
        dt = np.diff(stamps_ns)[:, None] * 1e-9
        return cls(stamps_ns, 0.5 * dt * (gyro[1:] + gyro[:-1]), 0.5 * dt * (accel[1:] + accel[:-1]))


@dataclass(frozen=True, slots=True, eq=False)
class NavigationTrack:
    """Attitude R (n, 3, 3) of the imu, velocity v and position p (n, 3) [m/s, m] in map axes at stamps (n,)."""

    stamps_ns: NDArray[np.int64]
    R: Array
    v: Array
    p: Array

    @property
    def poses(self) -> Array:
        """``T_map_imu`` (n, 4, 4)."""
        return se3(self.R, self.p)


class Navigator:
    """Attitude, velocity and position carried on from increment to increment.

    The print of Eq. 11 leaves out gravity and Coriolis, and Eq. 9 the turning of the navigation frame; both are here.
    Consecutive calls remember the last interval, which Eq. 8 and 11 need.

    Parameters
    ----------
    R, v, p : attitude (3, 3) of the imu, velocity [m/s] and position [m] in map axes.
    """

    def __init__(self, R: Array, v: Array, p: Array, earth: Earth) -> None:
        self.R, self.v, self.p, self.earth = R, v, p, earth
        self._angle, self._velocity, self._dt = np.zeros(3), np.zeros(3), 0.0

    def run(self, increments: Increments) -> NavigationTrack:
        """Navigate over the increments (n,); the track (n + 1,) begins with the state before them."""
        dt = np.diff(increments.stamps_ns) * 1e-9
        n = len(dt)
        track = NavigationTrack(increments.stamps_ns, np.empty((n + 1, 3, 3)), *np.empty((2, n + 1, 3)))
        mechanize(
            self.R, self.v, self.p, increments.angle, increments.velocity, dt, self._angle, self._velocity, self._dt,
            self.earth.rate, self.earth.gravity, self.earth.transport, track.R, track.v, track.p,
        )  # fmt: skip
        if n:
            self.R, self.v, self.p = track.R[-1].copy(), track.v[-1].copy(), track.p[-1].copy()
            self._angle, self._velocity, self._dt = increments.angle[-1], increments.velocity[-1], float(dt[-1])
        return track
