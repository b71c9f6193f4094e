"""Routes whose heights are not a mine's: they are put on its floor, on one level, and smoothly."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from semmap.errors import InputFileError
from tools.simulator import SCENARIOS, Mine, MineScenario, Roadway, dig, fly, load_mesh, load_route, plan
from tools.simulator.floor import on_floor
from tools.simulator.settings import MotionSettings

HEIGHT = MotionSettings().height
EDGAR = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "edgar_mine"


@cache
def ramp() -> Mine:
    """Two levels, the upper one over the lower."""
    return dig(plan("ramp"), voxel=0.3)


@cache
def rough_drift() -> Mine:
    """A drift with a rough, undulating floor, about 500 m below a far away origin."""
    nodes = {"a": (0.0, 0.0, 0.0), "b": (60.0, 8.0, 3.0)}
    origin = (612_000.0, 4_100_000.0, -500.0)
    return dig(MineScenario("drift", nodes, (Roadway("a", "b", roughness=0.15),), ("a", "b"), origin=origin), voxel=0.3)


def off_the_axis(mine: Mine, points: np.ndarray) -> np.ndarray:
    """Heights of floor points above those of the scenario's own route at the same share of the way."""
    own = mine.scenario.route_floor()
    ways = [np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(p[:, :2], axis=0).T))]) for p in (points, own)]
    return points[:, 2] - np.interp(ways[0] / ways[0][-1], ways[1] / ways[1][-1], own[:, 2])


@pytest.mark.parametrize("name", SCENARIOS)
def test_heights_that_fit_are_kept(name: str) -> None:
    mine = dig(plan(name), voxel=0.4)
    route = mine.scenario.route_floor()
    put = on_floor(route, mine, HEIGHT)
    assert put.points is route and put.shift == 0.0
    assert_array_equal(fly(mine, route).truth(2.0).poses, fly(mine).truth(2.0).poses)


@pytest.mark.parametrize("shift", [-6.0, -1.5, 1.5, 4.5])
def test_shifted_heights_are_put_on_the_floor_of_their_level(shift: float) -> None:
    put = on_floor(ramp().scenario.route_floor() + [0.0, 0.0, shift], ramp(), HEIGHT)
    assert np.abs(off_the_axis(ramp(), put.points)).max() < 0.4
    assert put.shift == pytest.approx(abs(shift), abs=0.5)


def test_without_heights_the_route_climbs_the_ramp() -> None:
    route = ramp().scenario.route_floor()
    put = on_floor(route[:, :2], ramp(), HEIGHT)
    assert np.abs(off_the_axis(ramp(), put.points)).max() < 0.4
    assert np.ptp(put.points[:, 2]) > 10.0
    assert put.shift == 0.0


def test_levels_are_chosen_by_the_heights_or_the_lowest() -> None:
    halls = [o3d.geometry.TriangleMesh.create_box(40.0, 10.0, 4.0).translate([0.0, 0.0, z]) for z in (0.0, 12.0)]
    mesh = halls[0] + halls[1]
    mine = Mine("two halls", np.asarray(mesh.vertices), np.asarray(mesh.triangles), np.zeros(3))
    plan_line = np.array([[4.0, 5.3], [36.0, 4.7]])

    def level(*z: float) -> np.ndarray:
        return on_floor(np.column_stack([plan_line, z]) if z else plan_line, mine, HEIGHT).points[:, 2]

    assert_allclose(level(), 0.0, atol=1e-5)
    assert_allclose(level(4.5, 4.5), 0.0, atol=1e-5)
    assert_allclose(level(9.0, 9.0), 12.0, atol=1e-5)
    assert_allclose(level(13.0, 40.0), 12.0, atol=1e-5)


def test_a_place_without_a_floor_is_bridged() -> None:
    mesh = o3d.geometry.TriangleMesh.create_box(40.0, 10.0, 4.0)
    for z in (0.5, 1.5, 2.5):  # a shelf from wall to wall
        mesh += o3d.geometry.TriangleMesh.create_box(1.0, 10.0, 0.5).translate([20.0, 0.0, z])
    mine = Mine("hall", np.asarray(mesh.vertices), np.asarray(mesh.triangles), np.zeros(3))
    put = on_floor(np.array([[4.0, 5.3, 3.0], [36.0, 4.7, 3.0]]), mine, HEIGHT)
    assert_allclose(put.points[:, 2], 0.0, atol=1e-5)
    with pytest.raises(InputFileError, match=r"rock near \((19|20)"):
        fly(mine, [[4.0, 5.3, 3.0], [36.0, 4.7, 3.0]])


def test_a_rough_floor_does_not_shake_the_path(tmp_path: Path) -> None:
    rough_drift().save_mesh(tmp_path / "drift.ply")
    mine, own = load_mesh(tmp_path / "drift.ply"), rough_drift().scenario.route_floor()
    shifted = own + np.column_stack([np.zeros((len(own), 2)), np.linspace(-3.0, 2.0, len(own))])
    lines = [",".join(f"{value:.3f}" for value in row) for row in shifted]
    (tmp_path / "route.csv").write_text("\n".join(lines))
    flight = fly(mine, load_route(tmp_path / "route.csv"))
    assert flight.floor_shift == pytest.approx(3.0, abs=0.3)
    times = np.arange(0.0, flight.motion.duration_s, 0.1)
    p, a = flight.motion(times).position, flight.motion(times).acceleration
    below = mine.raycaster.cast(p, np.broadcast_to([0.0, 0.0, -1.0], p.shape)).distances
    assert np.abs(below - HEIGHT).max() < 0.35
    assert np.sqrt(np.mean(a[:, 2] ** 2)) < 0.1


@pytest.mark.skipif(not EDGAR.is_dir(), reason="the benchmark data is not beside the repository")
def test_the_benchmark_route_flies_in_the_other_mesh_of_the_mine() -> None:
    mine, route = load_mesh(EDGAR / "edgar_mine_smooth.ply"), load_route(EDGAR / "flight_waypoints.csv")[:600]
    flight = fly(mine, route)
    assert flight.floor_shift > 1.0
    p = flight.motion(np.arange(0.0, flight.motion.duration_s, 0.5)).position
    assert_allclose(p[:, 2], 0.144 + HEIGHT, atol=0.01)
