"""Where the frames of a run lie to one another: the shifted map it works in, and odom when it begins anew."""

from __future__ import annotations

import numpy as np

from localize.state import ODOM, POSITION, ROTATION, NavState
from semmap.geometry import Array, se3, skew, yaw_of, yaw_rotation
from semmap.intersections import SemanticMap
from semmap.rig import Rig

_ROUND_M = 1000.0
"""Map coordinates are worked with relative to a multiple of this."""


def round_origin(rig: Rig, semantic_map: SemanticMap | None) -> Array:
    """A round point near everything surveyed (3,), so that the graph works with small numbers."""
    if semantic_map is not None:
        return np.asarray(semantic_map.origin, dtype=np.float64)
    if rig.uwb is not None:
        surveyed = np.mean(list(rig.uwb.anchors.values()), axis=0)
    elif rig.total_station is not None:
        surveyed = np.array(rig.total_station.position)
    else:
        return np.zeros(3)
    rounded: Array = _ROUND_M * np.round(surveyed / _ROUND_M)
    return rounded


def shifted(poses: Array, shift: Array) -> Array:
    """Poses (n, 4, 4) moved by a translation (3,)."""
    moved = poses.copy()
    moved[:, :3, 3] += shift
    return moved


def going_on(T_odom_last: Array, T_begin: Array) -> Array:
    """Place (4, 4) in odom of a new odometry, whose first pose (4, 4) shall go on where the old one ended, upright."""
    R = yaw_rotation(yaw_of(T_odom_last[:3, :3]) - yaw_of(T_begin[:3, :3]))
    T: Array = se3(R, T_odom_last[:3, 3] - R @ T_begin[:3, 3])
    return T


def in_map(state: NavState, P: Array) -> tuple[Array, Array]:
    """``T_map_imu`` (4, 4) as a filter knows it that knows where odom lies, and its covariance (6, 6), rotation first,
    perturbed on the right; ``P`` (dim, dim) in the order of `localize.state`."""
    assert state.T_map_odom is not None
    T = state.T_map_odom @ state.T_odom_imu
    R_imu_map = T[:3, :3].T
    J = np.zeros((6, len(P)))
    J[:3, ROTATION], J[:3, ODOM.start : ODOM.start + 3] = np.eye(3), R_imu_map
    J[3:, POSITION] = state.R.T
    J[3:, ODOM] = R_imu_map @ np.hstack([-skew(T[:3, 3] - state.odom_centre), np.eye(3)])
    return T, np.asarray(J @ P @ J.T)
