"""Grids: where points fall, and what the cells then hold."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from maps.grid import Grid
from semmap.errors import CloudError

RNG = np.random.default_rng(0)


def test_a_point_lies_in_its_cell() -> None:
    xy = RNG.uniform(-50.0, 80.0, (500, 2))
    grid = Grid.around(xy, 0.4, margin=1.0)
    cells, inside = grid.cells(xy)
    assert inside.all()
    centres = grid.centres(np.stack(np.unravel_index(cells, grid.shape), axis=-1))
    assert np.abs(centres - xy).max() <= 0.2 + 1e-9


def test_points_outside_are_told_apart() -> None:
    grid = Grid(0.0, 0.0, 1.0, (4, 3))
    _, inside = grid.cells(np.array([[-0.1, 0.5], [3.9, 2.9], [4.0, 1.0], [1.0, 3.0]]))
    assert_array_equal(inside, [False, True, False, False])


def test_count_and_lowest_agree_with_a_loop() -> None:
    points = RNG.uniform(0.0, 3.0, (200, 3))
    grid = Grid(0.0, 0.0, 0.5, (6, 6))
    count, low = grid.count(points[:, :2]), grid.lowest(points)
    for i in range(6):
        for j in range(6):
            here = points[(points[:, 0] // 0.5 == i) & (points[:, 1] // 0.5 == j)]
            assert count[i, j] == len(here)
            assert low[i, j] == (here[:, 2].min() if len(here) else np.inf)


def test_sampling_is_exact_on_a_plane() -> None:
    grid = Grid(-3.0, 2.0, 0.5, (20, 30))
    i, j = np.meshgrid(np.arange(20), np.arange(30), indexing="ij")
    centres = grid.centres(np.stack([i, j], axis=-1).reshape(-1, 2))
    raster = (2.0 * centres[:, 0] - 0.7 * centres[:, 1]).reshape(20, 30)
    xy = RNG.uniform([-2.5, 2.5], [6.0, 16.0], (100, 2))
    assert_allclose(grid.sample(raster, xy), 2.0 * xy[:, 0] - 0.7 * xy[:, 1], atol=1e-9)


def test_a_stray_point_far_off_is_named_instead_of_filling_the_memory() -> None:
    with pytest.raises(CloudError, match=r"stretches over .* km; remove stray points"):
        Grid.around(np.array([[0.0, 0.0], [9e4, 9e4]]), 0.4, margin=2.0)
