"""A one-cell-wide skeleton as a graph: pixels where lines meet or end are nodes, the lines between them edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from maps._numba_thinning import thin
from semmap.geometry import Array

_EIGHT = np.ones((3, 3), dtype=np.int8)
_SCATTER = 2654435761  # Knuth's multiplicative hash


@dataclass(frozen=True, slots=True)
class PixelGraph:
    """Skeleton of a raster.

    nodes : (n, 2) cells, one for each cluster of pixels where lines meet, and one for each loose end.
    edges : for each line its two nodes.
    paths : for each line its cells (k, 2) from the first node to the second, both included.
    """

    nodes: NDArray[np.int64]
    edges: tuple[tuple[int, int], ...]
    paths: tuple[NDArray[np.int64], ...]


def skeleton_graph(clearance: Array) -> PixelGraph:
    """Medial axis of the cells with some clearance as a graph. A loop without any node gets one at its first cell.

    clearance : (nx, ny) distance of each free cell to the nearest one that is not, 0 in those.
    """
    skeleton = medial_axis(np.pad(clearance, 1))
    neighbours = ndimage.convolve(skeleton.astype(np.int8), _EIGHT, mode="constant") - 1
    is_node = skeleton & (neighbours != 2)
    is_node[_first_cells(skeleton & ~_reached(skeleton, is_node))] = True
    labels, count = ndimage.label(is_node, _EIGHT)
    nodes = _cluster_cells(labels, count)
    edges, paths = _traced(skeleton, labels)
    paths = [np.vstack([nodes[a], path, nodes[b]]) - 1 for (a, b), path in zip(edges, paths, strict=True)]
    return PixelGraph(nodes - 1, tuple(edges), tuple(paths))


def medial_axis(clearance: Array) -> NDArray[np.bool_]:
    """Cells that are left when the others are taken from the walls inwards, without cutting a line or an end.

    Of cells equally far from the walls those amid most free ones go first, and of these in a scattered order, so that
    the lines stay in the middle whatever way the raster is turned. ``clearance`` is 0 along its border.
    """
    mask = clearance > 0.0
    cells = np.flatnonzero(mask)
    neighbours = ndimage.convolve(mask.astype(np.int8), _EIGHT, mode="constant").ravel()[cells]
    scatter = (cells.astype(np.uint64) * np.uint64(_SCATTER)) & np.uint64(0xFFFFFFFF)
    thin(mask, cells[np.lexsort((scatter, -neighbours, clearance.ravel()[cells]))])
    return mask


def _reached(skeleton: NDArray[np.bool_], seeds: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The parts of the skeleton that are connected to a seed."""
    labels, count = ndimage.label(skeleton, _EIGHT)
    with_seed = np.zeros(count + 1, dtype=bool)
    with_seed[labels[seeds]] = True
    with_seed[0] = False
    return np.asarray(with_seed[labels])


def _first_cells(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """One cell of each connected part."""
    labels, _ = ndimage.label(mask, _EIGHT)
    _, first = np.unique(labels, return_index=True)
    first = first[labels.ravel()[first] > 0]
    rows, columns = np.unravel_index(first, mask.shape)
    return rows, columns


def _cluster_cells(labels: NDArray[np.int32], count: int) -> NDArray[np.int64]:
    """The member of each cluster of node pixels that is nearest to its mean."""
    cells = np.argwhere(labels)
    owner = labels[tuple(cells.T)] - 1
    size = np.maximum(np.bincount(owner, minlength=count), 1)
    mean = np.stack([np.bincount(owner, cells[:, k], minlength=count) / size for k in (0, 1)], axis=-1)
    off = np.sum((cells - mean[owner]) ** 2, axis=1)
    order = np.lexsort((off, owner))
    _, first = np.unique(owner[order], return_index=True)
    return cells[order[first]]


def _traced(
    skeleton: NDArray[np.bool_], labels: NDArray[np.int32]
) -> tuple[list[tuple[int, int]], list[NDArray[np.int64]]]:
    """Follow every line from a node pixel to the next one."""
    width = skeleton.shape[1]
    steps = [di * width + dj for di in (-1, 0, 1) for dj in (-1, 0, 1) if di or dj]
    lit = set(np.flatnonzero(skeleton).tolist())
    node_of = dict(zip(np.flatnonzero(labels).tolist(), (labels[labels > 0] - 1).tolist(), strict=True))
    edges: list[tuple[int, int]] = []
    paths: list[NDArray[np.int64]] = []
    done: set[int] = set()
    for pixel, start in node_of.items():
        for first in (pixel + step for step in steps):
            if first not in lit or first in node_of or first in done:
                continue
            path, end = _followed(pixel, first, steps, lit, node_of)
            done.update((path[0], path[-1]))
            edges.append((start, node_of[end]))
            paths.append(np.stack(np.unravel_index(path, skeleton.shape), axis=-1))
    return edges, paths


def _followed(
    pixel: int, first: int, steps: list[int], lit: set[int], node_of: dict[int, int]
) -> tuple[list[int], int]:
    """The line that leaves node ``pixel`` by ``first``, and the node pixel it arrives at.

    A pixel on a line has two lit neighbours: the one it was reached from, and the next.
    """
    path, before = [first], pixel
    while True:
        here = path[-1]
        ahead = next(here + step for step in steps if here + step in lit and here + step != before)
        if ahead in node_of:
            return path, ahead
        path.append(ahead)
        before = here
