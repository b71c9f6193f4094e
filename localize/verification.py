"""The ICP check: does the stack fit the cloud of an intersection (paper 004 section 3.2, step 9; Eq. 29 to 32)?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from localize.settings import VerificationSettings
from localize.voxel_map import voxel_means
from semmap.geometry import Array, se3, transform
from semmap.intersections import Intersection

_COARSE_DISTANCE = 1.5
"""Pairs of the first ICP stage [m]: what the invariant point and the best yaw may be off."""
_NEIGHBOURS = 20
"""Points a normal of the map is estimated from."""
_CORRELATION = 20.0
"""Neighbouring pairs share one error of map and odometry; divides the information."""


@dataclass(frozen=True, slots=True)
class Verification:
    """How well a stack fits an intersection.

    T_map_local : (4, 4) the stack's frame in the map, from the registration.
    fit : part of the compared points that lie on the map's surfaces, in [0, 1].
    icp_distance : root mean square distance of those points to the surface [m].
    points : number of points compared.
    covariance : (6, 6) of ``T_map_local``, rotation first, perturbed on the right; large along a smooth tunnel.
    """

    T_map_local: Array
    fit: float
    icp_distance: float
    points: int
    covariance: Array


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

    def verify(
        self,
        points: NDArray[np.float32],
        p_local: Array,
        intersection: Intersection,
        yaw: float,
        *,
        completeness: float = 1.0,
    ) -> Verification:
        """Register stack points (n, 3) that see an intersection at ``p_local`` (3,), turned by ``yaw`` [rad].

        ``completeness`` is k_c/k_b of paper 004 Eq. 32: a partial view makes the variance larger (read as PAPERS says).
        """
        s = self.settings
        target = self._target(intersection)
        near = np.linalg.norm(points[:, :2] - p_local[:2], axis=1) < s.radius
        source = voxel_means(points[near], s.voxel)
        c, n = np.cos(yaw), np.sin(yaw)
        R = np.array([[c, -n, 0.0], [n, c, 0.0], [0.0, 0.0, 1.0]])
        T = se3(R, -R @ p_local)
        if len(source) >= 50:
            T = self._icp(source, target, T)
        moved = transform(T, source)
        distance, nearest = target.tree.query(moved, distance_upper_bound=2.0 * s.max_distance)
        paired = np.isfinite(distance)
        surface = np.full(len(source), np.inf)
        mate = nearest[paired]
        surface[paired] = np.abs(np.sum((moved[paired] - target.points[mate]) * target.normals[mate], axis=1))
        fits = surface < s.max_distance / 2.0
        covariance = self._covariance(source[fits], target.normals[nearest[fits]] @ T[:3, :3], completeness)
        return Verification(
            se3(T[:3, :3], T[:3, 3] + intersection.p_map),
            float(np.mean(fits)) if len(source) else 0.0,
            float(np.sqrt(np.mean(surface[fits] ** 2))) if fits.any() else np.inf,
            len(source),
            covariance,
        )

    def _icp(self, source: Array, target: _Target, T: Array) -> Array:
        """Point-to-plane ICP, coarse to fine so that what the map lacks drops out; one thread gives the same bytes."""
        cloud = small_gicp.PointCloud(source)
        near = self.settings.max_distance
        for distance in (_COARSE_DISTANCE, 2.0 * near, near):
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
        information = H.T @ H / (variance * _CORRELATION)
        # a direction that no surface holds keeps a metre, so that the matrix has an inverse
        covariance: Array = np.linalg.inv(information + np.eye(6))
        return covariance

    def _target(self, intersection: Intersection) -> _Target:
        if intersection.id not in self._targets:
            points = voxel_means(intersection.cloud, self.settings.voxel / 2.0)
            cloud = small_gicp.PointCloud(points)
            cloud_tree = small_gicp.KdTree(cloud)
            small_gicp.estimate_normals(cloud, cloud_tree, num_neighbors=_NEIGHBOURS)
            normals = np.array(cloud.normals())[:, :3]
            self._targets[intersection.id] = _Target(cloud, cloud_tree, cKDTree(points), points, normals)
        return self._targets[intersection.id]
