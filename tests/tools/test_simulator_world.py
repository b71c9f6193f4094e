"""The dug mines: closed, of the size that was planned, as rough as planned, and with the junctions of the plan."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from semmap.errors import InputFileError
from tools.simulator import SCENARIOS, Mine, MineScenario, Roadway, dig, fly, load_mesh, plan
from tools.simulator.junctions import junctions_of
from tools.simulator.waves import PlaneWaves

ARCHED = Roadway("a", "b", 5.0, 3.6, "arched", 0.0)
MILLIONS = (4_512_300.0, 1_234_500.0, -820.0)


@cache
def built_in(name: str) -> Mine:
    """A built-in mine on a coarser grid, which is dug faster."""
    return dig(plan(name), voxel=0.3)


def straight(roadway: Roadway, *, seed: int = 0, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> MineScenario:
    nodes = {"a": (0.0, 0.3, 0.0), "b": (40.0, 0.3, 0.0)}
    return MineScenario("straight", nodes, (roadway,), ("a", "b"), relief=0.0, origin=origin, seed=seed)


def enclosed_volume(mine: Mine) -> float:
    """Signed by the winding: negative where the normals point inwards."""
    p, q, r = np.moveaxis(mine.vertices[mine.triangles].astype(np.float64), 1, 0)
    return float(np.einsum("ij,ij->i", p, np.cross(q, r)).sum() / 6.0)


def walls_seen(mine: Mine, y: float, height: float, side: float) -> np.ndarray:
    """Distances to one wall along a straight roadway, seen from its axis."""
    x = np.arange(6.0, 34.0, 0.05)
    starts = np.column_stack([x, np.full_like(x, y), np.full_like(x, height)])
    return mine.raycaster.cast(starts, np.broadcast_to([0.0, side, 0.0], starts.shape)).distances


@pytest.mark.parametrize("name", SCENARIOS)
def test_built_in_mines_are_closed_and_in_one_piece(name: str) -> None:
    mine = built_in(name)
    edges = np.sort(mine.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, shared = np.unique(edges[:, 0].astype(np.int64) * len(mine.vertices) + edges[:, 1], return_counts=True)
    assert (shared % 2 == 0).all()
    assert (shared == 2).mean() > 0.995
    assert enclosed_volume(mine) < 0.0


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_route_of_a_built_in_mine_keeps_clear_of_the_rock(name: str) -> None:
    mine = built_in(name)
    motion = fly(mine).motion
    p = motion(np.arange(0.0, motion.duration_s, 0.2)).position
    assert mine.raycaster.clearance(p).min() > 0.6


def test_a_rectangular_section_has_its_width_height_and_volume() -> None:
    mine = dig(straight(Roadway("a", "b", 4.0, 3.0, "rectangular", 0.0)))
    assert_allclose(walls_seen(mine, 0.3, 1.5, 1.0), 2.0, atol=0.01)
    assert_allclose(walls_seen(mine, 0.3, 1.5, -1.0), 2.0, atol=0.01)
    up_and_down = mine.raycaster.cast(np.tile([20.0, 0.3, 1.0], (2, 1)), np.array([[0, 0, 1.0], [0, 0, -1.0]]))
    assert_allclose(up_and_down.distances, [2.0, 1.0], atol=0.01)
    assert -enclosed_volume(mine) == pytest.approx(3.0 * (40.0 * 4.0 + np.pi * 2.0**2), rel=0.02)


def test_an_arched_section_is_full_width_at_the_springing_line_and_highest_in_the_middle() -> None:
    mine = dig(straight(ARCHED))
    springing = 3.6 - 0.5 * 3.6
    assert_allclose(walls_seen(mine, 0.3, 0.5 * springing, 1.0), 2.5, atol=0.01)
    starts = np.column_stack([np.full(9, 20.0), 0.3 + np.linspace(-2.0, 2.0, 9), np.full(9, 1.0)])
    roof = 1.0 + mine.raycaster.cast(starts, np.broadcast_to([0.0, 0.0, 1.0], (9, 3))).distances
    ellipse = springing + 1.8 * np.sqrt(1.0 - (np.linspace(-2.0, 2.0, 9) / 2.5) ** 2)
    assert_allclose(roof, ellipse, atol=0.03)


@pytest.mark.parametrize("axis", [0.0, 0.3])
def test_nothing_stands_in_the_roadway(axis: float) -> None:
    nodes = {"a": (0.0, axis, 0.0), "b": (40.0, axis, 0.0)}
    mine = dig(MineScenario("clear", nodes, (ARCHED,), ("a", "b"), relief=0.0))
    heights = np.linspace(0.3, 3.2, 12)
    starts = np.column_stack([np.full(12, 0.0), np.full(12, axis), heights])
    assert mine.raycaster.cast(starts, np.broadcast_to([1.0, 0.0, 0.0], (12, 3))).distances.min() > 39.0


@pytest.mark.parametrize("roughness", [0.01, 0.05, 0.15])
def test_walls_are_as_rough_as_planned(roughness: float) -> None:
    mines = [dig(straight(Roadway("a", "b", 4.0, 3.0, "rectangular", roughness), seed=seed)) for seed in range(3)]
    spread = np.sqrt(np.mean([np.var(walls_seen(mine, 0.3, 1.5, side)) for mine in mines for side in (-1.0, 1.0)]))
    assert spread == pytest.approx(roughness, rel=0.35)


def test_the_ramp_climbs_fifteen_degrees_over_the_lower_drift() -> None:
    mine = built_in("ramp")
    axis = mine.scenario.axis(mine.scenario.between("foot", "top"))
    rise = np.diff(axis[:, 2]) / np.linalg.norm(np.diff(axis[:, :2], axis=0), axis=1)
    assert np.degrees(np.arctan(rise)).mean() == pytest.approx(15.0, abs=0.1)
    below = np.array([20.0, 32.0, 1.5])
    roof = mine.raycaster.cast(below[None], np.array([[0.0, 0.0, 1.0]])).distances[0] + 1.5
    inside_ramp = np.array([20.0, 32.0, 24.0 * np.tan(np.radians(15.0)) + 1.5])
    floor = inside_ramp[2] - mine.raycaster.cast(inside_ramp[None], np.array([[0.0, 0.0, -1.0]])).distances[0]
    assert floor - roof > 2.0


def test_the_same_seed_digs_the_same_mine_and_another_seed_another() -> None:
    rough = Roadway("a", "b", 4.0, 3.0, "arched", 0.1)
    first, again, other = (dig(straight(rough, seed=seed)) for seed in (7, 7, 8))
    assert_array_equal(first.vertices, again.vertices)
    assert_array_equal(first.triangles, again.triangles)
    assert first.vertices.shape != other.vertices.shape or not np.array_equal(first.vertices, other.vertices)


def test_a_mine_on_a_national_grid_is_the_same_mine() -> None:
    rough = Roadway("a", "b", 4.0, 3.0, "arched", 0.1)
    near, far = dig(straight(rough)), dig(straight(rough, origin=MILLIONS))
    assert_array_equal(near.vertices, far.vertices)
    starts, directions = np.array([[10.0, 0.0, 1.0]]), np.array([[0.0, 1.0, 0.0]])
    here = near.raycaster.cast(starts, directions).distances
    assert_allclose(far.raycaster.cast(starts + MILLIONS, directions).distances, here, atol=1e-6)
    options = {"spacing": 0.3, "noise": 0.01, "seed": 1}
    assert_allclose(far.sample(**options) - MILLIONS, near.sample(**options), atol=1e-6)


def test_samples_lie_on_the_rock_one_a_patch() -> None:
    mine = dig(straight(ARCHED))
    points = mine.sample(spacing=0.2, noise=0.0, seed=0)
    assert len(points) == pytest.approx(mine.area / 0.04, rel=1e-3)
    assert mine.raycaster.clearance(points).max() < 1e-4
    noisy = mine.sample(spacing=0.2, noise=0.02, seed=0)
    assert np.std(noisy - points) == pytest.approx(0.02, rel=0.05)


def test_waves_have_unit_rms_and_the_grid_form_agrees() -> None:
    waves = PlaneWaves.draw(np.random.default_rng(0), (0.7, 6.0), count=48, dimensions=3)
    assert np.std(waves(np.random.default_rng(1).uniform(0.0, 300.0, (20_000, 3)))) == pytest.approx(1.0, abs=0.05)
    x, y, z = np.linspace(-3, 4, 5), np.linspace(100, 103, 4), np.linspace(0, 2, 6)
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    assert_allclose(waves.on_grid(x, y, z), waves(points.reshape(-1, 3)).reshape(5, 4, 6), atol=1e-9)


def test_the_demo_has_eight_intersections_or_more_and_a_short_route() -> None:
    demo = plan("demo")
    assert len(junctions_of(demo)) >= 8
    assert len(set(demo.route) & {"b", "c", "d", "e", "f", "g", "h", "p"}) >= 7
    length = sum(np.linalg.norm(np.diff(demo.axis(r), axis=0), axis=1).sum() for r in demo.roadways)
    assert 350.0 < length < 500.0
    assert fly(built_in("demo")).motion.duration_s < 200.0


def test_junctions_count_branches_but_not_niches_nor_bends() -> None:
    nodes = {
        "w": (-20.0, 0.0, 0.0),
        "x": (0.0, 0.0, 0.0),
        "e": (20.0, 0.0, 0.0),
        "n": (0.0, 20.0, 0.0),
        "niche": (0.0, -6.0, 0.0),
        "corner": (20.0, 15.0, 0.0),
        "bend": (-40.0, 5.0, 0.0),
        "end": (-60.0, 5.0, 0.0),
    }
    pairs = ("w x", "x e", "x n", "x niche", "e corner", "w bend", "bend end")
    roadways = tuple(Roadway(*pair.split()) for pair in pairs)
    first, second = junctions_of(MineScenario("t", nodes, roadways, (), relief=0.0, origin=(100.0, 0.0, 7.0)))
    assert_allclose(first.bearings_deg, [0.0, 90.0, 180.0], atol=1e-9)
    assert_allclose(first.p_map, [100.0, 0.0, 7.0])
    assert second.branches == 2
    assert_allclose(second.bearings_deg, [90.0, 180.0], atol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_random_plans_differ_and_can_be_walked(seed: int) -> None:
    mine = plan("random", seed)
    assert len([j for j in junctions_of(mine) if j.branches >= 3]) >= 5
    assert all(mine.between(a, b) for a, b in pairwise(mine.route))
    assert sum(a == c for (a, _), (_, c) in pairwise(pairwise(mine.route))) <= 2
    assert plan("random", seed) == mine
    assert plan("random", seed + 100).nodes != mine.nodes


def test_an_unknown_scenario_names_the_nearest() -> None:
    with pytest.raises(InputFileError, match="did you mean `demo`"):
        plan("demmo")


def test_an_impossible_plan_is_refused() -> None:
    with pytest.raises(InputFileError, match="impossible size"):
        straight(Roadway("a", "b", 0.2))
    with pytest.raises(InputFileError, match="names no known node"):
        straight(Roadway("a", "c"))
    with pytest.raises(InputFileError, match="no roadway joins"):
        MineScenario("t", {"a": (0, 0, 0), "b": (9, 0, 0), "c": (9, 9, 0)}, (Roadway("a", "b"),), ("b", "c"))


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl"])
def test_a_mesh_file_gives_the_mine_back(tmp_path: Path, suffix: str) -> None:
    mine = dig(straight(ARCHED, origin=(1000.0, 2000.0, 30.0)), voxel=0.4)
    mine.save_mesh(tmp_path / f"mine{suffix}")
    back = load_mesh(tmp_path / f"mine{suffix}")
    assert back.scenario is None and back.junctions == ()
    assert back.area == pytest.approx(mine.area, rel=1e-3)
    start, along = np.array([[1020.0, 2000.3, 31.0]]), np.array([[0.0, 1.0, 0.0]])
    assert_allclose(back.raycaster.cast(start, along).distances, mine.raycaster.cast(start, along).distances, atol=2e-3)


def test_bad_mesh_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="no such file"):
        load_mesh(tmp_path / "gone.ply")
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(InputFileError, match="is not a mesh file"):
        load_mesh(tmp_path / "notes.txt")
    (tmp_path / "garbage.ply").write_text("hello")
    with pytest.raises(InputFileError, match="holds no triangles"):
        load_mesh(tmp_path / "garbage.ply")
    mesh = o3d.geometry.TriangleMesh.create_box()
    np.asarray(mesh.vertices)[0] = np.nan
    o3d.io.write_triangle_mesh(str(tmp_path / "nan.ply"), mesh)
    with pytest.raises(InputFileError, match="not finite"):
        load_mesh(tmp_path / "nan.ply")
