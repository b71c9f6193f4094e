"""Medial axis and its graph: topology kept, lines in the middle, every line found once."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray
from scipy import ndimage

from maps._numba_thinning import thin
from maps.skeleton import medial_axis, skeleton_graph

EIGHT = np.ones((3, 3), dtype=int)


def clearance_of(free: NDArray[np.bool_]) -> NDArray[np.float64]:
    return ndimage.distance_transform_edt(np.pad(free, 2))


def blobs(seed: int) -> NDArray[np.bool_]:
    """Random connected and unconnected shapes with holes."""
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(80, 70)), 3.0)
    return noise > 0.0


def thinned_in_plain_numpy(mask: NDArray[np.bool_], order: NDArray[np.int64]) -> NDArray[np.bool_]:
    """The kernel's rule by counting: a cell goes if its free neighbours hang together and an edge of it is not free."""
    mask = mask.copy()
    for i, j in zip(*np.unravel_index(order, mask.shape), strict=True):
        around = mask[i - 1 : i + 2, j - 1 : j + 2].copy()
        around[1, 1] = False
        by_edge = not (around[0, 1] and around[1, 0] and around[1, 2] and around[2, 1])
        if around.sum() > 1 and by_edge and ndimage.label(around, EIGHT)[1] == 1:
            mask[i, j] = False
    return mask


@pytest.mark.parametrize("seed", range(3))
def test_thinning_agrees_with_plain_numpy(seed: int) -> None:
    mask = np.pad(blobs(seed), 1)
    order = np.random.default_rng(seed).permutation(np.flatnonzero(mask))
    expected = thinned_in_plain_numpy(mask, order)
    thin(mask, order)
    assert_array_equal(mask, expected)


@pytest.mark.parametrize("seed", range(6))
def test_medial_axis_keeps_parts_and_holes(seed: int) -> None:
    clearance = clearance_of(blobs(seed))
    axis = medial_axis(clearance)
    assert not (axis & (clearance == 0.0)).any()
    assert ndimage.label(axis, EIGHT)[1] == ndimage.label(clearance > 0.0, EIGHT)[1]
    assert ndimage.label(~axis)[1] == ndimage.label(clearance == 0.0)[1]
    assert ndimage.uniform_filter(axis.astype(float), 3).max() < 1.0


def test_the_axis_of_a_strip_is_its_middle() -> None:
    strip = np.zeros((21, 80), dtype=bool)
    strip[5:16] = True
    axis = medial_axis(clearance_of(strip))
    assert_array_equal(np.unique(np.nonzero(axis[:, 20:60])[0]), [12])


def test_a_cross_has_one_node_and_four_arms() -> None:
    cross = np.zeros((61, 61), dtype=bool)
    cross[27:34], cross[:, 27:34] = True, True
    graph = skeleton_graph(clearance_of(cross))
    degree = np.bincount(np.array(graph.edges).ravel(), minlength=len(graph.nodes))
    assert degree.max() == 4
    assert_array_equal(graph.nodes[degree.argmax()], [32, 32])
    for (a, b), path in zip(graph.edges, graph.paths, strict=True):
        assert_array_equal(path[[0, -1]], graph.nodes[[a, b]])


def test_every_cell_of_a_line_belongs_to_one_edge() -> None:
    clearance = clearance_of(blobs(7))
    graph = skeleton_graph(clearance)
    inner = [tuple(cell) for path in graph.paths for cell in path[1:-1].tolist()]
    assert len(inner) == len(set(inner))
    assert len(inner) > 0.5 * medial_axis(clearance).sum()


def test_a_ring_without_ends_is_a_loop_at_one_node() -> None:
    i, j = np.indices((60, 60))
    away = np.hypot(i - 30, j - 30)
    graph = skeleton_graph(clearance_of((away > 18) & (away < 22)))
    assert len(graph.nodes) == 1
    assert graph.edges == ((0, 0),)


def test_nothing_free_gives_an_empty_graph() -> None:
    graph = skeleton_graph(np.zeros((10, 10)))
    assert (len(graph.nodes), graph.edges, graph.paths) == (0, (), ())
