"""Free space of stacked keyframes: what is in sight, on its floor, and what shadows hide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from synthetic_mine import SyntheticMine, t_junction

from maps._numba_rays import mark_seen
from maps.free_space import FreeSpace
from maps.settings import FreeSpaceSettings
from maps.views import View, free_space_of_views
from semmap.errors import CloudError
from semmap.geometry import Array

SETTINGS = FreeSpaceSettings()


def inside_of(mine: SyntheticMine, space: FreeSpace) -> Array:
    """How far inside the mine each free cell lies (n,) [m]."""
    return mine.inside(space.centres(np.arange(len(space)))[:, :2] @ mine.R)


def test_views_show_the_free_space_of_the_map_as_far_as_they_see() -> None:
    mine = replace(t_junction(), slope=(0.1, 0.05), yaw=1.0)
    seen = free_space_of_views([mine.view((x, 0.3)) for x in (-4, -2, 0)], SETTINGS)
    assert inside_of(mine, seen).min() > -0.15
    near = np.random.default_rng(0).uniform(-8.0, 8.0, (2000, 2))
    near = near[(mine.inside(near) > 0.35) & (np.hypot(*near.T) < 8.0)]
    assert (seen.find(mine.to_map(near)) >= 0).all()


def test_a_shadow_ends_at_a_frontier_and_not_at_a_wall() -> None:
    mine = t_junction()
    space = free_space_of_views([mine.view((-8.0, 0.0))], SETTINGS)
    p = np.array([[0.5, -1.0, 0.0], [0.5, 0.0, 0.0]])
    down_the_side_road = space.sight(p, np.array([-np.pi / 2, np.pi / 2]), 15.0)
    assert_array_equal(down_the_side_road.at_wall, [False, True])
    assert down_the_side_road.distance[0] < 10.0
    assert space.frontier().any()


def test_the_floor_of_sparse_views_on_a_ramp() -> None:
    mine = replace(t_junction(), slope=(0.2, 0.0))
    space = free_space_of_views([mine.view((x, 0.1), seed=x + 12) for x in range(-12, 1)], SETTINGS)
    truth = mine.to_map(np.column_stack([np.linspace(-8.0, 6.0, 40), np.zeros(40)]))
    rows = space.find(truth)
    assert (rows >= 0).all()
    assert np.abs(space.height[rows] - truth[:, 2]).max() < 0.15


def test_views_without_points_near_the_sensor_are_refused() -> None:
    for views in ([], [View(np.zeros((0, 3)), np.zeros(3))], [View(np.full((5, 3), 99.0), np.zeros(3))]):
        with pytest.raises(CloudError):
            free_space_of_views(views, SETTINGS)


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
