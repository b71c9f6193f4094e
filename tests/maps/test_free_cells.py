"""Free space of maps: the roadway and nothing else, whatever the sampling; walls, posts and pillars."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from synthetic_mine import SyntheticMine, straight, t_junction, x_junction

from maps.columns import columns_of
from maps.free_cells import split_ground_and_walls
from maps.free_space import FreeSpace
from maps.settings import FreeSpaceSettings
from semmap.errors import CloudError
from semmap.geometry import Array

SETTINGS = FreeSpaceSettings()


def space_of(cloud: Array) -> FreeSpace:
    return split_ground_and_walls(columns_of(cloud, SETTINGS), SETTINGS)


def inside_of(mine: SyntheticMine, space: FreeSpace) -> Array:
    """How far inside the mine each free cell lies (n,) [m]."""
    return mine.inside(space.centres(np.arange(len(space)))[:, :2] @ mine.R)


def missed(mine: SyntheticMine, space: FreeSpace, depth: float) -> float:
    """Share of the plan more than ``depth`` [m] inside the mine that is not free."""
    xy = np.random.default_rng(0).uniform(-30.0, 30.0, (20000, 2))
    return float((space.find(mine.to_map(xy[mine.inside(xy) > depth])) < 0).mean())


@pytest.mark.parametrize("width", [2.5, 4.0, 8.0])
def test_free_cells_are_the_roadway(width: float) -> None:
    mine = t_junction(width).turned(0.3)
    space = space_of(mine.cloud())
    assert missed(mine, space, 0.35) == 0.0
    assert inside_of(mine, space).min() > -0.15
    assert not space.frontier().any()
    assert (np.abs(space.headroom - 3.0) < 0.1).mean() > 0.995


@pytest.mark.parametrize("degrees", [0.0, 8.0, 15.0])
@pytest.mark.parametrize("roofed", [True, False])
def test_a_slope_is_floor(degrees: float, roofed: bool) -> None:
    mine = replace(x_junction(), slope=(float(np.tan(np.radians(degrees))), -0.1), yaw=0.4)
    space = space_of(mine.cloud(roofed=roofed))
    assert missed(mine, space, 0.4) == 0.0
    assert inside_of(mine, space).min() > -0.2
    middle = mine.to_map(np.column_stack([np.linspace(-28.0, 28.0, 90), np.zeros(90)]))
    assert np.abs(space.height[space.find(middle)] - middle[:, 2]).max() < 0.05
    assert (np.isinf(space.headroom) == (not roofed)).mean() > 0.99


@pytest.mark.parametrize("spacing", [0.2, 0.3, 0.35])
@pytest.mark.parametrize("roofed", [True, False])
def test_thin_sampling_leaves_no_holes(spacing: float, roofed: bool) -> None:
    mine = t_junction()
    space = space_of(mine.cloud(spacing, roofed=roofed))
    assert missed(mine, space, 0.6) < 0.005
    assert (inside_of(mine, space) < -0.3).mean() < 0.003


def test_noise_and_strays_change_nothing() -> None:
    mine, rng = replace(t_junction(), slope=(0.1, 0.0)), np.random.default_rng(2)
    cloud = mine.cloud(noise=0.05)
    stray = cloud[rng.integers(0, len(cloud), 600)] + rng.uniform([-1.0, -1.0, -5.0], [1.0, 1.0, 6.0], (600, 3))
    space = space_of(np.vstack([cloud, stray, [[300.0, -200.0, 0.0], [0.0, 0.0, -400.0]]]))
    assert missed(mine, space, 0.6) < 0.005
    assert inside_of(mine, space).min() > -0.3
    assert_allclose(np.median(space.headroom), 3.0, atol=0.1)
    middle = mine.to_map(np.column_stack([np.linspace(-28.0, 28.0, 90), np.zeros(90)]))
    assert np.abs(space.height[space.find(middle)] - middle[:, 2]).max() < 0.1


@pytest.mark.parametrize("roof", [1.8, 12.0])
def test_low_and_high_roofs(roof: float) -> None:
    mine = replace(t_junction(6.0), roof=roof)
    space = space_of(mine.cloud(noise=0.02))
    assert missed(mine, space, 0.5) == 0.0
    assert inside_of(mine, space).min() > -0.15
    assert_allclose(np.median(space.headroom), roof, atol=0.1)


@pytest.mark.parametrize("roofed", [True, False])
def test_a_post_is_no_wall_and_a_pillar_is(roofed: bool) -> None:
    cloud = straight(8.0).cloud(roofed=roofed)
    rng = np.random.default_rng(1)

    def block(x: float, side: float) -> tuple[Array, NDArray[np.bool_]]:
        """The four faces of a block from floor to roof, and the points in it."""
        inside = (np.abs(cloud[:, 0] - x) < 0.5 * side) & (np.abs(cloud[:, 1]) < 0.5 * side)
        along, face = rng.uniform(-0.5 * side, 0.5 * side, 6000), rng.integers(0, 4, 6000)
        out = np.where(face < 2, 0.5 * side, -0.5 * side)
        xy = np.where((face % 2 == 0)[:, None], np.column_stack([out, along]), np.column_stack([along, out]))
        return np.column_stack([xy + [x, 0.0], rng.uniform(0.0, 3.0, 6000)]), inside

    post, in_post = block(-10.0, 1.2)
    pillar, in_pillar = block(8.0, 5.0)
    space = space_of(np.vstack([cloud[~in_post & ~in_pillar], post, pillar]))
    assert space.clearance_at(np.array([-10.0, 0.0, 0.0])) > 3.0
    assert space.find(np.array([[8.0, 0.0, 0.0]]))[0] == -1
    assert space.clearance_at(np.array([8.0, 3.2, 0.0])) < 0.8
    assert not space.frontier().any()


def test_sight_measures_the_walls() -> None:
    space = space_of(straight(5.0).cloud())
    angles = np.linspace(0.3, np.pi - 0.3, 40)
    sight = space.sight(np.zeros((40, 3)), angles, 30.0)
    assert sight.at_wall.all()
    assert_allclose(sight.distance, 2.5 / np.sin(angles), atol=0.35)
    clipped = space.sight(np.zeros((1, 3)), np.array([0.0]), 10.0)
    assert clipped.distance[0] == 10.0
    assert not clipped.at_wall[0]


def test_where_the_map_lies_does_not_matter() -> None:
    cloud = t_junction().turned(0.2).cloud()
    here, there = space_of(cloud), space_of(cloud + [-80.0 * SETTINGS.ground_cell, 40.0 * SETTINGS.ground_cell, 0.0])
    assert len(here) == len(there)
    assert (here.ij - there.ij == [160, -80]).mean() > 0.99


def test_what_shows_no_floor_is_refused() -> None:
    cloud = straight().cloud(roofed=False)
    walls = cloud[(np.abs(cloud[:, 1]) > 1.9) & (np.abs(cloud[:, 0]) < 19.0)]
    for points in (walls, np.random.default_rng(0).uniform(-20.0, 20.0, (5000, 3)), np.zeros((0, 3))):
        with pytest.raises(CloudError, match="shows no floor"):
            space_of(points)
