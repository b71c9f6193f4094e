"""The local map of the odometry: voxels that each hold the plane of the points that fell in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localize._numba_voxels import EMPTY, downsample, insert, point_to_plane, rehash
from semmap.geometry import Array


class VoxelMap:
    """Planes by voxel in odom.

    Parameters
    ----------
    size : edge of a voxel [m].
    max_points : points after which a voxel stays as it is (early poses are the least drifted).
    min_points : points a plane needs.
    """

    def __init__(self, size: float, *, max_points: int, min_points: int = 6) -> None:
        self.size, self.max_points, self.min_points = size, max_points, min_points
        self._keys = np.full(1 << 16, EMPTY, np.int64)
        self._cells = np.zeros(1 << 16, np.int64)
        self._allocate(1 << 15)
        self._used = 0

    def __len__(self) -> int:
        return self._used

    def _allocate(self, capacity: int) -> None:
        self._count = np.zeros(capacity, np.int64)
        self._mean, self._normal = np.zeros((capacity, 3)), np.zeros((capacity, 3))
        self._scatter, self._variance = np.zeros((capacity, 6)), np.full(capacity, -1.0)
        self._spread = np.zeros((capacity, 2, 3))
        self._added, self._hit = np.zeros(capacity, np.int64), np.empty(capacity, np.int64)

    def insert(self, points: Array) -> float:
        """Add points (n, 3) in the map frame; returns how new the map is where they are: the share (0 to 1) of the
        points of a voxel that came with this call, in the mean over the voxels that were hit."""
        self._make_room(len(points))
        self._used, share = insert(
            points, 1.0 / self.size, self.max_points, self.min_points, self._keys, self._cells, self._used,
            self._count, self._mean, self._scatter, self._normal, self._variance, self._spread, self._added, self._hit,
        )  # fmt: skip
        return share

    def _make_room(self, n: int) -> None:
        capacity = len(self._count)
        while self._used + n > capacity:
            capacity *= 2
        if capacity > len(self._count):
            old = (self._count, self._mean, self._scatter, self._normal, self._variance, self._spread)
            self._allocate(capacity)
            new = (self._count, self._mean, self._scatter, self._normal, self._variance, self._spread)
            for source, target in zip(old, new, strict=True):
                target[: self._used] = source[: self._used]
        table = len(self._keys)
        while 2 * (self._used + n) > table:
            table *= 2
        if table > len(self._keys):
            keys, cells = np.full(table, EMPTY, np.int64), np.zeros(table, np.int64)
            rehash(self._keys, self._cells, keys, cells)
            self._keys, self._cells = keys, cells

    def planes(self) -> tuple[Array, Array, Array]:
        """Means (n, 3), unit normals (n, 3) and variances along them (n,) [m²] of the voxels that have a plane."""
        has = np.flatnonzero(self._variance[: self._used] >= 0.0)
        return self._mean[has], self._normal[has], self._variance[has]

    def point_to_plane(
        self, points: Array, T_odom_imu: Array, T_imu_lidar: Array, *, range_variance: float, beam_variance: float, gate: float
    ) -> tuple[Array, Array, Array, Array, Array, int]:
        """A (12, 12), b (12,), residuals (n,), sigmas (n,) and the number of matches; see the kernel."""
        A, b, B = np.empty((12, 12)), np.empty(12), np.empty((12, 12))
        residuals, sigmas = np.empty(len(points)), np.empty(len(points))
        matched = point_to_plane(
            points,
            np.ascontiguousarray(T_odom_imu[:3, :3]), np.ascontiguousarray(T_odom_imu[:3, 3]),
            np.ascontiguousarray(T_imu_lidar[:3, :3]), np.ascontiguousarray(T_imu_lidar[:3, 3]),
            self.size, self._keys, self._cells, self._count, self._mean, self._normal, self._variance, self._spread,
            range_variance, beam_variance, gate, A, b, B, residuals, sigmas,
        )  # fmt: skip
        return A, b, B, residuals, sigmas, matched


def voxel_means(points: Array | NDArray[np.float32], size: float) -> Array:
    """Mean of the points (n, 3) in each voxel of edge ``size`` [m], in the order in which voxels are met."""
    table = 1 << max(8, int(np.ceil(np.log2(2 * max(len(points), 1)))))
    out = np.empty((len(points), 3))
    m = downsample(
        np.ascontiguousarray(points, np.float64), 1.0 / size, np.empty(table, np.int64), np.empty(table, np.int64),
        np.empty(len(points), np.int64), out,
    )  # fmt: skip
    return out[:m]
