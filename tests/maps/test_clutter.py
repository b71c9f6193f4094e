"""Clutter: parked machines, with their tops seen or not, below a roof or without one, on slopes; none are walls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_mine import SyntheticMine, straight, x_junction

from maps.columns import columns_of
from maps.free_cells import split_ground_and_walls
from maps.free_space import FreeSpace
from maps.settings import FreeSpaceSettings
from semmap.geometry import Array

SETTINGS = FreeSpaceSettings()
RAMP = float(np.tan(np.radians(15.0)))


def space_of(cloud: Array) -> FreeSpace:
    return split_ground_and_walls(columns_of(cloud, SETTINGS), SETTINGS)


def parked(
    mine: SyntheticMine,
    cloud: Array,
    at: tuple[float, float],
    size: tuple[float, float, float] = (8.0, 2.6, 2.0),
    *,
    top: bool = True,
    spacing: float = 0.1,
) -> Array:
    """The cloud with a box on the floor at a plan point, which hides the floor below it."""
    rng, (length, width, height) = np.random.default_rng(7), size
    local = cloud[:, :2] @ mine.R - at
    above = cloud[:, 2] - mine.to_map(cloud[:, :2] @ mine.R)[:, 2]
    hidden = (np.abs(local[:, 0]) < 0.5 * length) & (np.abs(local[:, 1]) < 0.5 * width) & (above < height)
    sides = int(2.0 * (length + width) * height / spacing**2)
    along = rng.uniform(0.0, 2.0 * (length + width), sides)
    face = np.searchsorted([length, length + width, 2.0 * length + width], along, side="right")
    x = np.choose(face, [along, length, 2.0 * length + width - along, 0.0]) - 0.5 * length
    y = np.choose(face, [0.0, along - length, width, 2.0 * (length + width) - along]) - 0.5 * width
    box = np.column_stack([x, y, rng.uniform(0.0, height, sides)])
    if top:
        lid = rng.uniform(-0.5, 0.5, (int(length * width / spacing**2), 2)) * [length, width]
        box = np.vstack([box, np.column_stack([lid, np.full(len(lid), height)])])
    placed = mine.to_map(box[:, :2] + at) + np.array([0.0, 0.0, 1.0]) * box[:, 2:]
    return np.vstack([cloud[~hidden], placed])


def missed(mine: SyntheticMine, space: FreeSpace, depth: float = 0.6) -> float:
    """Share of the plan more than ``depth`` [m] inside the mine that is not free."""
    xy = np.random.default_rng(0).uniform(-30.0, 30.0, (20000, 2))
    return float((space.find(mine.to_map(xy[mine.inside(xy) > depth])) < 0).mean())


@pytest.mark.parametrize("yaw", [0.0, 0.5])
@pytest.mark.parametrize("at", [(4.0, 0.0), (4.0, 1.6), (4.0, -1.3)], ids=["middle", "by the wall", "near the wall"])
@pytest.mark.parametrize(("roofed", "top"), [(True, True), (True, False), (False, True)])
def test_a_parked_machine_is_no_wall(at: tuple[float, float], roofed: bool, top: bool, yaw: float) -> None:
    mine = straight(6.0).turned(yaw)
    space = space_of(parked(mine, mine.cloud(roofed=roofed), at, top=top))
    assert missed(mine, space) < 0.01
    axis = mine.to_map(np.column_stack([np.linspace(-15.0, 15.0, 60), np.zeros(60)]))
    assert min(space.clearance_at(p) for p in axis) > 2.2
    assert np.abs(space.height[space.find(axis)]).max() < 0.1


@pytest.mark.parametrize("at", [(0.0, 0.0), (1.0, 1.4)], ids=["middle", "by the wall"])
@pytest.mark.parametrize("roofed", [True, False])
def test_nor_is_one_on_a_ramp(at: tuple[float, float], roofed: bool) -> None:
    mine = replace(straight(6.0), slope=(RAMP, 0.0), yaw=0.2)
    space = space_of(parked(mine, mine.cloud(roofed=roofed), at))
    assert missed(mine, space) < 0.01
    axis = mine.to_map(np.column_stack([np.linspace(-15.0, 15.0, 60), np.zeros(60)]))
    assert np.abs(space.height[space.find(axis)] - axis[:, 2]).max() < 0.2
    assert min(space.clearance_at(p) for p in axis) > 2.2


def test_a_machine_in_an_intersection_is_no_pillar() -> None:
    mine = x_junction(5.0)
    space = space_of(parked(mine, mine.cloud(), (0.5, 0.3)))
    assert space.clearance_at(np.zeros(3)) > 3.0


def test_one_in_a_high_hall_leaves_the_floor_below_it() -> None:
    mine = replace(straight(9.0), roof=8.0)
    space = space_of(parked(mine, mine.cloud(), (0.0, 0.0)))
    assert missed(mine, space) == 0.0
    assert np.abs(space.height).max() < 0.2


def test_a_belt_along_the_wall_and_pallets_are_no_wall() -> None:
    mine = straight(5.0).turned(0.3)
    cloud = parked(mine, mine.cloud(), (0.0, 1.6), (24.0, 1.0, 0.9))
    for x in (-8.0, 3.0, 9.0):
        cloud = parked(mine, cloud, (x, -1.6), (1.2, 1.0, 1.2))
    assert missed(mine, space_of(cloud)) < 0.01


def test_a_block_that_reaches_the_roof_stays() -> None:
    mine = straight(9.0)
    space = space_of(parked(mine, mine.cloud(), (0.0, 0.0), (5.0, 5.0, 3.0), top=False))
    assert space.find(np.zeros((1, 3)))[0] == -1
    assert space.clearance_at(np.array([0.0, 3.5, 0.0])) < 1.3


def test_unseen_floor_below_a_seen_roof_is_floor() -> None:
    mine = straight(5.0)
    cloud = mine.cloud()
    dark = (np.hypot(cloud[:, 0], cloud[:, 1]) < 1.8) & (cloud[:, 2] < 0.5)
    space = space_of(cloud[~dark])
    assert missed(mine, space) == 0.0
    assert np.abs(space.height).max() < 0.1
