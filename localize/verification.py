"""The ICP check: does the stack fit the cloud of an intersection (paper 004 section 3.2, step 9; Eq. 29 to 32)?"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from localize.settings import VerificationSettings
from localize.voxel_map import voxel_means
from semmap.geometry import Array, inverse, se3, se3_log, transform, yaw_rotation
from semmap.intersections import Intersection

_COARSE_DISTANCE = 1.5
"""Pairs of the first ICP stage [m]: what the invariant point and the best yaw may be off."""
_COARSE_POINTS = 600
"""Points that a first look takes, spread evenly."""
_LEAST_POINTS = 50
"""Fewer points are not registered."""
_NEIGHBOURS = 20
"""Points a normal of the map is estimated from."""
_MAP_VOXEL = 0.125
"""Points of the map are averaged over voxels of this edge [m]."""
_BENT = 16.8
"""Squared Mahalanobis distance from which a stack's place is not the newest keyframe's own (one of a hundred is larger,
with 6 degrees of freedom)."""
_SHARED_M2 = 1.25
"""Pairs on so much wall share one error of map and odometry; divides the information."""


@dataclass(frozen=True, slots=True)
class Verification:
    """How well a stack fits an intersection.

    T_map_local : (4, 4) the stack's frame in the map, from the registration.
    fit : part of the compared points that lie on the map's surfaces, in [0, 1].
    likeness : mean of ``exp(-d² / 2σ²)`` over the points' distances from the surfaces, σ the noise of a pair; rock that
        is only alike fits within decimetres, the same rock within centimetres.
    icp_distance : root mean square distance of the points that fit [m].
    points : number of points compared.
    covariance : (6, 6) of ``T_map_local``, rotation first, perturbed on the right; large along a smooth tunnel.
    """

    T_map_local: Array
    fit: float
    likeness: float
    icp_distance: float
    points: int
    covariance: Array


def start_of(p_local: Array, yaw: float) -> Array:
    """Where ICP starts (4, 4): an intersection's point seen at ``p_local`` (3,), turned by ``yaw`` [rad]."""
    R = yaw_rotation(yaw)
    return se3(R, -R @ p_local)


@dataclass(frozen=True, slots=True)
class _Target:
    """An intersection's cloud made ready to register, and as points (n, 3) with normals (n, 3) to score against."""

    cloud: small_gicp.PointCloud
    cloud_tree: small_gicp.KdTree
    tree: cKDTree
    points: Array
    normals: Array


