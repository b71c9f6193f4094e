"""Other predictions for the same filter, where there is no IMU: keeping the speed, or following odometry."""

from __future__ import annotations

import numpy as np

from localize.filter import ErrorStateFilter
from localize.state import ERROR_DIM, POSITION, ROTATION, VELOCITY, NavState
from semmap.geometry import Array, skew, so3_exp
from semmap.rig import STANDARD_GRAVITY, ImuBlock


def tracker(
    stamp_ns: int,
    p_map: Array,
    covariance: Array,
    *,
    R_map_imu: Array | None = None,
    velocity_std: Array | float = 0.0,
    yaw_std: float = 0.0,
    range_scale_std: float = 0.0,
) -> ErrorStateFilter:
    """A filter without an IMU that starts at ``p_map`` (3,), known by ``covariance`` (3, 3); odom is the map.

    What is tracked is the tag. velocity_std : (3,) of its velocity, which starts at zero [m/s]; yaw_std : of the
    attitude ``R_map_imu`` (3, 3) about the vertical [rad]; range_scale_std : of the ranges' scale.
    """
    state = NavState(
        R=np.eye(3) if R_map_imu is None else R_map_imu.copy(), p=np.array(p_map, dtype=np.float64), v=np.zeros(3),
        gyro_bias=np.zeros(3), accel_bias=np.zeros(3), g=np.array([0.0, 0.0, -STANDARD_GRAVITY]),
        T_imu_lidar=np.eye(4), T_imu_tag=np.eye(4), T_imu_wheel=np.eye(4),
        T_odom_clone=np.eye(4), T_odom_map=np.eye(4), map_centre=np.zeros(3),
    )  # fmt: skip
    filter = ErrorStateFilter(state, np.zeros((ERROR_DIM, ERROR_DIM)), stamp_ns, ImuBlock(topic=""))
    filter.locate(np.eye(4), np.zeros((6, 6)), range_scale_std=range_scale_std)
    filter.P[POSITION, POSITION] = covariance
    filter.P[VELOCITY, VELOCITY] = np.diag(np.broadcast_to(velocity_std, 3) ** 2)
    up = state.R.T[:, 2]
    filter.P[ROTATION, ROTATION] = yaw_std**2 * np.outer(up, up)
    return filter


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
