"""Intersections in plan: the invariant point, kinds, branches, what is merged and what is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from synthetic_mine import SyntheticMine, corner, straight, t_junction, x_junction, y_junction

from maps.columns import columns_of
from maps.free_cells import split_ground_and_walls
from maps.free_space import FreeSpace
from maps.intersections import Crossing, find_alternatives, find_intersections, kind_of
from maps.invariant_point import invariant_point
from maps.settings import FreeSpaceSettings, TopologySettings
from maps.topology import roadway_topology
from semmap.geometry import Array

SETTINGS = TopologySettings()


def space_of(cloud: Array) -> FreeSpace:
    return split_ground_and_walls(columns_of(cloud, FreeSpaceSettings()), FreeSpaceSettings())


def crossings_of(cloud: Array) -> list[Crossing]:
    space = space_of(cloud)
    return find_intersections(roadway_topology(space, SETTINGS), space, SETTINGS)


def only(crossings: list[Crossing]) -> Crossing:
    assert len(crossings) == 1
    return crossings[0]


@pytest.mark.parametrize(
    ("mine", "kind", "bearings_deg"),
    [
        (t_junction(), "T", [0, 180, 270]),
        (x_junction(3.0), "X", [0, 90, 180, 270]),
        (y_junction(5.0), "Y", [90, 210, 330]),
        (corner(3.5), "L", [0, 90]),
    ],
    ids=["T", "X", "Y", "L"],
)
def test_kind_bearings_and_widths(mine: SyntheticMine, kind: str, bearings_deg: list[float]) -> None:
    crossing = only(crossings_of(mine.cloud()))
    assert crossing.kind == kind
    bearings = [branch.bearing for branch in crossing.branches]
    off = np.angle(np.exp(1j * (np.array(bearings)[:, None] - np.radians(bearings_deg))))
    assert_allclose(np.abs(off).min(axis=0), 0.0, atol=np.radians(8.5))
    assert bearings == sorted(bearings)
    assert_allclose([branch.width for branch in crossing.branches], mine.roadways[0][4], atol=0.4)


@pytest.mark.parametrize(
    ("mine", "reach"), [(x_junction(), 0.12), (y_junction(), 0.15), (t_junction(), 0.8), (x_junction(8.0), 0.25)]
)
def test_the_invariant_point_is_where_the_axes_meet(mine: SyntheticMine, reach: float) -> None:
    """Exactly so where the walls are symmetrical; of a T the walls draw it towards the side roadway."""
    assert np.linalg.norm(only(crossings_of(mine.cloud())).p[:2]) < reach


@pytest.mark.parametrize("mine", [t_junction(), t_junction(6.0, 3.0), y_junction(), corner()])
def test_the_invariant_point_turns_with_the_mine(mine: SyntheticMine) -> None:
    p = only(crossings_of(mine.cloud())).p
    for yaw in (0.3, 0.9, 2.6):
        turned = only(crossings_of(mine.turned(yaw).cloud(seed=1))).p
        assert np.linalg.norm(turned[:2] - mine.turned(yaw).R @ p[:2]) < 0.3


@pytest.mark.parametrize("mine", [t_junction(), y_junction()])
def test_the_invariant_point_does_not_depend_on_how_densely_a_wall_was_sampled(mine: SyntheticMine) -> None:
    cloud = mine.cloud(0.08)
    p = only(crossings_of(cloud)).p
    rng = np.random.default_rng(0)
    thinner = cloud[(cloud[:, 0] < 0.0) | (rng.random(len(cloud)) < 0.25)]
    assert np.linalg.norm(only(crossings_of(thinner)).p[:2] - p[:2]) < 0.1


def test_the_point_lies_on_the_floor_of_a_slope() -> None:
    mine = replace(t_junction(), slope=(0.2, -0.1), yaw=0.7)
    p = only(crossings_of(mine.cloud())).p
    assert_allclose(p[2], mine.to_map(p[:2] @ mine.R)[0, 2], atol=0.06)


def test_the_invariant_point_stays_within_a_width_of_its_node() -> None:
    space = space_of(straight().cloud())
    node = np.array([3.0, 0.4, 0.0])
    p = invariant_point(node, space)
    assert abs(p[1]) < 0.25
    assert abs(p[0] - 3.0) < 0.2


def staggered(apart: float) -> SyntheticMine:
    """Side roadways up and down that leave a roadway ``apart`` from each other."""
    return SyntheticMine(
        (
            (-30.0, 0.0, 30.0, 0.0, 4.0),
            (-apart / 2, 0.0, -apart / 2, 25.0, 4.0),
            (apart / 2, 0.0, apart / 2, -25.0, 4.0),
        )
    )


@pytest.mark.parametrize(("apart", "kinds"), [(2.0, ["X"]), (3.5, ["X"]), (12.0, ["T", "T"])])
def test_side_roadways_across_are_one_crossing_or_two(apart: float, kinds: list[str]) -> None:
    assert [crossing.kind for crossing in crossings_of(staggered(apart).cloud())] == kinds


def test_a_close_call_is_read_both_ways() -> None:
    space = space_of(staggered(5.5).cloud())
    topology = roadway_topology(space, SETTINGS)
    readings = find_alternatives(topology, space, SETTINGS)
    assert sorted(crossing.kind for crossing in readings) == ["T", "T", "X"]
    whole = next(crossing for crossing in readings if crossing.kind == "X")
    assert all(crossing.nodes <= whole.nodes for crossing in readings)
    clear = space_of(staggered(14.0).cloud())
    assert len(find_alternatives(roadway_topology(clear, SETTINGS), clear, SETTINGS)) == 2


def test_a_straight_roadway_and_a_gentle_bend_hold_no_intersection() -> None:
    assert crossings_of(straight().cloud()) == []
    assert crossings_of(corner(turn_deg=40.0).cloud()) == []


def test_a_hall_is_no_intersection() -> None:
    hall = SyntheticMine(((-40.0, 0.0, -9.0, 0.0, 4.0), (-10.0, 0.0, 10.0, 0.0, 20.0), (0.0, 9.0, 0.0, 40.0, 4.0)))
    assert crossings_of(hall.cloud()) == []


@pytest.mark.parametrize(
    ("degrees", "kind"),
    [([0, 180], "L"), ([0, 90, 180], "T"), ([0, 30, 190], "Y"), ([0, 120, 240], "Y"), ([0, 90, 180, 270], "X")],
)
def test_kind_of(degrees: list[float], kind: str) -> None:
    assert kind_of(np.radians(degrees)) == kind
    assert kind_of(np.radians([0, 60, 120, 180, 250])) == "multi"
