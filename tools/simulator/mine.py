"""A mine to be flown through: its rock face, its ray caster, and, if it was planned here, its plan."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from semmap.errors import InputFileError
from semmap.geometry import Array
from tools.simulator.boxes import Samples
from tools.simulator.junctions import Junction, junctions_of
from tools.simulator.raycaster import Raycaster
from tools.simulator.roadways import MineScenario
from tools.simulator.rock import RockField
from tools.simulator.scenarios import plan
from tools.simulator.surface import surface_of

MESH_SUFFIXES = (".ply", ".obj", ".stl", ".off", ".gltf", ".glb")
VOXEL = 0.18
"""[m] grid spacing of built-in mines: a quarter of the shortest wavelength of their rock noise."""


class Mine:
    """A triangle mesh in the map frame, ready for rays.

    Attributes
    ----------
    name : of the scenario or the mesh file.
    origin : (3,) float64, where the vertices' zero lies in the map frame.
    vertices : (n, 3) float32, relative to ``origin`` [m]; triangles : (m, 3) int32.
    raycaster : rays in the map frame.
    scenario : the plan; junctions : its intersections. None and empty for a mesh from a file.
    """

    def __init__(
        self,
        name: str,
        vertices: NDArray[np.floating],
        triangles: NDArray[np.int32],
        origin: Array,
        scenario: MineScenario | None = None,
    ) -> None:
        self.name = name
        self.origin = np.asarray(origin, dtype=np.float64)
        self.vertices = np.ascontiguousarray(vertices, dtype=np.float32)
        self.triangles = np.ascontiguousarray(triangles, dtype=np.int32)
        self.raycaster = Raycaster(self.vertices, self.triangles, self.origin)
        self.scenario = scenario
        self.junctions: tuple[Junction, ...] = junctions_of(scenario) if scenario else ()

    @property
    def area(self) -> float:
        """Area [m²] of the rock face."""
        return float(self._triangle_areas().sum())

    def sample(self, *, spacing: float, noise: float, seed: int) -> Array:
        """Points (n, 3) float64, map frame, spread evenly at random: one for each ``spacing``² of rock.

        ``noise`` is the standard deviation of each coordinate [m].
        """
        rng = np.random.default_rng([seed, 3])
        points = self.spread(spacing, rng).points
        return np.asarray(points + noise * rng.normal(size=points.shape))

    def spread(self, spacing: float, rng: np.random.Generator) -> Samples:
        """Points on the rock without noise, spread evenly at random, and where the air is."""
        areas = self._triangle_areas()
        count = max(1, round(areas.sum() / spacing**2))
        share = (np.arange(count) + rng.uniform(size=count)) / count
        owner = np.minimum(np.searchsorted(np.cumsum(areas) / areas.sum(), share), len(areas) - 1)
        a, b = np.sort(rng.uniform(size=(2, count)), axis=0)[:, :, None]
        p, q, r = np.moveaxis(self.vertices[self.triangles[owner]].astype(np.float64), 1, 0)
        normals = np.cross(q - p, r - p)
        normals *= -np.sign(self._volume()) / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        return Samples(a * p + (b - a) * q + (1.0 - b) * r + self.origin, normals)

    def save_mesh(self, path: str | Path) -> None:
        """Write the mesh (.ply, .obj, .stl) in map coordinates."""
        mesh = o3d.geometry.TriangleMesh(
            o3d.utility.Vector3dVector(self.vertices.astype(np.float64) + self.origin),
            o3d.utility.Vector3iVector(self.triangles),
        )
        mesh.compute_triangle_normals()
        if not o3d.io.write_triangle_mesh(Path(path), mesh):
            raise InputFileError("cannot be written", file=path, mend="end its name in .ply, .obj or .stl")

    def _triangle_areas(self) -> Array:
        p, q, r = np.moveaxis(self.vertices[self.triangles].astype(np.float64), 1, 0)
        return np.asarray(0.5 * np.linalg.norm(np.cross(q - p, r - p), axis=1))

    def _volume(self) -> float:
        """Volume [m³] of the closed mesh, positive where its triangles are wound to look outwards."""
        p, q, r = np.moveaxis(self.vertices[self.triangles].astype(np.float64), 1, 0)
        return float(np.einsum("ij,ij->", p, np.cross(q, r)) / 6.0)


def dig(scenario: MineScenario, *, voxel: float = VOXEL, progress: Callable[[int, int], None] | None = None) -> Mine:
    """Turn a plan into a mine; ``progress(done, total)`` counts blocks of rock."""
    vertices, triangles = surface_of(RockField(scenario), voxel, progress)
    return Mine(scenario.name, vertices, triangles, np.array(scenario.origin), scenario)


def scenario(name: str, seed: int = 0, *, progress: Callable[[int, int], None] | None = None) -> Mine:
    """A built-in mine, see `tools.simulator.scenarios`. Raises `InputFileError` for an unknown name."""
    return dig(plan(name, seed), progress=progress)


def load_mesh(path: str | Path) -> Mine:
    """A mine from a triangle mesh file in metres, z up.

    Raises `InputFileError` where the file is missing, of another kind, empty, or holds NaN.
    """
    path = Path(path)
    if not path.is_file():
        raise InputFileError("no such file", file=path, mend="check the path")
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputFileError("is not a mesh file", file=path, mend=f"give one of {', '.join(MESH_SUFFIXES)}")
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        mesh = o3d.io.read_triangle_mesh(path)
    vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    if not len(triangles):
        raise InputFileError("holds no triangles", file=path, mend="give a triangle mesh, not a point cloud")
    if not np.isfinite(vertices).all() or triangles.min() < 0 or triangles.max() >= len(vertices):
        raise InputFileError("holds vertices that are not finite, or lost", file=path, mend="repair the mesh")
    origin = np.round(0.5 * (vertices.min(axis=0) + vertices.max(axis=0)))
    return Mine(path.stem, vertices - origin, triangles, origin)
