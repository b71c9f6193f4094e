"""The wheel to the filter: forward speed and the non-holonomic constraint (paper 000 Eq. 10 to 13)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localize.filter import Information, information
from localize.state import GYRO_BIAS, ROTATION, VELOCITY, WHEEL, NavState
from semmap.geometry import Array, skew

_COLUMNS = np.r_[ROTATION, VELOCITY, GYRO_BIAS, WHEEL]


@dataclass(frozen=True, slots=True)
class WheelVelocity:
    """``r = ŵ - R_iwᵀ(Rᵀv + ω x p_iw)`` with ω the gyro less its bias (paper 000 Eq. 12, 13).

    speed : forward speed [m/s]; gyro : (3,) measured rate [rad/s] at the same time.
    std : (3,) standard deviation of forward, sideways and upward velocity [m/s].
    """

    speed: float
    gyro: Array
    std: Array

    def residual(self, state: NavState) -> Array:
        """Residual (3,) [m/s]."""
        R_wi, p = state.T_imu_wheel[:3, :3].T, state.T_imu_wheel[:3, 3]
        rate = self.gyro - state.gyro_bias
        return np.array([self.speed, 0.0, 0.0]) - R_wi @ (state.R.T @ state.v + np.cross(rate, p))

    def jacobian(self, state: NavState) -> Array:
        """Jacobian (3, 15) of the residual by rotation, velocity, gyro bias and wheel extrinsic."""
        R_wi, p = state.T_imu_wheel[:3, :3].T, state.T_imu_wheel[:3, 3]
        rate, v_imu = self.gyro - state.gyro_bias, state.R.T @ state.v
        H = np.empty((3, 15))
        H[:, 0:3] = -R_wi @ skew(v_imu)
        H[:, 3:6] = -R_wi @ state.R.T
        H[:, 6:9] = -R_wi @ skew(p)
        H[:, 9:12] = -skew(R_wi @ (v_imu + np.cross(rate, p)))
        H[:, 12:15] = -R_wi @ skew(rate)
        return H

    def linearize(self, state: NavState) -> Information:
        return information(self.residual(state), self.jacobian(state), np.diag(self.std**2), _COLUMNS)

    def forward_mahalanobis2(self, state: NavState, P: Array) -> float:
        """Squared Mahalanobis distance of the forward speed alone, to tell slip."""
        h = self.jacobian(state)[0]
        variance = h @ P[np.ix_(_COLUMNS, _COLUMNS)] @ h + self.std[0] ** 2
        return float(self.residual(state)[0] ** 2 / variance)
