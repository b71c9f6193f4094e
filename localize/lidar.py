"""The LiDAR to the filter: points against the planes, and edges, of the local map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from localize._numba_knowledge import beyond_noise
from localize._numba_update import columns_of
from localize.filter import Information
from localize.state import LIDAR, MAP, POSITION, ROTATION, NavState
from localize.voxel_map import RangeNoise, ShapeMatch, VoxelMap
from semmap.geometry import Array, inverse

_COLUMNS = np.r_[ROTATION, POSITION, LIDAR, MAP]
VAGUE = np.diag(np.repeat([0.05**-2, 0.5**-2], 3))
"""Where planes leave a direction open, their errors there are taken to be within 0.05 rad and 0.5 m."""

_BLIND_FROM = 0.5
"""A scan is blind along a direction of which so much of what it seems to know is noise: that is known to half of it.
Up to there its knowledge fades: the errors of a few stones ahead, seen scan by scan, are one and not many."""
_SEES_ALL = np.zeros((6, 0))


class ScanPart(NamedTuple):
    """Points (n, 3), deskewed, in the lidar frame at the state's time, and the map they are matched to."""

    points: Array
    voxels: VoxelMap


@dataclass(slots=True)
class ScanToMap:
    """Residuals ``uᵀ(T_map_imu T_imu_lidar p - q)`` of a scan against the local map (paper 000 Eq. 14, 002 Eq. 31).

    The map lies as wrong as the poses it was built from: its place ``T_odom_map`` is a state like the pose, with the
    opposite Jacobian. So the filter knows the pose in the map well and the pose in odom only as well as the map's.

    parts : the scan.
    noise : of the ranges.
    gate : residuals beyond this many sigmas are left out.
    correlation : how many points share one error beyond that of their plane; divides the information.
    min_matches : fewer say nothing.
    pose_information : (6, 6) of the last linearization, over rotation and position of the imu in its own axes.
    doubt : (6, 6) after `linearize`: directions as columns, rotation first, in the imu's axes, as long as noise is to
        knowledge along each, 1 at the most.
    blind : (6, m) unit directions that span those in which it is, of which the scan says nothing.
    """

    parts: Sequence[ScanPart]
    noise: RangeNoise
    gate: float
    correlation: float
    min_matches: int
    matched: int = field(default=0, init=False)
    pose_information: Array | None = field(default=None, init=False)
    blind: Array = field(default_factory=lambda: _SEES_ALL, init=False)
    doubt: Array = field(default_factory=lambda: np.zeros((6, 6)), init=False)
    _at: NavState | None = field(default=None, init=False)
    _met: list[ShapeMatch] = field(default_factory=list, init=False)

    def linearize(self, state: NavState) -> Information | None:
        matches = self._matches(state)
        if self.matched < self.min_matches:
            return None
        J = _columns_of(state)
        A, b, _, self.doubt, self.blind = _beyond_noise(matches)
        self.pose_information = A / self.correlation
        return Information(
            J @ A @ J.T / self.correlation, J @ b / self.correlation, _COLUMNS,
            (J @ self.blind).T if self.blind.size else None,
        )  # fmt: skip

    def map_noise(self, state: NavState) -> Array | None:
        """Covariance (6, 6) of ``[φ, t]`` that the errors of the shapes together give to the place of the map.

        ``A⁻¹ B A⁻¹``: what a pose errs by that is matched to shapes which are each off by themselves. None where the
        scan meets too little of the map.
        """
        matches = self._matches(state)
        if self.matched < self.min_matches:
            return None
        J = np.zeros((6, 6))
        J[:3, :3] = J[3:, 3:] = state.R
        A, _, B, *_ = _beyond_noise(matches)
        G = J @ np.linalg.inv(A + VAGUE)
        return np.asarray(G @ B @ G.T)

    def _matches(self, state: NavState) -> list[ShapeMatch]:
        if state is self._at:
            return self._met
        self._at = state
        T_map_imu = inverse(state.T_odom_map) @ state.T_odom_imu
        self._met = [
            part.voxels.match(part.points, T_map_imu, state.T_imu_lidar, noise=self.noise, gate=self.gate)
            for part in self.parts
        ]
        self.matched = sum(match.matched for match in self._met)
        return self._met


class _Knowledge(NamedTuple):
    """What a scan knows: A, b and B as in `ShapeMatch`, ``doubt`` and ``blind`` as in `ScanToMap`."""

    A: Array
    b: Array
    B: Array
    doubt: Array
    blind: Array


def _beyond_noise(matches: Sequence[ShapeMatch]) -> _Knowledge:
    """``A``, ``b`` and ``B`` of the scan, without what the noise of the normals pretends to know.

    Along a smooth tunnel every normal leans by chance a little along the axis. Summed over a thousand points the small
    leanings look like centimetres of knowledge, of which there is none: errors in the variables. Along a direction in
    which a share γ of A comes from them, the solution of least squares is too small by ``1 - γ`` and its variance too
    small by its square; both are put right, and where noise explains most, the scan is blind. Rotation and position
    each for themselves, so that a well known attitude does not lend its knowledge to the axis.
    """
    A, b, B, C = (np.asarray(sum(getattr(match, name) for match in matches)) for name in ("A", "b", "B", "C"))
    doubt = np.empty((6, 6))
    blind = beyond_noise(A, b, B, C, _BLIND_FROM, doubt)
    return _Knowledge(A, b, B, doubt, _whole(doubt) if blind else _SEES_ALL)


def _whole(doubt: Array) -> Array:
    """Unit directions (6, m) that span the columns of length 1."""
    blind = doubt[:, np.sum(doubt**2, axis=0) > 1.0 - 1e-9]
    return np.linalg.svd(blind)[0][:, : blind.shape[1]]


def _columns_of(state: NavState) -> Array:
    """(18, 6) from the imu's own axes to the columns of the state.

    A point is moved alike by the pose, by the LiDAR's place on the robot, and, the other way round, by the map.
    """
    J = np.zeros((18, 6))
    R, T_imu_lidar = np.ascontiguousarray(state.R), np.ascontiguousarray(state.T_imu_lidar)
    columns_of(R, T_imu_lidar, state.p - state.map_centre, J)
    return J
