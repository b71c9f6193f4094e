"""Medial axis and its graph: topology kept, lines in the middle, every line found once, on one level and on several."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray
from scipy import ndimage

from maps._numba_floor import DI, DJ
from maps._numba_rays import FREE, WALL
from maps._numba_thinning import thin
from maps.free_space import FreeSpace
from maps.skeleton import SkeletonGraph, medial_axis, skeleton_graph

EIGHT = np.ones((3, 3), dtype=int)
CELL = 0.2


def space_of(free: NDArray[np.bool_]) -> FreeSpace:
    cells = np.where(np.pad(free, 1), np.uint8(FREE), np.uint8(WALL))
    return FreeSpace.from_raster(cells, np.zeros(cells.shape), cell=CELL, corner=(0.0, 0.0))


def raster(space: FreeSpace, rows: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Chosen cells of a level as a raster, with a border."""
    out = np.zeros(space.ij.max(axis=0) + 2, dtype=bool)
    out[tuple(space.ij[rows].T)] = True
    return out


def blobs(seed: int) -> NDArray[np.bool_]:
    """Random connected and unconnected shapes with holes."""
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(80, 70)), 3.0)
    return noise > 0.0


def thinned_in_plain_numpy(mask: NDArray[np.bool_], order: NDArray[np.int64]) -> NDArray[np.bool_]:
    """The kernel's rule by counting: a cell goes if its free neighbours hang together and an edge of it is not free."""
    mask = mask.copy()
    for i, j in order:
        around = mask[i - 1 : i + 2, j - 1 : j + 2].copy()
        around[1, 1] = False
        by_edge = not (around[0, 1] and around[1, 0] and around[1, 2] and around[2, 1])
        if around.sum() > 1 and by_edge and ndimage.label(around, EIGHT)[1] == 1:
            mask[i, j] = False
    return mask


@pytest.mark.parametrize("seed", range(3))
def test_thinning_agrees_with_plain_numpy(seed: int) -> None:
    space = space_of(blobs(seed))
    order = np.random.default_rng(seed).permutation(len(space))
    kept = np.ones(len(space), dtype=bool)
    expected = thinned_in_plain_numpy(raster(space, kept), space.ij[order])
    thin(kept, space.neighbours, order)
    assert_array_equal(raster(space, kept), expected[: space.ij[:, 0].max() + 2, : space.ij[:, 1].max() + 2])


@pytest.mark.parametrize("seed", range(6))
def test_medial_axis_keeps_parts_and_holes(seed: int) -> None:
    space = space_of(blobs(seed))
    axis, free = raster(space, medial_axis(space)), raster(space, np.ones(len(space), dtype=bool))
    assert ndimage.label(axis, EIGHT)[1] == ndimage.label(free, EIGHT)[1]
    assert ndimage.label(~axis)[1] == ndimage.label(~free)[1]
    assert ndimage.uniform_filter(axis.astype(float), 3).max() < 1.0


def test_the_axis_of_a_strip_is_its_middle() -> None:
    space = space_of(np.ones((11, 80), dtype=bool))
    axis = space.ij[medial_axis(space)]
    assert_array_equal(np.unique(axis[(axis[:, 1] > 20) & (axis[:, 1] < 60), 0]), [6])


def test_the_axis_does_not_depend_on_what_else_is_in_the_map_nor_on_where_its_grid_begins() -> None:
    shape = blobs(3)
    alone, beside = space_of(shape), space_of(np.hstack([shape, np.zeros((80, 5), dtype=bool), blobs(4)]))
    here = beside.ij[:, 1] <= shape.shape[1]
    assert_array_equal(alone.ij, beside.ij[here])
    assert_array_equal(medial_axis(alone), medial_axis(beside)[here])


def test_a_cross_has_one_node_and_four_arms() -> None:
    cross = np.zeros((61, 61), dtype=bool)
    cross[27:34], cross[:, 27:34] = True, True
    space = space_of(cross)
    graph = skeleton_graph(space)
    degree = np.bincount(graph.edges.ravel(), minlength=len(graph.nodes))
    assert degree.max() == 4
    assert_array_equal(space.ij[graph.nodes[degree.argmax()]], [31, 31])
    for ends, path in zip(graph.edges, graph.paths, strict=True):
        assert_array_equal(path[[0, -1]], graph.nodes[ends])


def assert_paths_walk_from_cell_to_cell(graph: SkeletonGraph, space: FreeSpace) -> None:
    """But for the ends, which lead to the middle of a cluster."""
    for path in graph.paths:
        for one, following in pairwise(path[1:-1]):
            assert following in space.neighbours[one]


def test_every_cell_of_a_line_belongs_to_one_edge() -> None:
    space = space_of(blobs(7))
    graph = skeleton_graph(space)
    inner = np.concatenate([path[1:-1] for path in graph.paths])
    assert len(inner) == len(np.unique(inner))
    assert len(inner) > 0.5 * medial_axis(space).sum()
    assert_paths_walk_from_cell_to_cell(graph, space)


def test_a_ring_without_ends_is_a_loop_at_one_node() -> None:
    i, j = np.indices((60, 60))
    away = np.hypot(i - 30, j - 30)
    graph = skeleton_graph(space_of((away > 18) & (away < 22)))
    assert len(graph.nodes) == 1
    assert graph.edges.tolist() == [[0, 0]]


def test_nothing_free_gives_an_empty_graph() -> None:
    graph = skeleton_graph(space_of(np.zeros((10, 10), dtype=bool)))
    assert (len(graph.nodes), len(graph.edges), graph.paths) == (0, 0, ())


def wound(turns: float, inner: int = 20, outer: int = 32, rise: float = 0.01) -> FreeSpace:
    """A ramp that winds ``turns`` times over itself, climbing ``rise`` [m] a degree."""
    i, j = (index.ravel() - 40 for index in np.indices((81, 81)))
    away, degrees = np.hypot(i, j), np.degrees(np.arctan2(j, i)) % 360.0
    ring = (away > inner) & (away < outer)
    along = degrees[ring, None] + 360.0 * np.arange(int(np.ceil(turns)))
    along, at = np.where(along < 360.0 * turns, along, np.nan), np.stack([i, j], axis=-1)[ring]
    cells = np.column_stack([np.repeat(at, along.shape[1], axis=0), rise * along.ravel()])
    cells = cells[np.isfinite(cells[:, 2])]
    cells = cells[np.lexsort((cells[:, 2], cells[:, 1], cells[:, 0]))]
    known: dict[tuple[float, float], list[int]] = {}
    for row, (a, b, _) in enumerate(cells):
        known.setdefault((a, b), []).append(row)
    neighbours = np.full((len(cells), 8), -1, dtype=np.int32)
    for row, (a, b, z) in enumerate(cells):
        for k in range(8):
            for other in known.get((a + DI[k], b + DJ[k]), []):
                if abs(cells[other, 2] - z) < 0.5:
                    neighbours[row, k] = other
    flat, ij = cells[:, 2].astype(np.float32), cells[:, :2].astype(np.int32)
    return FreeSpace.of_cells(CELL, (0.0, 0.0), ij, flat, np.full(len(ij), 2.5, np.float32), neighbours)


def test_a_spiral_is_one_line_from_end_to_end() -> None:
    space = wound(2.5)
    graph = skeleton_graph(space)
    longest = max(graph.paths, key=len)
    climb = np.abs(np.ptp(space.height[longest]))
    assert climb > 0.9 * 2.5 * 3.6
    middle = np.hypot(*space.ij[longest[15:-15]].T)
    assert np.abs(middle - 26.0).max() < 3.0
