"""Prior maps: what is cut off, what stands about, and that the rest is the rock as it is."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from maps.prior_map import read_prior_map
from semmap.errors import InputFileError
from tools import cli
from tools.simulator import Mine, MineScenario, Roadway, SurveySettings, dig, plan, survey
from tools.simulator.boxes import Box
from tools.simulator.clutter import clutter

EXACT = SurveySettings(spacing=0.15, noise=0.0)
ROOM = (5.0, 3.6)


def settings(**changes: object) -> SurveySettings:
    return EXACT.model_copy(update=changes)


@cache
def sloping() -> Mine:
    """A roadway of 60 m that climbs 8 degrees, with a flat side roadway, on a far grid."""
    nodes = {"a": (0.0, 0.0, 0.0), "b": (30.0, 0.0, 4.2), "c": (60.0, 0.0, 8.4), "d": (30.0, 25.0, 4.2)}
    roadways = tuple(Roadway(*pair, *ROOM, "rectangular", 0.05) for pair in ("ab", "bc", "bd"))
    origin = (512_000.0, 4_200_000.0, -300.0)
    return dig(MineScenario("sloping", nodes, roadways, ("a", "b"), relief=0.0, origin=origin), voxel=0.25)


@cache
def boxes(**counts: int) -> list[Box]:
    axes = [sloping().scenario.axis(roadway) + sloping().origin for roadway in sloping().scenario.roadways]
    return clutter(sloping(), axes, settings(**counts), np.random.default_rng(3))


def drops(mine: Mine, points: np.ndarray) -> np.ndarray:
    """How far the floor is below points in the air."""
    return mine.raycaster.cast(points, np.broadcast_to([0.0, 0.0, -1.0], points.shape)).distances


def rows(points: np.ndarray) -> set[tuple[float, ...]]:
    return set(map(tuple, points.tolist()))


def test_by_default_the_map_is_a_sample_of_the_rock() -> None:
    assert_array_equal(survey(sloping(), seed=4), sloping().sample(spacing=0.1, noise=0.01, seed=4))


def test_an_open_top_has_its_walls_and_no_roof() -> None:
    everything, cut = survey(sloping(), EXACT, seed=1), survey(sloping(), settings(open_top=True), seed=1)
    assert rows(cut) < rows(everything)
    at = np.array([12.0, 0.0, 12.0 * 0.14]) + sloping().origin
    above = {}
    for name, cloud in (("all", everything), ("cut", cut)):
        local = cloud - at
        section = local[(np.abs(local[:, 0]) < 1.0) & (np.abs(local[:, 1]) < 3.5)]
        above[name] = section[:, 2] - 0.14 * section[:, 0]
    assert above["all"].max() == pytest.approx(ROOM[1], abs=0.3)
    assert above["cut"].max() < 2.6
    low = [(heights < 2.0).sum() for heights in above.values()]
    assert low[1] == pytest.approx(low[0], rel=0.02)


def test_a_mesh_wound_the_other_way_is_cut_the_same() -> None:
    there = sloping()
    turned = Mine("turned", there.vertices, there.triangles[:, ::-1], there.origin)
    cut, again = (survey(mine, settings(open_top=True, spacing=0.4), seed=1) for mine in (there, turned))
    assert len(again) == pytest.approx(len(cut), rel=0.01)
    assert_allclose(again[:, 2].max(), cut[:, 2].max(), atol=0.1)


def test_vehicles_stand_on_the_floor_beside_the_wall() -> None:
    things = boxes(vehicles=3)
    bodies = [box for box in things if box.high[0] - box.low[0] == 8.0]
    assert len(bodies) == 3 and len(things) == 6
    for body in bodies:
        size = body.high - body.low
        assert size[1] == 2.6
        over = body.p + np.array([[x, y, 1.72] for x in (-3.9, 0.0, 3.9) for y in (-1.2, 1.2)]) @ body.R.T
        assert_allclose(drops(sloping(), over), 1.72, atol=0.3)
        sides = body.p + body.R[:, 2] * 1.2 + np.outer([1.3, -1.3], body.R[:, 1])
        rays = np.array([body.R[:, 1], -body.R[:, 1]])
        gap = sloping().raycaster.cast(sides, rays).distances
        assert 0.0 < gap.min() < 0.9 and gap.sum() > 1.0
    centres = np.array([body.centre for body in bodies])
    assert all(np.linalg.norm(a - b) > 8.0 for k, a in enumerate(centres) for b in centres[:k])


def test_a_vehicle_shows_its_sides_and_hides_what_is_under_it() -> None:
    cloud = survey(sloping(), settings(vehicles=2), seed=3)
    axes = [sloping().scenario.axis(roadway) + sloping().origin for roadway in sloping().scenario.roadways]
    for box in clutter(sloping(), axes, settings(vehicles=2), np.random.default_rng([3, 7])):
        assert not Box(box.p, box.R, box.low + 1e-6, box.high - 1e-6).contains(cloud).any()
        on_it = (cloud[Box(box.p, box.R, box.low - 1e-6, box.high + 1e-6).contains(cloud)] - box.p) @ box.R
        assert len(on_it) > 100
        assert (on_it[:, 2] > -0.25).all()


def test_posts_reach_the_roof_and_pallets_do_not() -> None:
    for post in boxes(posts=5):
        assert max(post.high[:2] - post.low[:2]) <= 0.3
        top = post.p + [0.0, 0.0, post.high[2]]
        up = sloping().raycaster.cast(top[None], np.array([[0.0, 0.0, 1.0]])).distances
        assert 0.0 < up[0] < 0.15
    assert len(boxes(pallets=6)) == 6
    assert all(0.4 <= pallet.high[2] <= 1.5 for pallet in boxes(pallets=6))


def test_a_conveyor_follows_one_roadway_at_one_side() -> None:
    belt = [box for box in boxes(conveyors=1) if box.low[2] > 0.0]
    middles = np.array([box.centre for box in belt]) - sloping().origin
    assert len(belt) >= 8
    assert_allclose(np.abs(middles[:, 1]), np.abs(middles[0, 1]), atol=0.3)
    assert_allclose(middles[:, 2] - 0.14 * middles[:, 0], 0.7, atol=0.2)
    assert np.ptp(middles[:, 0]) > 14.0


def test_the_same_seed_puts_the_same_things_and_the_rock_stays_as_it_was() -> None:
    busy = settings(vehicles=2, pallets=3, posts=4, conveyors=1)
    first, again, other = (survey(sloping(), busy, seed=seed) for seed in (5, 5, 6))
    assert_array_equal(first, again)
    assert rows(first) != rows(other)
    bare = rows(survey(sloping(), EXACT, seed=5))
    assert len(bare & rows(first)) > 0.9 * len(bare)


def test_more_things_than_find_room_are_left_out() -> None:
    narrow = dig(MineScenario("narrow", {"a": (0, 0, 0), "b": (30, 0, 0)}, (Roadway("a", "b", 3.0),), ()), voxel=0.3)
    assert_array_equal(survey(narrow, settings(vehicles=4), seed=1), survey(narrow, EXACT, seed=1))


def test_things_in_a_mesh_stand_along_the_route(tmp_path: Path) -> None:
    mesh = o3d.geometry.TriangleMesh.create_box(60.0, 9.0, 4.0)
    hall = Mine("hall", np.asarray(mesh.vertices), np.asarray(mesh.triangles), np.zeros(3))
    with pytest.raises(InputFileError, match="give a route"):
        survey(hall, settings(vehicles=1), seed=1)
    route = np.column_stack([np.linspace(5.0, 55.0, 101), np.full(101, 4.5), np.zeros(101)])
    cloud = survey(hall, settings(vehicles=1), seed=1, route=route)
    inside = cloud[(cloud > 0.05).all(axis=1) & (cloud < [59.95, 8.95, 3.95]).all(axis=1)]
    assert_allclose(np.ptp(inside, axis=0), [8.0, 2.6, 2.45], atol=0.15)


def test_the_map_is_set_up_from_the_command_line(tmp_path: Path) -> None:
    mesh = o3d.geometry.TriangleMesh.create_box(40.0, 9.0, 4.0)
    o3d.io.write_triangle_mesh(str(tmp_path / "hall.ply"), mesh)
    (tmp_path / "route.csv").write_text("4,4.5,0\n36,4.5,0\n")
    text = "simulate: {duration_s: 1.0, map: {spacing: 0.3, noise: 0.0, open_top: true, vehicles: 2}}"
    (tmp_path / "config.yaml").write_text(text)
    words = ["simulate", tmp_path / "hall.ply", "--route", tmp_path / "route.csv", "--config", tmp_path / "config.yaml"]
    assert cli.run([*map(str, words), "--out", str(tmp_path / "sim")]) == 0
    prior = read_prior_map(tmp_path / "sim" / "prior_map.laz")
    cloud = prior.points + prior.origin
    assert cloud[:, 2].max() < 2.3
    assert ((cloud > 0.1).all(axis=1) & (cloud < [39.9, 8.9, 2.1]).all(axis=1)).sum() > 200


def test_built_in_mines_hold_vehicles() -> None:
    mine = dig(plan("demo"), voxel=0.4)
    crowded, bare = (survey(mine, settings(vehicles=count), seed=2) for count in (6, 0))
    assert len(rows(crowded) - rows(bare)) * EXACT.spacing**2 > 5 * 50.0
