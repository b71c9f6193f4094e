"""Rays against a mine's triangles: the doorkeeper of Open3D's ray caster."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from semmap.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """What rays met first.

    distances : (n,) [m], infinite where nothing was hit; cosines : (n,) of the angle of incidence, 0 to 1.
    """

    distances: NDArray[np.float32]
    cosines: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Where verticals meet rock.

    owners : (m,) which vertical, ascending; heights : (m,) [m, map frame], ascending in each vertical.
    """

    owners: NDArray[np.int64]
    heights: Array


class Raycaster:
    """Rays through a fixed mesh.

    Parameters
    ----------
    vertices : (n, 3) [m], relative to ``origin``.
    triangles : (m, 3) indices.
    origin : (3,) of the vertices in the map frame; rays are given in the map frame.
    """

    def __init__(self, vertices: NDArray[np.floating], triangles: NDArray[np.int32], origin: Array) -> None:
        self._origin = np.asarray(origin, dtype=np.float64)
        self._top = float(np.max(vertices[:, 2])) + 1.0
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            o3d.core.Tensor.from_numpy(np.ascontiguousarray(vertices, dtype=np.float32)),
            o3d.core.Tensor.from_numpy(np.ascontiguousarray(triangles, dtype=np.uint32)),
        )

    def cast(self, starts: Array, directions: NDArray[np.floating]) -> Hits:
        """First hits of rays from ``starts`` (n, 3) along unit ``directions`` (n, 3), map frame."""
        rays = np.empty((len(starts), 6), np.float32)
        rays[:, :3], rays[:, 3:] = starts - self._origin, directions
        answer = self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays))
        normals = answer["primitive_normals"].numpy()
        cosines = np.abs(np.einsum("ij,ij->i", normals, rays[:, 3:]))
        return Hits(answer["t_hit"].numpy(), cosines)

    def columns(self, plan: Array) -> Columns:
        """All rock on the verticals through plan positions (n, 2), map frame."""
        rays = np.empty((len(plan), 6), np.float32)
        rays[:, :2], rays[:, 2], rays[:, 3:] = plan - self._origin[:2], self._top, (0.0, 0.0, -1.0)
        answer = self._scene.list_intersections(o3d.core.Tensor.from_numpy(rays))
        owners = answer["ray_ids"].numpy().astype(np.int64)
        heights = self._origin[2] + self._top - answer["t_hit"].numpy().astype(np.float64)
        order = np.lexsort((heights, owners))
        return Columns(owners[order], heights[order])

    def free_way(self, starts: Array, ends: Array) -> Array:
        """How far (n,) [m] the way from ``starts`` (n, 3) to ``ends`` (n, 3) is free, infinite if all of it."""
        steps = ends - starts
        lengths = np.linalg.norm(steps, axis=1)
        distances = self.cast(starts, steps / np.maximum(lengths, 1e-9)[:, None]).distances.astype(np.float64)
        return np.where(distances < lengths, distances, np.inf)

    def from_rock(self, points: Array) -> Array:
        """Vectors (n, 3) [m] to points (n, 3), map frame, from the rock nearest to each."""
        local = (points - self._origin).astype(np.float32)
        nearest = self._scene.compute_closest_points(o3d.core.Tensor.from_numpy(local))["points"].numpy()
        return np.asarray(local - nearest, dtype=np.float64)

    def clearance(self, points: Array) -> Array:
        """Distance (n,) [m] from points (n, 3), map frame, to the nearest rock."""
        return np.asarray(np.linalg.norm(self.from_rock(points), axis=1))