class Verifier:
    """Registers stacks to intersections; keeps each intersection's prepared cloud."""

    def __init__(self, settings: VerificationSettings) -> None:
        self.settings = settings
        self._targets: dict[int, _Target] = {}

    def around(self, points: NDArray[np.float32], p_local: Array) -> Array:
        """The points (n, 3) of a stack that are compared: those around ``p_local`` (3,), thinned (m, 3)."""
        near = np.linalg.norm(points[:, :2] - p_local[:2], axis=1) < self.settings.radius
        return voxel_means(points[near], self.settings.voxel)

    def first_look(self, points: Array, intersection: Intersection, T_cloud_local: Array) -> tuple[Array, float]:
        """A quick registration of a few of the points (m, 3): where it leads to (4, 4), and the likeness there."""
        few = points[:: max(1, len(points) // _COARSE_POINTS)]
        target, distance = self._target(intersection), 2.0 * self.settings.max_distance
        T = self._icp(few, target, T_cloud_local, (_COARSE_DISTANCE, distance))
        surface, _ = self._distances(few, target, T)
        return T, self._likeness(surface)

    def verify(
        self, points: Array, intersection: Intersection, T_cloud_local: Array, *, completeness: float = 1.0
    ) -> Verification:
        """Register the points (m, 3) of `around` to an intersection, from ``T_cloud_local`` (4, 4) near the answer.

        ``T_cloud_local`` takes them into the frame of the intersection's cloud. ``completeness`` is k_c/k_b of paper
        004 Eq. 32, read so that a partial view makes the variance larger.
        """
        s, target = self.settings, self._target(intersection)
        T = self._icp(points, target, T_cloud_local, (2.0 * s.max_distance, s.max_distance))
        surface, nearest = self._distances(points, target, T)
        fits = surface < s.max_distance / 2.0
        covariance = self._covariance(points[fits], target.normals[nearest[fits]] @ T[:3, :3], completeness)
        return Verification(
            se3(T[:3, :3], T[:3, 3] + intersection.p_map),
            float(np.mean(fits)) if len(points) else 0.0,
            self._likeness(surface),
            float(np.sqrt(np.mean(surface[fits] ** 2))) if fits.any() else np.inf,
            len(points),
            covariance,
        )

    def unbent(self, stacks: Verification, own: Array, intersection: Intersection, floor: Array) -> Verification:
        """A stack's verification with the place that the newest keyframe's ``own`` points (m, 3) have by themselves, if
        the two contradict each other.

        Then the stack is bent: behind a smooth drift odometry may err for some metres without knowing it, and older
        keyframes pull the newest along. floor : (6, 6) least covariance of either place.
        """
        if len(own) < self.settings.min_points:
            return stacks
        T_cloud_local = se3(stacks.T_map_local[:3, :3], stacks.T_map_local[:3, 3] - intersection.p_map)
        alone = self.verify(own, intersection, T_cloud_local)
        apart = se3_log(inverse(stacks.T_map_local) @ alone.T_map_local)
        if apart @ np.linalg.solve(stacks.covariance + alone.covariance + 2.0 * floor, apart) < _BENT:
            return stacks
        return replace(stacks, T_map_local=alone.T_map_local, covariance=alone.covariance)

    def _distances(self, points: Array, target: _Target, T: Array) -> tuple[Array, NDArray[np.intp]]:
        """Of each point (n,) how far it is from the map's surface, infinite where there is none, and the nearest."""
        moved = transform(T, points)
        distance, nearest = target.tree.query(moved, distance_upper_bound=2.0 * self.settings.max_distance)
        paired = np.isfinite(distance)
        surface = np.full(len(points), np.inf)
        mate = nearest[paired]
        surface[paired] = np.abs(np.sum((moved[paired] - target.points[mate]) * target.normals[mate], axis=1))
        return surface, nearest

    def _likeness(self, surface: Array) -> float:
        return float(np.mean(np.exp(-0.5 * (surface / self.settings.point_std) ** 2))) if len(surface) else 0.0

    def _icp(self, points: Array, target: _Target, T: Array, distances: tuple[float, ...]) -> Array:
        """Point-to-plane ICP, coarse to fine so that what the map lacks drops out; one thread gives the same bytes."""
        if len(points) < _LEAST_POINTS:
            return T
        cloud = small_gicp.PointCloud(points)
        for distance in distances:
            result = small_gicp.align(
                target.cloud, cloud, target.cloud_tree, T, registration_type="PLANE_ICP",
                max_correspondence_distance=distance, num_threads=1, max_iterations=10,
            )  # fmt: skip
            T = np.array(result.T_target_source)
        return T

    def _covariance(self, points: Array, normals: Array, completeness: float) -> Array:
        """Inverse of ``Σ HᵀΛ⁻¹H`` over the pairs (paper 004 Eq. 30, which prints the sum as a covariance)."""
        if len(points) < 6:
            return np.eye(6) * 1e6
        H = np.concatenate([np.cross(points, normals), normals], axis=1)
        variance = self.settings.point_std**2 / max(completeness, 0.1)
        information = H.T @ H / (variance * _SHARED_M2 / self.settings.voxel**2)
        # a direction that no surface holds keeps a metre, so that the matrix has an inverse
        covariance: Array = np.linalg.inv(information + np.eye(6))
        return covariance

    def _target(self, intersection: Intersection) -> _Target:
        if intersection.id not in self._targets:
            points = voxel_means(intersection.cloud, _MAP_VOXEL)
            cloud = small_gicp.PointCloud(points)
            cloud_tree = small_gicp.KdTree(cloud)
            small_gicp.estimate_normals(cloud, cloud_tree, num_neighbors=_NEIGHBOURS)
            normals = np.array(cloud.normals())[:, :3]
            self._targets[intersection.id] = _Target(cloud, cloud_tree, cKDTree(points), points, normals)
        return self._targets[intersection.id]
