"""Free space: the same from a dense cloud and from views; what bounds it; the kernels behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from synthetic_mine import SyntheticMine, straight, t_junction

from maps._numba_rays import FREE, UNKNOWN, WALL, march, mark_seen
from maps.free_space import FreeSpace, View, free_space_of_views, split_ground_and_walls
from maps.settings import FreeSpaceSettings
from semmap.errors import CloudError
from semmap.geometry import Array

SETTINGS = FreeSpaceSettings()


def truth_of(mine: SyntheticMine, space: FreeSpace) -> Array:
    """How far inside the mine the centre of each cell is, (nx, ny)."""
    ij = np.stack(np.meshgrid(*(np.arange(n) for n in space.grid.shape), indexing="ij"), axis=-1).reshape(-1, 2)
    return mine.inside(space.grid.centres(ij) @ mine.R).reshape(space.grid.shape)


@pytest.mark.parametrize("width", [2.5, 4.0, 8.0])
def test_free_cells_are_the_roadway(width: float) -> None:
    mine = t_junction(width).turned(0.3)
    space = split_ground_and_walls(mine.cloud(), SETTINGS)
    depth = truth_of(mine, space)
    assert space.free[depth > 0.35].all()
    assert not space.free[depth < -0.15].any()
    assert not space.frontier().any()


@pytest.mark.parametrize("spacing", [0.2, 0.35])
def test_thin_sampling_leaves_no_holes(spacing: float) -> None:
    mine = t_junction()
    space = split_ground_and_walls(mine.cloud(spacing), SETTINGS)
    depth = truth_of(mine, space)
    assert space.free[depth > 0.6].mean() > 0.995
    assert space.free[depth < -0.3].mean() < 0.001


def test_clutter_is_no_wall_and_a_pillar_is() -> None:
    cloud = straight(8.0).cloud()
    rng = np.random.default_rng(1)

    def block(x: float, side: float) -> tuple[Array, NDArray[np.bool_]]:
        under = (np.abs(cloud[:, 0] - x) < 0.5 * side) & (np.abs(cloud[:, 1]) < 0.5 * side)
        points = rng.uniform([x - side / 2, -side / 2, 0.0], [x + side / 2, side / 2, 3.0], (6000, 3))
        return points, under

    post, under_post = block(-10.0, 1.2)
    pillar, under_pillar = block(10.0, 3.0)
    space = split_ground_and_walls(np.vstack([cloud[~under_post & ~under_pillar], post, pillar]), SETTINGS)
    assert space.clearance_at(np.array([-10.0, 0.0])) > 3.0
    assert space.clearance_at(np.array([10.0, 0.0])) == 0.0


def test_views_show_the_free_space_of_the_map_as_far_as_they_see() -> None:
    mine = replace(t_junction(), slope=(0.1, 0.05), yaw=1.0)
    whole = truth_of(mine, seen := free_space_of_views([mine.view((x, 0.3)) for x in (-4, -2, 0)], SETTINGS))
    assert not seen.free[whole < -0.15].any()
    near = np.hypot(*np.moveaxis(plan_of(mine, seen), -1, 0)) < 8.0
    assert seen.free[(whole > 0.35) & near].all()


def plan_of(mine: SyntheticMine, space: FreeSpace) -> Array:
    ij = np.stack(np.meshgrid(*(np.arange(n) for n in space.grid.shape), indexing="ij"), axis=-1)
    return (space.grid.centres(ij.reshape(-1, 2)) @ mine.R).reshape(*space.grid.shape, 2)


def test_a_shadow_ends_at_a_frontier_and_not_at_a_wall() -> None:
    mine = t_junction()
    space = free_space_of_views([mine.view((-8.0, 0.0))], SETTINGS)
    down_the_side_road = space.sight(np.array([[0.5, -1.0], [0.5, 0.0]]), np.array([-np.pi / 2, np.pi / 2]), 15.0)
    assert_array_equal(down_the_side_road.at_wall, [False, True])
    assert down_the_side_road.distance[0] < 10.0
    assert space.frontier().any()


def test_sight_measures_the_walls() -> None:
    space = split_ground_and_walls(straight(5.0).cloud(), SETTINGS)
    angles = np.linspace(0.3, np.pi - 0.3, 40)
    sight = space.sight(np.zeros((40, 2)), angles, 30.0)
    assert sight.at_wall.all()
    assert_allclose(sight.distance, 2.5 / np.sin(angles), atol=0.35)
    clipped = space.sight(np.zeros((1, 2)), np.array([0.0]), 10.0)
    assert clipped.distance[0] == 10.0
    assert not clipped.at_wall[0]


def test_views_without_points_near_the_sensor_are_refused() -> None:
    for views in ([], [View(np.zeros((0, 3)), np.zeros(3))], [View(np.full((5, 3), 99.0), np.zeros(3))]):
        with pytest.raises(CloudError):
            free_space_of_views(views, SETTINGS)


def test_march_agrees_with_a_walk_in_plain_numpy() -> None:
    rng = np.random.default_rng(5)
    cells = rng.choice(np.array([UNKNOWN, FREE, FREE, FREE, FREE, FREE, WALL], np.uint8), (40, 30))
    x, y, angle = rng.uniform(0, 40, 300), rng.uniform(0, 30, 300), rng.uniform(0, 7, 300)
    distance, at_wall = np.empty(300), np.empty(300, dtype=bool)
    march(cells, x, y, angle, 12.0, distance, at_wall)
    padded = np.pad(cells, 2, constant_values=UNKNOWN)
    for k in range(300):
        steps = 0.25 * np.arange(48)
        i = np.floor(x[k] + steps * np.cos(angle[k])).astype(int).clip(-2, 41) + 2
        j = np.floor(y[k] + steps * np.sin(angle[k])).astype(int).clip(-2, 31) + 2
        stop = np.flatnonzero(padded[i, j] != FREE)
        if not len(stop):
            assert (distance[k], at_wall[k]) == (12.0, False)
            continue
        a, b = i[stop[0]], j[stop[0]]
        assert distance[k] == steps[stop[0]]
        assert at_wall[k] == (padded[max(a - 1, 0) : a + 2, max(b - 1, 0) : b + 2] == WALL).any()


def test_mark_seen_agrees_with_rays_in_plain_numpy() -> None:
    rng = np.random.default_rng(6)
    wall = rng.random((30, 30)) < 0.05
    reach = rng.uniform(0.0, 20.0, 64)
    free = np.zeros_like(wall)
    mark_seen(free, wall, 15.3, 14.8, reach)
    expected = np.zeros_like(wall)
    for k, length in enumerate(reach):
        for step in range(int(2.0 * length) + 1):
            angle = 2.0 * np.pi * (k + 0.5) / 64
            i, j = int(np.floor(15.3 + 0.5 * step * np.cos(angle))), int(np.floor(14.8 + 0.5 * step * np.sin(angle)))
            if not (0 <= i < 30 and 0 <= j < 30) or wall[i, j]:
                break
            expected[i, j] = True
    assert_array_equal(free, expected)
