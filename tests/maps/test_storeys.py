"""Levels above each other: stacked drifts, a ramp over a drift, a spiral decline; each whole and none else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from synthetic_mine import SyntheticMine, straight, t_junction

from maps.columns import Columns, columns_of
from maps.free_cells import split_ground_and_walls
from maps.free_space import FreeSpace
from maps.settings import FreeSpaceSettings
from semmap.geometry import Array

SETTINGS = FreeSpaceSettings()


def space_of(cloud: Array) -> FreeSpace:
    return split_ground_and_walls(columns_of(cloud, SETTINGS), SETTINGS)


def pieces(space: FreeSpace) -> tuple[int, np.ndarray]:
    """Number of connected pieces of the floor, and which one each cell is of."""
    rows, k = np.nonzero(space.neighbours >= 0)
    linked = coo_matrix((np.ones(len(rows)), (rows, space.neighbours[rows, k])), shape=(len(space), len(space)))
    count, labels = connected_components(linked, directed=False)
    return int(count), labels


def plan_at(mine: SyntheticMine, depth: float) -> Array:
    xy = np.random.default_rng(0).uniform(-30.0, 30.0, (8000, 2))
    return xy[mine.inside(xy) > depth]


@pytest.mark.parametrize("rise", [4.5, 6.0, 12.0])
@pytest.mark.parametrize("roofed", [True, False])
def test_drifts_right_above_each_other_are_two_levels(rise: float, roofed: bool) -> None:
    mine = t_junction().turned(0.3)
    clouds = [mine.cloud(seed=1), mine.cloud(seed=2, roofed=roofed) + [0.0, 0.0, rise]]
    space = space_of(np.vstack(clouds))
    p = mine.to_map(plan_at(mine, 0.4))
    for z in (0.0, rise):
        rows = space.find(p + [0.0, 0.0, z])
        assert (rows >= 0).all()
        assert_allclose(space.height[rows], z, atol=0.05)
    assert set(np.round(space.height / rise).astype(int)) == {0, 1}
    assert pieces(space)[0] == 2
    assert_allclose(np.median(space.headroom[space.height < 1.0]), 3.0, atol=0.1)


def test_a_drift_crosses_over_another() -> None:
    below, above = straight(), replace(straight(5.0), yaw=1.2)
    space = space_of(np.vstack([below.cloud(), above.cloud(seed=1) + [0.0, 0.0, 4.6]]))
    assert pieces(space)[0] == 2
    assert space.clearance_at(np.array([0.0, 0.0, 0.0])) == pytest.approx(2.0, abs=0.3)
    assert space.clearance_at(np.array([0.0, 0.0, 4.6])) == pytest.approx(2.5, abs=0.3)
    length = [space.sight(np.array([[0.0, 0.0, z]]), np.array([yaw]), 30.0) for z, yaw in ((0.0, 0.0), (4.6, 1.2))]
    assert_allclose([sight.distance[0] for sight in length], 20.0, atol=0.5)
    assert all(sight.at_wall[0] for sight in length)


def test_a_ramp_climbs_over_the_drift_it_leaves() -> None:
    """Up 15 degrees along x, over a cross-cut of the lower level."""
    rise = float(np.tan(np.radians(15.0)))
    ramp = SyntheticMine(((-30.0, 0.0, 30.0, 0.0, 4.5),), slope=(rise, 0.0))
    cut = SyntheticMine(((20.0, -25.0, 20.0, 25.0, 4.0),))
    z = -30.0 * rise
    space = space_of(np.vstack([ramp.cloud(), cut.cloud(seed=1) + [0.0, 0.0, z]]))
    axis = ramp.to_map(np.column_stack([np.linspace(-28.0, 28.0, 200), np.zeros(200)]))
    rows = space.find(axis)
    assert (rows >= 0).all()
    assert np.abs(space.height[rows] - axis[:, 2]).max() < 0.06
    assert space.clearance[rows].min() > 1.7
    assert pieces(space)[0] == 2
    crossing = np.array([[20.0, y, z] for y in np.linspace(-23.0, 23.0, 90)])
    assert space.clearance[space.find(crossing)].min() > 1.5


def spiral(turns: float, pitch: float, radius: float = 14.0, width: float = 4.0, roof: float = 3.0) -> Array:
    """Points (n, 3) of a decline that winds around the z axis, ``pitch`` [m] a turn."""
    rng, n = np.random.default_rng(0), int(2.0 * np.pi * radius * turns * width / 0.01)
    angle = rng.uniform(0.0, 2.0 * np.pi * turns, 4 * n)
    out, up = radius + rng.uniform(-0.5, 0.5, 4 * n) * width, rng.uniform(0.0, roof, 4 * n)
    up[:n], up[n : 2 * n] = 0.0, roof
    out[2 * n : 3 * n], out[3 * n :] = radius - 0.5 * width, radius + 0.5 * width
    side = angle[2 * n :] < 2.0 * np.pi * turns * 0.7 + 99.0 * (np.arange(2 * n) % 2)
    keep = np.concatenate([np.ones(2 * n, bool), side])
    points = np.column_stack([out * np.cos(angle), out * np.sin(angle), pitch * angle / (2.0 * np.pi) + up])
    ends = np.column_stack([rng.uniform(radius - 2.0, radius + 2.0, 4000), rng.uniform(0.0, roof, 4000)])
    first = np.column_stack([ends[:, 0], np.zeros(4000), ends[:, 1]])
    c, s = np.cos(2.0 * np.pi * turns), np.sin(2.0 * np.pi * turns)
    last = np.column_stack([ends[:, 0] * c, ends[:, 0] * s, ends[:, 1] + pitch * turns])
    return np.vstack([points[keep], first, last]) + 0.005 * rng.normal(size=(keep.sum() + 8000, 3))


@pytest.mark.parametrize("pitch", [5.0, 9.0])
def test_a_spiral_decline_is_one_floor_over_itself(pitch: float) -> None:
    turns = 2.4
    space = space_of(spiral(turns, pitch))
    angle = np.linspace(0.1, 2.0 * np.pi * turns - 0.1, 300)
    axis = np.column_stack([14.0 * np.cos(angle), 14.0 * np.sin(angle), pitch * angle / (2.0 * np.pi)])
    rows = space.find(axis)
    assert (rows >= 0).all()
    assert np.abs(space.height[rows] - axis[:, 2]).max() < 0.1
    count, _ = pieces(space)
    assert count == 1
    assert_allclose(space.clearance[rows[20:-20]], 2.0, atol=0.35)
    # from one turn to the next it is a turn's way, although they are above each other
    p = axis[100]
    assert np.abs(space.height[space.around(p, 4.0)] - p[2]).max() < 0.2 * pitch
    assert len(space) * SETTINGS.cell**2 == pytest.approx(2.0 * np.pi * 14.0 * turns * 4.0, rel=0.08)


def test_a_roof_seen_from_above_and_terrain_off_the_mine_are_no_floor() -> None:
    space = space_of(t_junction().cloud())
    assert space.height.max() < 0.3
    rng = np.random.default_rng(5)
    terrain = np.column_stack([rng.uniform(-40.0, 40.0, (60000, 2)), np.full(60000, 14.0)])
    under_a_hill = space_of(np.vstack([t_junction().cloud(), terrain]))
    assert under_a_hill.height.max() < 0.3
    assert len(under_a_hill) == pytest.approx(len(space), rel=0.01)


def test_tiles_give_the_same_floor() -> None:
    cloud = np.vstack([t_junction().cloud(), t_junction().cloud() + [0.0, 0.0, 6.0]])
    tile = np.floor(cloud[:, 0] / 8.0).astype(int)
    parts = [columns_of(cloud[tile == k], SETTINGS) for k in np.unique(tile)]
    whole, joined = space_of(cloud), split_ground_and_walls(Columns.joined(parts), SETTINGS)
    for name in ("ij", "height", "headroom", "neighbours", "clearance"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(joined, name))
