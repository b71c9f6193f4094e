"""Floor cells: distances, walks and look-ups on one level against rasters, and on several levels."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy import ndimage

from maps._numba_floor import DI, DJ, UNKNOWN, WALL
from maps._numba_rays import FREE
from maps._numba_rays import UNKNOWN as UNSEEN
from maps._numba_rays import WALL as ROCK
from maps.free_space import FreeSpace
from semmap.geometry import Array

CELL = 0.2


def random_cells(seed: int) -> NDArray[np.uint8]:
    """A raster of wide free space with rock and unseen patches in it."""
    rng = np.random.default_rng(seed)
    rough = ndimage.gaussian_filter(rng.normal(size=(90, 70)), 3.0)
    cells = np.where(rough > 0.05, np.uint8(ROCK), np.uint8(FREE))
    cells[ndimage.gaussian_filter(rng.normal(size=cells.shape), 4.0) > 0.1] = UNSEEN
    cells[[0, -1]] = cells[:, [0, -1]] = UNSEEN
    return cells


def space_of(cells: NDArray[np.uint8], slope: float = 0.0) -> FreeSpace:
    height = slope * CELL * np.arange(cells.shape[0])[:, None] + np.zeros(cells.shape)
    return FreeSpace.from_raster(cells, height, cell=CELL, corner=(-3.0, 7.0))


def stacked(below: FreeSpace, above: FreeSpace, rise: float, headroom: float) -> FreeSpace:
    """Two levels as one space."""
    ij = np.vstack([below.ij, above.ij])
    height = np.concatenate([below.height, above.height + np.float32(rise)])
    order = np.lexsort((height, ij[:, 1], ij[:, 0]))
    row = np.argsort(order).astype(np.int32)
    shifted = np.where(above.neighbours >= 0, above.neighbours + len(below), above.neighbours)
    old = np.vstack([below.neighbours, shifted])[order]
    neighbours = np.where(old >= 0, row[old], old).astype(np.int32)
    roof = np.full(len(ij), headroom, np.float32)
    return FreeSpace.of_cells(CELL, below.corner, ij[order], height[order], roof, neighbours)


@pytest.mark.parametrize("seed", range(5))
def test_clearance_is_the_euclidean_distance_transform(seed: int) -> None:
    cells = random_cells(seed)
    space = space_of(cells)
    exact = ndimage.distance_transform_edt(cells == FREE)[tuple(space.ij.T)] * CELL
    assert (space.clearance >= exact - 1e-5).all()
    assert_allclose(space.clearance, exact, atol=0.15 * CELL)
    assert (np.abs(space.clearance - exact) < 1e-5).mean() > 0.999


def test_neighbours_are_mutual_and_next_door() -> None:
    space = space_of(random_cells(1))
    rows, k = np.nonzero(space.neighbours >= 0)
    others = space.neighbours[rows, k]
    assert_array_equal(space.ij[others] - space.ij[rows], np.column_stack([DI[k], DJ[k]]))
    assert_array_equal(space.neighbours[others, (k + 4) % 8], rows)


@pytest.mark.parametrize("seed", range(3))
def test_sight_is_a_march_through_the_raster(seed: int) -> None:
    cells, rng = random_cells(seed), np.random.default_rng(seed)
    space = space_of(cells, slope=0.2)
    p = space.centres(rng.choice(len(space), 300)) + [*rng.uniform(-0.09, 0.09, 2), 0.3]
    angle = rng.uniform(-4.0, 7.0, 300)
    sight = space.sight(p, angle, 8.0)
    steps = np.arange(0.0, 8.0 / CELL, 0.25)
    beside_rock = np.pad(ndimage.binary_dilation(cells == ROCK, np.ones((3, 3))), 50)
    padded = np.pad(cells, 50, constant_values=UNSEEN)
    for k, (x, y) in enumerate((p[:, :2] - space.corner) / CELL):
        i, j = np.floor([x + steps * np.cos(angle[k]), y + steps * np.sin(angle[k])]).astype(int) + 50
        stop = np.flatnonzero(padded[i, j] != FREE)
        assert sight.distance[k] == pytest.approx(steps[stop[0]] * CELL if len(stop) else 8.0)
        assert sight.at_wall[k] == (len(stop) > 0 and beside_rock[i[stop[0]], j[stop[0]]])


def test_nothing_is_in_sight_off_the_floor() -> None:
    sight = space_of(random_cells(0)).sight(np.array([[-50.0, 0.0, 0.0]]), np.zeros(1), 5.0)
    assert (sight.distance[0], sight.at_wall[0]) == (0.0, False)


def test_the_frontier_is_beside_unseen_cells_away_from_walls() -> None:
    cells = random_cells(2)
    space = space_of(cells)
    eight = np.ones((3, 3), bool)
    unseen = (cells == UNSEEN) & ~ndimage.binary_dilation(cells == ROCK, eight)
    assert_array_equal(space.frontier(), ndimage.binary_dilation(unseen, eight)[tuple(space.ij.T)])
    assert space.frontier().any()


def levels() -> tuple[FreeSpace, FreeSpace]:
    """A flat level, and one 4 m above it that climbs along x; both 10 m by 10 m with walls around."""
    cells = np.full((52, 52), ROCK, np.uint8)
    cells[1:-1, 1:-1] = FREE
    return space_of(cells), space_of(cells, slope=0.25)


def test_levels_above_each_other_do_not_touch() -> None:
    flat, ramp = levels()
    both = stacked(flat, ramp, 4.0, 3.0)
    assert_allclose(np.sort(both.clearance), np.sort(np.concatenate([flat.clearance, ramp.clearance])))
    middle = both.corner + 26 * CELL
    below, above = np.append(middle, 0.4), np.append(middle, 5.4)
    rows = both.find(np.array([below, above, np.append(middle, 2.9), [-50.0, 0.0, 0.0]]))
    assert_allclose(both.height[rows[:2]], [0.0, 4.0 + 0.25 * 26 * CELL])
    assert_array_equal(rows[2:], -1)
    for p, level in ((below, flat), (above, ramp)):
        near = both.around(p, 2.5)
        assert_allclose(
            both.centres(near)[:, :2], level.centres(level.around(p - [0, 0, p[2] - level.height[0]], 2.5))[:, :2]
        )
        assert abs(len(near) * CELL**2 - np.pi * 2.5**2) < 0.5
        assert both.clearance_at(p) == pytest.approx(5.0, abs=0.15)


def test_clearance_between_cells_is_linear() -> None:
    flat, _ = levels()
    p = np.column_stack([np.linspace(-2.7, 0.0, 30), np.full(30, 12.0), np.zeros(30)])
    expected: Array = p[:, 0] + 3.0 - 0.5 * CELL
    assert_allclose([flat.clearance_at(one) for one in p], expected, atol=1e-5)


def test_walls_and_unseen_are_told_apart() -> None:
    cells = np.full((5, 5), UNSEEN, np.uint8)
    cells[2, 2], cells[2, 3] = FREE, ROCK
    one = space_of(cells).neighbours[0]
    assert set(one.tolist()) == {WALL, UNKNOWN}
    assert one[0] == WALL
    assert_array_equal(one == WALL, DJ >= 0)
