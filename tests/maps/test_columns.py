"""Columns: what each plan cell holds, whatever the order of the points and however a map is cut into tiles."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from synthetic_mine import t_junction

from maps.columns import RUN_GAP_M, Columns, columns_of
from maps.settings import FreeSpaceSettings
from semmap.errors import CloudError
from semmap.geometry import Array

SETTINGS = FreeSpaceSettings()
CLOUD = t_junction().cloud(0.2, seed=3) + [-7.0, 3.0, -55.0]


def assert_same(a: Columns, b: Columns) -> None:
    assert a.cell == b.cell
    for one, other in zip(arrays(a), arrays(b), strict=True):
        assert one.dtype == other.dtype
        assert_array_equal(one, other)


def arrays(c: Columns) -> tuple[np.ndarray, ...]:
    return c.ij, c.first, c.bottom, c.top, c.mean, c.count


def runs_of(z: Array) -> list[Array]:
    z = np.sort(z)
    return np.split(z, np.flatnonzero(np.diff(z) > RUN_GAP_M) + 1)


@pytest.mark.parametrize("cell", [0.2, 0.4])
def test_columns_are_the_runs_of_heights_in_each_cell(cell: float) -> None:
    columns = columns_of(CLOUD, SETTINGS)
    columns = columns.coarser(round(cell / 0.2))
    assert columns.cell == cell
    own = np.floor(CLOUD[:, :2] / cell)
    cells, owner = np.unique(own, axis=0, return_inverse=True)
    assert_array_equal(columns.ij, cells)
    for k in range(0, len(cells), 17):
        runs = runs_of(CLOUD[owner.ravel() == k, 2])
        mine = slice(columns.first[k], columns.first[k + 1])
        assert_allclose(columns.bottom[mine], [run[0] for run in runs], atol=0.001)
        assert_allclose(columns.top[mine], [run[-1] for run in runs], atol=0.001)
        assert_allclose(columns.mean[mine], [run.mean() for run in runs], atol=0.001)
        assert_array_equal(columns.count[mine], [len(run) for run in runs])


def test_the_order_of_the_points_does_not_matter() -> None:
    rng = np.random.default_rng(0)
    assert_same(columns_of(rng.permutation(CLOUD), SETTINGS), columns_of(CLOUD, SETTINGS))


@pytest.mark.parametrize("cells_a_tile", [7, 32, 4000])
def test_tiles_join_to_the_whole(cells_a_tile: int) -> None:
    whole = columns_of(CLOUD, SETTINGS)
    ij = np.floor(CLOUD[:, :2] / SETTINGS.cell)
    _, tile = np.unique(ij // cells_a_tile, axis=0, return_inverse=True)
    parts = [columns_of(CLOUD[tile.ravel() == k], SETTINGS) for k in range(tile.max() + 1)]
    assert_same(Columns.joined(parts[::-1]), whole)
    assert_same(Columns.joined(parts).coarser(3), whole.coarser(3))


def test_parts_with_a_cell_in_common_are_refused() -> None:
    whole = columns_of(CLOUD, SETTINGS)
    with pytest.raises(ValueError, match="share a cell"):
        Columns.joined([whole, columns_of(CLOUD[:1], SETTINGS)])
    with pytest.raises(ValueError, match="one size"):
        Columns.joined([whole, whole.coarser(2)])


def test_no_points_no_columns() -> None:
    nothing = columns_of(np.zeros((0, 3)), SETTINGS)
    assert len(nothing) == len(nothing.coarser(2)) == 0
    assert_same(Columns.joined([nothing, columns_of(CLOUD, SETTINGS)]), columns_of(CLOUD, SETTINGS))


def test_points_impossibly_far_apart_are_named() -> None:
    with pytest.raises(CloudError, match="remove stray points"):
        columns_of(np.array([[-1e8, -1e8, -1e8], [1e8, 1e8, 1e8]]), SETTINGS)
