"""Describing an intersection: from its place and the points around it alone, in any order, on its own level."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from synthetic_mine import SyntheticMine, t_junction, x_junction

from maps.columns import columns_of
from maps.describe import Place, completeness, describe, description_radius, place_of
from maps.floor_patch import FloorPatch
from maps.free_cells import split_ground_and_walls
from maps.free_space import FreeSpace
from maps.intersections import find_intersections
from maps.settings import MapSettings
from maps.topology import roadway_topology
from semmap.geometry import Array
from semmap.intersections import Intersection

SETTINGS = MapSettings()
ORIGIN = np.array([500000.0, 4.4e6, 2000.0])
MINE = replace(t_junction(4.0, 3.0), slope=(0.12, -0.05), yaw=0.4)


def space_of(cloud: Array) -> FreeSpace:
    return split_ground_and_walls(columns_of(cloud, SETTINGS.free_space), SETTINGS.free_space)


def place_in(cloud: Array) -> Place:
    space = space_of(cloud)
    (crossing,) = find_intersections(roadway_topology(space, SETTINGS.topology), space, SETTINGS.topology)
    return place_of(crossing, space, SETTINGS)


@pytest.fixture(scope="module")
def cloud() -> Array:
    return MINE.cloud()


@pytest.fixture(scope="module")
def place(cloud: Array) -> Place:
    return place_in(cloud)


def assert_same(one: Intersection, other: Intersection) -> None:
    for name in ("p_map", "branch_bearings", "branch_widths", "cloud", "quality", "kind"):
        assert_array_equal(getattr(one, name), getattr(other, name))
    for name in ("pwcv", "pwcv_observed", "cwc", "cwc_observed"):
        assert_array_equal(getattr(one.contour, name), getattr(other.contour, name))


def test_a_place_pickles_small_and_describes_the_same_elsewhere(cloud: Array, place: Place) -> None:
    sent = pickle.dumps(place)
    assert len(sent) < 100_000
    here, there = (describe(7, one, cloud, ORIGIN, SETTINGS) for one in (place, pickle.loads(sent)))
    assert_same(here, there)
    assert here.id == 7
    assert_allclose(here.p_map - ORIGIN, place.crossing.p)


def test_neither_the_order_of_the_points_nor_those_far_off_matter(cloud: Array, place: Place) -> None:
    points = cloud.astype(np.float32)
    whole = describe(0, place, points, ORIGIN, SETTINGS)
    near = points[np.hypot(*(points[:, :2] - place.crossing.p[:2]).T) < description_radius(SETTINGS) + 0.1]
    assert len(near) < len(points)
    assert_same(describe(0, place, np.random.default_rng(0).permutation(near), ORIGIN, SETTINGS), whole)


def test_points_of_other_levels_and_beyond_the_rock_are_left_out(cloud: Array, place: Place) -> None:
    rng = np.random.default_rng(1)
    above, below = x_junction().cloud(seed=2) + [0.0, 0.0, 9.0], x_junction().cloud(seed=3) - [0.0, 0.0, 9.0]
    beside = rng.uniform([6.0, -14.0, -1.0], [14.0, -7.0, 4.0], (3000, 3))
    beside = np.column_stack([beside[:, :2] @ MINE.R.T, beside[:, 2]])
    more = describe(0, place, np.vstack([cloud, above, below, beside]), ORIGIN, SETTINGS)
    assert_same(more, describe(0, place, cloud, ORIGIN, SETTINGS))


def test_the_cloud_is_all_around_from_floor_to_roof(cloud: Array, place: Place) -> None:
    one = describe(0, place, cloud, ORIGIN, SETTINGS)
    heights = place.floor.heights(one.cloud + place.crossing.p)
    assert_allclose(np.percentile(heights, [2, 98]), [0.0, 3.0], atol=0.15)
    assert np.hypot(one.cloud[:, 0], one.cloud[:, 1]).max() < SETTINGS.cloud_radius


def test_quality_falls_where_walls_were_not_scanned(cloud: Array, place: Place) -> None:
    whole = describe(0, place, cloud, ORIGIN, SETTINGS).quality
    assert 0.9 < whole <= 1.0
    above = place.floor.heights(cloud) > 1.0
    aside = (cloud - place.crossing.p) @ [0.3, 1.0, 0.0] > 0.0
    partly = describe(0, place, cloud[~(above & aside)], ORIGIN, SETTINGS).quality
    half = describe(0, place, cloud[~above], ORIGIN, SETTINGS).quality
    assert half < partly - 0.1
    assert partly < whole - 0.1


def test_a_low_roof_takes_nothing_from_the_quality() -> None:
    low = replace(MINE, roof=1.9).cloud()
    place = place_in(low)
    assert_allclose(place.headroom, 1.9, atol=0.1)
    one = describe(0, place, low, ORIGIN, SETTINGS)
    assert one.quality > 0.9
    assert completeness(one.contour, np.inf, SETTINGS.contour) < 0.85


def test_a_place_without_a_roof_is_described() -> None:
    open_top = MINE.cloud(roofed=False)
    place = place_in(open_top)
    assert np.isinf(place.headroom)
    assert describe(0, place, open_top, ORIGIN, SETTINGS).quality > 0.9


def test_sureness_is_that_of_the_closest_call() -> None:
    def sureness(mine: SyntheticMine) -> float:
        return place_in(mine.cloud()).crossing.sureness

    depths = [
        sureness(SyntheticMine(((-30, 0, 30, 0, 3.0), (0, 0, 0, -1.5 - depth, 3.0)))) for depth in (6.0, 7.5, 25.0)
    ]
    assert depths == sorted(depths)
    assert 0.5 <= depths[0] < 0.75
    assert depths[-1] == 1.0
    widths = [sureness(x_junction(width)) for width in (6.0, 9.0)]
    assert widths[0] == 1.0
    assert widths[1] < 0.95


def heights_in_plain_numpy(patch: FloorPatch, points: Array) -> Array:
    cells, inside = patch.grid.cells(points[:, :2])
    floor, roof = patch.floor.ravel()[cells], patch.roof.ravel()[cells]
    top = np.where(np.isinf(roof), np.where(roof > 0.0, floor + 10.0, -np.inf), roof + 1.0)
    on_level = inside & (points[:, 2] >= floor - 1.0) & (points[:, 2] <= top)
    return np.where(on_level, points[:, 2] - patch.grid.sample(patch.floor.astype(np.float64), points[:, :2]), np.nan)


@pytest.mark.parametrize("roofed", [True, False])
def test_heights_agree_with_plain_numpy(roofed: bool) -> None:
    patch = FloorPatch.around(np.zeros(3), 9.0, space_of(MINE.cloud(roofed=roofed)))
    points = np.random.default_rng(0).uniform([-12, -12, -4], [12, 12, 14], (20000, 3))
    heights = patch.heights(points)
    assert 1000 < np.isfinite(heights).sum() < 19000
    assert_allclose(heights, heights_in_plain_numpy(patch, points), atol=1e-5)
    truth = points[:, 2] - MINE.to_map(points[:, :2] @ MINE.R)[:, 2]
    over_floor = np.isfinite(heights) & (MINE.inside(points[:, :2] @ MINE.R) > 0.3)
    assert_allclose(heights[over_floor], truth[over_floor], atol=0.06)


def test_a_patch_off_the_floor_holds_nothing() -> None:
    patch = FloorPatch.around(np.array([500.0, 0.0, 0.0]), 5.0, space_of(MINE.cloud(0.2)))
    assert np.isnan(patch.heights(np.array([[500.0, 0.0, 0.0]]))).all()
