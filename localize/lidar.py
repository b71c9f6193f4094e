"""The LiDAR to the filter: points against the planes of the local map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localize.filter import Information
from localize.state import LIDAR, MAP, POSITION, ROTATION, NavState
from localize.voxel_map import VoxelMap
from semmap.geometry import Array, inverse

_COLUMNS = np.r_[ROTATION, POSITION, LIDAR, MAP]


@dataclass(slots=True)
class PointToPlane:
    """Point-to-plane residuals ``uᵀ(T_odom_imu T_imu_lidar p - q)`` (paper 000 Eq. 14).

    points : (n, 3) deskewed, in the lidar frame at the state's time.
    range_variance : of one range, and what the voxel's plane adds [m²].
    gate : residuals beyond this many sigmas are left out.
    correlation : how many points share one error of the map; divides the information, since points on one wall
        that was mapped with one pose do not err independently.
    min_matches : fewer say nothing.
    """

    points: Array
    voxels: VoxelMap
    range_variance: float
    beam_variance: float
    gate: float
    correlation: float
    min_matches: int
    matched: int = 0
    map_noise: Array | None = None

    def linearize(self, state: NavState) -> Information | None:
        A, b, B, residuals, sigmas, self.matched = self.voxels.point_to_plane(
            self.points, inverse(state.T_odom_map) @ state.T_odom_imu, state.T_imu_lidar,
            range_variance=self.range_variance, beam_variance=self.beam_variance, gate=self.gate,
        )
        if self.matched < self.min_matches:
            return None
        valid = np.isfinite(residuals)
        squared = float(np.sum((residuals[valid] / sigmas[valid]) ** 2))
        J = _from_map(state)
        self.map_noise = _map_noise(J[:6, :6] @ A[:6, :6] @ J[:6, :6].T, J[:6, :6] @ B[:6, :6] @ J[:6, :6].T, state.R)
        return Information(J @ A @ J.T / self.correlation, J @ b / self.correlation, _COLUMNS, squared, self.matched)


_VAGUE = np.diag([1 / 0.05**2] * 3 + [1 / 0.5**2] * 3)


def _map_noise(A: Array, B: Array, R: Array) -> Array:
    """Covariance (6, 6) of what the errors of the planes together make of a pose matched to them."""
    G = np.linalg.inv(A + _VAGUE)
    J = np.eye(6)
    J[:3, :3] = R
    return J @ G @ B @ G @ J.T


def _from_map(state: NavState) -> Array:
    """(18, 12): what an error of the pose in the map does, an error of the map does the other way round."""
    R_odom_map = state.T_odom_map[:3, :3]
    J = np.zeros((18, 12))
    J[:3, :3] = np.eye(3)
    J[3:6, 3:6] = R_odom_map
    J[6:12, 6:12] = np.eye(6)
    J[12:15, :3] = -state.R
    J[15:18, 3:6] = -R_odom_map
    return J
