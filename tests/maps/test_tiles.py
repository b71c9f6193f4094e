"""Tiles: every point in one part, and cells whole, however wide the tiles are."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from maps.columns import Columns, columns_of
from maps.prior_map import PriorMap
from maps.settings import FreeSpaceSettings
from maps.tiles import PointsInMemory, TiledMap, Tiles, Tiling, sorted_into_tiles

CELL = 0.2
SETTINGS = FreeSpaceSettings(cell=CELL)


def cloud(n: int = 20_000, seed: int = 0) -> np.ndarray:
    """Points on both sides of zero, many of them on cell borders, and a few strays far away."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-30, -20, -3], [25, 40, 5], (n, 3))
    points[: n // 4, :2] = np.round(points[: n // 4, :2] / CELL) * CELL
    points[-5:] = rng.uniform(-9000, 9000, (5, 3))
    return points.astype(np.float32)


def tiled(points: np.ndarray, side: float, files: int = 1) -> TiledMap:
    """The points as if they had come from several files."""
    tiling = Tiling.of(side, CELL)
    bounds = np.linspace(0, len(points), files + 1).astype(int)
    ordered, tiles = zip(
        *(sorted_into_tiles(points[low:high], tiling, file=0, row=low) for low, high in pairwise(bounds)),
        strict=True,
    )
    return TiledMap(PointsInMemory(np.concatenate(ordered)), tiling, Tiles.joined(tiles), np.zeros(3))


def in_order(points: np.ndarray) -> np.ndarray:
    """The points by x, y and z."""
    return points[np.lexsort(points.T[::-1])]


@pytest.fixture(params=[100, 700, 10**6], ids=lambda n: f"parts of {n}")
def part_points(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr("maps.tiles.PART_POINTS", request.param)
    return request.param


@pytest.mark.parametrize("files", [1, 3])
@pytest.mark.parametrize("side", [0.2, 3.0, 20.0, 5000.0])
def test_parts_hold_every_point_once_and_cells_whole(part_points: int, side: float, files: int) -> None:
    points = cloud()
    parts = [part.points() for part in tiled(points, side, files).parts()]
    assert_array_equal(in_order(np.concatenate(parts)), in_order(points))
    cells = [set(map(tuple, np.floor(part[:, :2].astype(np.float64) / CELL))) for part in parts]
    assert sum(map(len, cells)) == len(set().union(*cells))


@pytest.mark.parametrize("side", [0.2, 3.0, 20.0, 5000.0])
def test_columns_of_the_parts_are_those_of_the_whole(part_points: int, side: float) -> None:
    whole = columns_of(cloud(), SETTINGS)
    joined = Columns.joined([part.columns(SETTINGS) for part in tiled(cloud(), side).parts()])
    for name in ("ij", "first", "bottom", "top", "mean", "count"):
        assert_array_equal(getattr(joined, name), getattr(whole, name))


@pytest.mark.parametrize(("side", "most"), [(0.2, 1000), (3.0, 1000), (20.0, 1000), (60.0, 1000)])
def test_parts_stay_small_where_tiles_are_crowded_and_few_where_they_are_empty(
    side: float, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("maps.tiles.PART_POINTS", most)
    counts = [len(part.points()) for part in tiled(cloud(), side).parts()]
    assert max(counts) < 3 * most
    assert len(counts) < 6 * sum(counts) / most


@pytest.mark.parametrize("files", [1, 4])
@pytest.mark.parametrize("side", [0.2, 3.0, 20.0, 5000.0])
@pytest.mark.parametrize("p", [[0.0, 0.0, 0.0], [-29.9, 39.3, 1.0], [400.0, 0.0, 0.0]])
def test_what_is_around_a_place_is_the_same_in_any_tiles(p: list[float], side: float, files: int) -> None:
    points, place = cloud(), np.array(p)
    away = np.hypot(*(points[:, :2].astype(np.float64) - place[:2]).T)
    expected = in_order(points[away < 7.0])
    for mine in (tiled(points, side, files), TiledMap.in_memory(PriorMap(points, np.zeros(3)), CELL)):
        assert_array_equal(in_order(mine.around(place, 7.0).points()), expected)


def test_a_tile_is_a_whole_number_of_cells() -> None:
    assert Tiling.of(20.0, 0.2).cells == 100
    assert Tiling.of(20.05, 0.2).cells == 100
    assert Tiling.of(0.01, 0.2).cells == 1
    tiling = Tiling(0.2, 3)
    assert_array_equal(tiling.tiles_of(np.array([[0.0, -0.01, 0.0], [0.59, 0.61, 9.0]], np.float32)), [[0, -1], [0, 1]])


def test_no_points_make_no_parts() -> None:
    empty = TiledMap.in_memory(PriorMap(np.zeros((0, 3), np.float32), np.zeros(3)), CELL)
    assert empty.parts() == []
    assert len(empty.around(np.zeros(3), 10.0).points()) == 0
