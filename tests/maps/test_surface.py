"""Surfaces of linked cells: on one level the kernels do what raster filters do; levels stay apart."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy import ndimage

from maps._numba_floor import DI, DJ, UNKNOWN, WALL
from maps._numba_parts import (
    all_around,
    any_around,
    bridge,
    doors_of,
    fill_islands,
    in_order,
    neighbours_of_parts,
    steps_from,
)
from maps._numba_surface import ease, lower_envelope
from maps.settings import FreeSpaceSettings
from maps.surface import Surface, grouped
from semmap.geometry import Array

SETTINGS = FreeSpaceSettings()
SHAPE = (24, 30)
EIGHT = np.ones((3, 3), bool)


def flat(height: Array | None = None, kept: NDArray[np.bool_] | None = None) -> Surface:
    """Cells of a raster, in a scattered order, as a surface."""
    kept = np.ones(SHAPE, bool) if kept is None else kept
    ij = np.random.default_rng(0).permutation(np.argwhere(kept).astype(np.int32))
    z = (np.zeros(SHAPE) if height is None else height)[tuple(ij.T)].astype(np.float32)
    seen = np.ones(len(ij), bool)
    return Surface.linked(0.4, ij, z, np.full(len(ij), 3.0, np.float32), seen, ~seen, SETTINGS)


def small(mask: NDArray[np.bool_], parts: int) -> NDArray[np.bool_]:
    """A raster of small cells in their order cell by cell."""
    i, j = mask.shape[0] // parts, mask.shape[1] // parts
    return np.ascontiguousarray(mask.reshape(i, parts, j, parts).transpose(0, 2, 1, 3)).ravel()


def raster(parts: int, seed: int = 0) -> NDArray[np.bool_]:
    rng = np.random.default_rng(seed)
    mask = ndimage.gaussian_filter(rng.normal(size=(SHAPE[0] * parts, SHAPE[1] * parts)), 1.5) > -0.05
    mask[[0, -1]] = mask[:, [0, -1]] = False
    return np.asarray(mask)


def test_cells_know_the_cells_next_door() -> None:
    kept = raster(1)
    surface = flat(kept=kept)
    assert_array_equal(surface.ij, np.argwhere(kept))
    for row, (i, j) in enumerate(surface.ij):
        for k in range(8):
            other = surface.neighbours[row, k]
            assert kept[i + DI[k], j + DJ[k]] == (other >= 0)
            if other >= 0:
                assert_array_equal(surface.ij[other], [i + DI[k], j + DJ[k]])


@pytest.mark.parametrize("parts", [1, 2, 3])
@pytest.mark.parametrize("edge", [True, False])
def test_steps_are_the_taxicab_distance(parts: int, edge: bool) -> None:
    mask = raster(parts, seed=3) & raster(parts, seed=4)
    steps = np.empty(mask.size, np.uint8)
    steps_from(flat().neighbours, doors_of(parts), small(mask, parts), edge, 5, steps)
    around = np.pad(mask, 1, constant_values=edge)
    exact = ndimage.distance_transform_cdt(~around, "taxicab")[1:-1, 1:-1]
    assert_array_equal(steps, small(np.minimum(exact, 6), parts))


@pytest.mark.parametrize("parts", [1, 2])
def test_cells_around_are_those_of_erosion_and_dilation(parts: int) -> None:
    mask, out = raster(parts), np.empty(raster(parts).size, bool)
    all_around(flat().neighbours, doors_of(parts), small(mask, parts), out)
    assert_array_equal(out, small(ndimage.binary_erosion(mask, EIGHT), parts))
    any_around(flat().neighbours, doors_of(parts), small(mask, parts), out)
    assert_array_equal(out, small(ndimage.binary_dilation(mask, EIGHT), parts))


def test_gaps_of_thin_walls_are_bridged_and_straight_ones_stay_thin() -> None:
    mask = np.zeros(SHAPE, bool)
    mask[4], mask[4, 10:13], mask[4, 20:25] = True, False, False
    mask[np.arange(8, 22), np.arange(8, 22)] = True
    mask[14:16, 14:16] = False
    out = np.empty(mask.size, bool)
    bridge(flat().neighbours, doors_of(1), mask.ravel(), 3, out)
    expected = mask.copy()
    expected[4, 10:13] = expected[[14, 15], [14, 15]] = True
    assert (out.reshape(SHAPE) >= expected).all()
    assert out.sum() <= expected.sum() + 8
    assert not out.reshape(SHAPE)[:3].any()
    assert not out.reshape(SHAPE)[4, 21:24].any()


def test_islands_are_filled_up_to_their_size_and_not_at_the_edge() -> None:
    mask = raster(2, seed=5)
    filled = small(mask, 2)
    fill_islands(flat().neighbours, doors_of(2), filled, 12)
    labels, count = ndimage.label(~mask)
    area = np.bincount(labels.ravel(), minlength=count + 1)
    area[labels[0, 0]] = 999
    assert_array_equal(filled, small(mask | (area < 12)[labels], 2))
    assert (filled != small(mask, 2)).any()


def test_small_cells_come_in_order_and_know_each_other() -> None:
    mask, wall = raster(2, seed=6), raster(2, seed=7)
    surface, free, rock = flat(), small(mask, 2), small(wall, 2)
    rows, plan = np.empty(free.sum(), np.int32), np.empty((free.sum(), 2), np.int32)
    in_order(surface.ij, 2, free, rows, plan)
    assert_array_equal(plan, np.argwhere(mask))
    neighbours = np.empty((len(rows), 8), np.int32)
    neighbours_of_parts(surface.neighbours, doors_of(2), rows, rock, neighbours)
    number = np.where(wall, WALL, UNKNOWN)
    number[mask] = np.arange(len(rows))
    assert_array_equal(neighbours, number[plan[:, 0, None] + DI, plan[:, 1, None] + DJ])


def test_no_surface_above_the_lower_envelope_is_gentler() -> None:
    rng = np.random.default_rng(8)
    height = ndimage.gaussian_filter(rng.normal(size=SHAPE), 1.5) * 1.5
    surface = flat(height)
    assert (surface.neighbours >= 0).all(axis=1).sum() == (SHAPE[0] - 2) * (SHAPE[1] - 2)
    envelope = np.empty_like(surface.height)
    lower_envelope(surface.neighbours, surface.height, 0.1, envelope)
    di, dj = np.abs(surface.ij[:, None] - surface.ij[None]).transpose(2, 0, 1)
    away = np.maximum(di, dj) + (np.sqrt(2.0) - 1.0) * np.minimum(di, dj)
    assert_allclose(envelope, (surface.height[None] + 0.1 * away).min(axis=1), atol=1e-5)


def test_what_is_carried_on_lies_around_and_stays_on_its_level() -> None:
    kept = np.zeros(SHAPE, bool)
    kept[8:16, 8:20] = True
    below = flat(kept=kept)
    two = below.extended(below.ij, below.height + np.float32(2.0), below.headroom, False, SETTINGS)
    wider = two.carried_on(3, SETTINGS)
    assert_array_equal(np.unique(wider.height), [0.0, 2.0])
    square = ndimage.binary_dilation(kept, EIGHT, iterations=3)
    for z in (0.0, 2.0):
        assert_array_equal(wider.ij[wider.height == z], np.argwhere(square))
    assert (wider.seen.sum(), len(two)) == (kept.sum(), 2 * kept.sum())
    rows, k = np.nonzero(wider.neighbours >= 0)
    assert_array_equal(wider.height[rows], wider.height[wider.neighbours[rows, k]])


def test_scraps_and_steep_feet_go() -> None:
    kept = np.zeros(SHAPE, bool)
    kept[2:14, 2:20] = kept[20:22, 25:28] = True
    height = np.zeros(SHAPE)
    height[12], height[13] = 0.5, 0.9
    surface = flat(height, kept).gently_sloping(SETTINGS).without_scraps(SETTINGS)
    assert_array_equal(surface.ij, np.argwhere(kept)[np.argwhere(kept)[:, 0] < 12])


def test_easing_ends_at_the_plane_between_what_is_fixed() -> None:
    i, _ = np.meshgrid(*map(np.arange, SHAPE), indexing="ij")
    surface = flat(0.05 * i)
    inner = np.flatnonzero((surface.neighbours >= 0).all(axis=1))
    height = surface.height.copy()
    height[inner] = 0.0
    ease(surface.neighbours, inner, 800, height)
    assert_allclose(height, surface.height, atol=0.01)


def test_named_twice_is_one_and_two_levels_are_two() -> None:
    ij = np.array([[1, 2], [1, 2], [1, 2], [0, 5]], np.int32)
    height, headroom = np.array([0.0, 3.0, 0.2, 1.0], np.float32), np.array([3.0, 2.0, 2.5, 9.0], np.float32)
    cells, z, room = grouped(ij, height, headroom)
    assert_array_equal(cells, [[0, 5], [1, 2], [1, 2]])
    assert_allclose(z, [1.0, 0.1, 3.0])
    assert_allclose(room, [9.0, 2.5, 2.0])
    assert len(grouped(ij[:0], height[:0], headroom[:0])[0]) == 0
