"""A machine that shakes where it stands: a pump's tones with their harmonics, and what an IMU on it reads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semmap.geometry import Array, so3_exp, so3_left_jacobian

_HARMONICS = np.array([1.0, 0.5, 0.3, 0.15])
"""Amplitude of each multiple of a pump's frequency, relative to the first."""
_PUMPS_HZ = ((23.5, 25.5), (14.0, 16.0))
"""Rotation of a four-pole motor under load, and of the slower pump beside it."""


@dataclass(frozen=True, slots=True, eq=False)
class Vibration:
    """Small rotations and displacements about rest: sums of tones.

    hz : (k,). turning, turning_phase : (k, 3) amplitudes of the rate [rad/s] and phases [rad].
    shaking, shaking_phase : (k, 3) amplitudes of the acceleration [m/s²] and phases.
    """

    hz: Array
    turning: Array
    turning_phase: Array
    shaking: Array
    shaking_phase: Array

    def angles(self, t: Array) -> tuple[Array, Array]:
        """Rotation vectors (n, 3) [rad] from rest at times (n,) [s], and their derivatives (n, 3) [rad/s]."""
        w = 2.0 * np.pi * self.hz[:, None]
        phase = t[:, None, None] * w + self.turning_phase
        return (self.turning / w * np.sin(phase)).sum(axis=1), (self.turning * np.cos(phase)).sum(axis=1)

    def acceleration(self, t: Array) -> Array:
        """(n, 3) [m/s²] in the frame of the body at rest."""
        phase = 2.0 * np.pi * t[:, None, None] * self.hz[:, None] + self.shaking_phase
        return np.asarray((self.shaking * np.sin(phase)).sum(axis=1))


def oil_pumps(seed: int, *, gyro_rms: float = 0.01, accel_rms: float = 0.5) -> Vibration:
    """Two pumps with four harmonics each, in directions and phases of their own.

    gyro_rms, accel_rms : of all tones together, per axis on average [rad/s, m/s²].
    """
    rng = np.random.default_rng([seed, 17])
    hz = np.concatenate([rng.uniform(*band) * np.arange(1, len(_HARMONICS) + 1) for band in _PUMPS_HZ])
    shape = np.tile(_HARMONICS, len(_PUMPS_HZ))[:, None] * rng.uniform(0.3, 1.0, size=(len(hz), 3))
    shape *= np.sqrt(2.0 * 3.0 / np.sum(shape**2))
    phases = rng.uniform(0.0, 2.0 * np.pi, size=(2, len(hz), 3))
    return Vibration(hz, gyro_rms * shape, phases[0], accel_rms * shape, phases[1])


def standing_imu(
    t: Array, R_map_imu: Array, *, earth_rate: Array, gravity: float, vibration: Vibration | None
) -> tuple[Array, Array]:
    """Exact rates (n, 3) [rad/s] and specific force (n, 3) [m/s²] of an IMU on a machine that stands, at t (n,) [s].

    R_map_imu : (3, 3) at rest. earth_rate : (3,) in map axes [rad/s]. gravity : [m/s²], down.
    """
    up = np.array([0.0, 0.0, gravity])
    if vibration is None:
        return np.tile(R_map_imu.T @ earth_rate, (len(t), 1)), np.tile(R_map_imu.T @ up, (len(t), 1))
    theta, theta_dot = vibration.angles(t)
    R = R_map_imu @ so3_exp(theta)
    # the right Jacobian of θ is the left one of -θ
    rate = np.einsum("nij,nj->ni", so3_left_jacobian(-theta), theta_dot)
    acceleration = vibration.acceleration(t) @ R_map_imu.T + up
    return rate + np.einsum("nji,j->ni", R, earth_rate), np.einsum("nji,nj->ni", R, acceleration)
