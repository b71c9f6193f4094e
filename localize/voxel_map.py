"""The local map of the odometry: voxels that each hold the plane, or the edge, of the points that fell in."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from localize import _numba_voxels as kernels
from localize._numba_voxels import EMPTY, crosses, downsample, insert, point_to_shape, rehash
from semmap.geometry import Array

_MIN_POINTS = 6
_MEAN = slice(kernels.MEAN, kernels.MEAN + 3)


class Shapes(IntEnum):
    """What is looked for in the voxels: planes, planes and edges by paper 002 Eq. 30, or edges alone."""

    PLANES = kernels.PLANES
    PLANES_AND_EDGES = kernels.PLANES_AND_EDGES
    EDGES = kernels.EDGES


class RangeNoise(NamedTuple):
    """Variances of one range [m²], along its ray, and of its direction [rad²]."""

    along: float
    across: float


class ShapeMatch(NamedTuple):
    """Points against the shapes of a voxel map, by rotation and position of the imu in its own axes.

    A (6, 6), b (6,) : ``Σ HᵀH/σ²`` and ``-Σ Hᵀr/σ²``. B (6, 6) : covariance of b from the shapes' own errors.
    C (6, 6) : what of A to expect from the noise of the normals alone.
    residuals, sigmas : (n, 2) [m], one across a plane, two across an edge, NaN where there is none.
    matched : points that met a shape.
    """

    A: Array
    b: Array
    B: Array
    C: Array
    residuals: Array
    sigmas: Array
    matched: int


class Renewal(NamedTuple):
    """What the shapes that points fell into tell of the place of the map, turned about a centre and moved, in its axes.

    A (6, 6) : ``Σ HᵀH/σ²`` over them. new (6, 6) : the part of it that came with the points, and all that the noise of
    the normals alone pretends to tell.
    """

    A: Array
    new: Array


class VoxelMap:
    """Planes and edges by voxel, in a frame of their own, ``map`` of `localize.state`.

    Parameters
    ----------
    size : edge of a voxel [m].
    max_points : points after which a voxel stays as it is (early poses are the least drifted).
    shapes : what is looked for.
    """

    def __init__(self, size: float, *, max_points: int, shapes: Shapes = Shapes.PLANES) -> None:
        self.size, self.max_points, self.shapes = size, max_points, shapes
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self._table = np.full((1 << 16, 2), EMPTY, np.int64)
        self._allocate(1 << 15)
        self._used = 0

    def __len__(self) -> int:
        return self._used

    def _allocate(self, capacity: int) -> None:
        self._cells = np.zeros((capacity, kernels.CELL))
        self._added, self._hit = np.zeros(capacity, np.int64), np.empty(capacity, np.int64)

    def insert(self, points: Array, T_map_points: Array, centre: Array | None = None) -> Renewal:
        """Add points (n, 3), which ``T_map_points`` (4, 4) takes into the map; returns how new the map is where they
        are, about ``centre`` (3,), the place the points are told from unless it is given."""
        self._make_room(len(points))
        R, p = _rigid(T_map_points)
        A, new = np.empty((6, 6)), np.empty((6, 6))
        self._used = insert(
            points, R, p, 1.0 / self.size, self.max_points, _MIN_POINTS, int(self.shapes),
            self._table, self._cells, self._used, self._added, self._hit, p if centre is None else centre, A, new,
        )  # fmt: skip
        return Renewal(A, new)

    def _make_room(self, n: int) -> None:
        capacity = len(self._cells)
        while self._used + n > capacity:
            capacity *= 2
        if capacity > len(self._cells):
            old = self._cells
            self._allocate(capacity)
            self._cells[: self._used] = old[: self._used]
        slots = len(self._table)
        while 2 * (self._used + n) > slots:
            slots *= 2
        if slots > len(self._table):
            old_table, self._table = self._table, np.full((slots, 2), EMPTY, np.int64)
            rehash(old_table, self._table)

    def forget_far(self, centre: Array, limit: int) -> None:
        """Where there are more than ``limit`` voxels, keep the half of them nearest to ``centre`` (3,) in the map."""
        if self._used <= limit:
            return
        away2 = np.sum((self._cells[: self._used, _MEAN] - centre) ** 2, axis=1)
        kept = np.sort(np.argsort(away2, kind="stable")[: limit // 2])
        filled = self._table[self._table[:, 0] != EMPTY]
        keys = np.empty(self._used, np.int64)
        keys[filled[:, 1]] = filled[:, 0]
        self._cells[: len(kept)] = self._cells[kept]
        self._used = len(kept)
        self._table = np.full_like(self._table, EMPTY)
        rehash(np.column_stack([keys[kept], np.arange(len(kept))]), self._table)

    def planes(self) -> tuple[Array, Array, Array]:
        """Means (n, 3), unit normals (n, 3) and variances along them (n,) [m²] of the voxels that have a plane."""
        cells = self._of_kind(1)
        return cells[:, _MEAN], cells[:, kernels.AXES : kernels.AXES + 3], cells[:, kernels.VARIANCE]

    def edges(self) -> tuple[Array, Array]:
        """Means (n, 3) and unit directions (n, 3) of the voxels that have an edge."""
        cells = self._of_kind(2)
        return cells[:, _MEAN], cells[:, kernels.AXES + 6 : kernels.AXES + 9]

    def _of_kind(self, rows: int) -> Array:
        cells = self._cells[: self._used]
        return np.asarray(cells[cells[:, kernels.ROWS] == rows])

    def crosses(self, begin: Array, end: Array, first: Array, last: Array) -> NDArray[np.bool_]:
        """Whether straight ways go through a plane (n,), of which the normal and the points stand for a patch of rock.

        begin, end : (n, 3) of the ways. first, last : (n,) between which distances from the begin it counts [m].
        """
        hit = np.empty(len(begin), np.bool_)
        crosses(begin, end, first, last, self.size, self._table, self._cells, hit)
        return hit

    def match(
        self, points: Array, T_map_imu: Array, T_imu_lidar: Array, *, noise: RangeNoise, gate: float
    ) -> ShapeMatch:
        """Points (n, 3) in the lidar frame against the shapes; residuals beyond ``gate`` sigmas are left out."""
        n = len(points)
        A, b, B, C = np.empty((6, 6)), np.empty(6), np.empty((6, 6)), np.empty((6, 6))
        residuals, sigmas = np.empty((n, 2)), np.empty((n, 2))
        matched = point_to_shape(
            points, *_rigid(T_map_imu), *_rigid(T_imu_lidar), self.size, self._table, self._cells,
            noise.along, noise.across, gate, self._added,
            np.empty(n, np.int64), np.empty((2 * n, 8)), np.empty((2 * n, 6)), A, b, B, C, residuals, sigmas,
        )  # fmt: skip
        return ShapeMatch(A, b, B, C, residuals, sigmas, int(matched))


def _rigid(T: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) of a transform, as the kernels want them."""
    return np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])


def voxel_means(points: Array | NDArray[np.float32], size: float) -> Array:
    """Mean of the points (n, 3) in each voxel of edge ``size`` [m], in the order in which voxels are met."""
    table = 1 << max(8, int(np.ceil(np.log2(2 * max(len(points), 1)))))
    out = np.empty((len(points), 3))
    m = downsample(
        np.ascontiguousarray(points, np.float64), 1.0 / size, np.empty((table, 2), np.int64),
        np.empty(len(points), np.int64), out,
    )  # fmt: skip
    return out[:m]
