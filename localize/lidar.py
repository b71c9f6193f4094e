"""The LiDAR to the filter: points against the planes of the local map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localize.filter import Information
from localize.state import LIDAR, POSITION, ROTATION, NavState
from localize.voxel_map import VoxelMap
from semmap.geometry import Array

_COLUMNS = np.r_[ROTATION, POSITION, LIDAR]


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
    gate: float
    correlation: float
    min_matches: int
    matched: int = 0

    def linearize(self, state: NavState) -> Information | None:
        A, b, residuals, sigmas, self.matched = self.voxels.point_to_plane(
            self.points, state.T_odom_imu, state.T_imu_lidar, range_variance=self.range_variance, gate=self.gate
        )
        if self.matched < self.min_matches:
            return None
        valid = np.isfinite(residuals)
        squared = float(np.sum((residuals[valid] / sigmas[valid]) ** 2))
        return Information(A / self.correlation, b / self.correlation, _COLUMNS, squared, self.matched)
