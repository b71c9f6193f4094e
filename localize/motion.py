"""Other predictions for the same filter, where there is no IMU: keeping the speed, or following odometry."""

from __future__ import annotations

import numpy as np

from localize.filter import ErrorStateFilter
from localize.state import POSITION, ROTATION, VELOCITY
from semmap.geometry import Array, skew, so3_exp


def coast(filter: ErrorStateFilter, stamp_ns: int, density: Array) -> None:
    """Go on at constant velocity until ``stamp_ns``; the attitude stays.

    density : (3,) of the white acceleration that may act along the axes of odom [m/s²/√Hz].
    """
    dt = (stamp_ns - filter.stamp_ns) * 1e-9
    F, Q = np.eye(6), np.zeros((6, 6))
    F[:3, 3:] = dt * np.eye(3)
    power = np.diag(np.asarray(density) ** 2)
    Q[:3, :3], Q[3:, 3:] = power * dt**3 / 3.0, power * dt
    Q[:3, 3:] = Q[3:, :3] = power * dt**2 / 2.0
    filter.state.p += dt * filter.state.v
    filter.transition(stamp_ns, np.r_[POSITION, VELOCITY], F, Q)


def follow(filter: ErrorStateFilter, stamp_ns: int, moved: Array, turned: Array, std: Array) -> None:
    """Go on by what odometry says the imu moved by, in its own axes halfway through the turn.

    moved : (3,) [m]; turned : (3,) rotation vector [rad]; std : (6,) of both, rotation first.
    """
    state = filter.state
    R_half = state.R @ so3_exp(0.5 * np.asarray(turned))
    F, G = np.eye(6), np.zeros((6, 6))
    F[:3, :3] = so3_exp(turned).T
    # an error of the attitude at the beginning turns the step
    F[3:, :3] = -R_half @ skew(moved) @ so3_exp(0.5 * np.asarray(turned)).T
    G[:3, :3] = np.eye(3)
    G[3:, 3:] = R_half
    G[3:, :3] = -0.5 * R_half @ skew(moved)
    state.p += R_half @ moved
    state.R = state.R @ so3_exp(turned)
    filter.transition(stamp_ns, np.r_[ROTATION, POSITION], F, G @ np.diag(np.asarray(std) ** 2) @ G.T)
