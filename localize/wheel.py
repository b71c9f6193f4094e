"""The wheel to the filter: forward speed and the non-holonomic constraint (paper 000 Eq. 10 to 13)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localize.filter import Information, information
from localize.state import GYRO_BIAS, ROTATION, SCALE, VELOCITY, WHEEL, NavState
from semmap.geometry import Array, skew

_COLUMNS = np.r_[ROTATION, VELOCITY, GYRO_BIAS, WHEEL, SCALE]


@dataclass(frozen=True, slots=True)
class WheelVelocity:
    """``r = ŵ - D R_iwᵀ(Rᵀv + ω x p_iw)`` with ω the gyro less its bias (paper 000 Eq. 12, 13).

    D divides the forward speed by the wheel's scale. Multiplying ŵ instead would let the filter make the reading's
    noise smaller by making the scale smaller: 1.5 % at 0.3 m/s.

    speed : forward speed [m/s], negative in reverse; gyro : (3,) measured rate [rad/s] at the same time.
    std : (3,) standard deviation of forward, sideways and upward velocity [m/s].
    forward : whether the forward speed is believed; the robot neither jumps nor slides sideways in any case.
    """

    speed: float
    gyro: Array
    std: Array
    forward: bool = True

    def velocity(self, state: NavState) -> Array:
        """Velocity (3,) of the wheel's point in the wheel's axes, ``R_iwᵀ(Rᵀv + ω x p_iw)`` (Eq. 10, 11) [m/s]."""
        R_wi, p = state.T_imu_wheel[:3, :3].T, state.T_imu_wheel[:3, 3]
        return np.asarray(R_wi @ (state.R.T @ state.v + np.cross(self.gyro - state.gyro_bias, p)))

    def residual(self, state: NavState) -> Array:
        """Residual (3,) [m/s]."""
        return np.array([self.speed, 0.0, 0.0]) - _scaled(self.velocity(state), state)

    def jacobian(self, state: NavState) -> Array:
        """Jacobian (3, 16) of the residual by rotation, velocity, gyro bias, wheel extrinsic and scale."""
        R_wi, p = state.T_imu_wheel[:3, :3].T, state.T_imu_wheel[:3, 3]
        velocity = self.velocity(state)
        H = np.zeros((3, 16))
        H[:, 0:3] = -R_wi @ skew(state.R.T @ state.v)
        H[:, 3:6] = -R_wi @ state.R.T
        H[:, 6:9] = -R_wi @ skew(p)
        H[:, 9:12] = -skew(velocity)
        H[:, 12:15] = -R_wi @ skew(self.gyro - state.gyro_bias)
        H[0] /= state.wheel_scale
        H[0, 15] = velocity[0] / state.wheel_scale**2
        return H

    def linearize(self, state: NavState) -> Information:
        rows = slice(0 if self.forward else 1, 3)
        noise = np.diag(self.std[rows] ** 2)
        return information(self.residual(state)[rows], self.jacobian(state)[rows], noise, _COLUMNS)

    def forward_std(self, state: NavState, P: Array) -> float:
        """What the filter expects the forward residual to be off by [m/s], without the reading's own noise."""
        h = self.jacobian(state)[0]
        return float(np.sqrt(h @ P[np.ix_(_COLUMNS, _COLUMNS)] @ h))


def _scaled(velocity: Array, state: NavState) -> Array:
    return np.array([velocity[0] / state.wheel_scale, velocity[1], velocity[2]])
