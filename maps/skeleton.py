"""The floor thinned to a one-cell-wide skeleton, as a graph: where lines meet or end are nodes, the lines are edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from maps._numba_thinning import thin, trace
from maps.free_space import FreeSpace

_SCATTER = (73856093, 19349663, 2654435761)
"""Large primes that scatter plan positions (Teschner's spatial hash, Knuth's multiplicative hash)."""


@dataclass(frozen=True, slots=True, eq=False)
class SkeletonGraph:
    """Skeleton of the floor.

    nodes : (n,) row of the floor cell of each node: a cluster of cells where lines meet, or a loose end.
    edges : (e, 2) for each line its two nodes.
    paths : for each line the rows (k,) of its cells from the first node to the second, both included.
    """

    nodes: NDArray[np.int64]
    edges: NDArray[np.int64]
    paths: tuple[NDArray[np.int64], ...]


def skeleton_graph(space: FreeSpace) -> SkeletonGraph:
    """Medial axis of the floor as a graph. A loop without any node gets one at its first cell."""
    rows = np.flatnonzero(medial_axis(space))
    links = _links(space.neighbours, rows)
    is_node = (links >= 0).sum(axis=1) != 2
    is_node[_first_without(is_node, _parts(links, np.ones(len(rows), dtype=bool)))] = True
    owner = _parts(links, is_node)
    nodes = rows[_middles(space.ij[rows], owner)]
    edges, stops, cells = trace(links, owner)
    lines = np.split(rows[cells], stops[:-1])
    paths = (np.concatenate([nodes[[a]], line, nodes[[b]]]) for (a, b), line in zip(edges, lines, strict=False))
    return SkeletonGraph(nodes, edges, tuple(paths))


def medial_axis(space: FreeSpace) -> NDArray[np.bool_]:
    """Cells (n,) that are left when the others are taken from the walls inwards, without cutting a line or an end.

    Of cells equally far from the walls those amid most free ones go first, and of these in an order scattered by their
    plan position, so that the lines stay in the middle whatever way the mine is turned and whatever else is in the map.
    """
    amid = (space.neighbours >= 0).sum(axis=1, dtype=np.int8)
    squared = np.rint((space.clearance / space.cell) ** 2).astype(np.int32)
    kept = np.ones(len(space), dtype=bool)
    thin(kept, space.neighbours, np.lexsort((_scattered(space.ij), -amid, squared)))
    return kept


def _scattered(ij: NDArray[np.int32]) -> NDArray[np.uint32]:
    """A number (n,) for each plan position (n, 2) that looks random and depends on nothing else."""
    mixed = ij[:, 0].astype(np.uint32) * np.uint32(_SCATTER[0]) ^ ij[:, 1].astype(np.uint32) * np.uint32(_SCATTER[1])
    return np.asarray((mixed ^ mixed >> np.uint32(15)) * np.uint32(_SCATTER[2]))


def _links(neighbours: NDArray[np.int32], rows: NDArray[np.int64]) -> NDArray[np.int32]:
    """The neighbour table (m, 8) among some rows (m,), renumbered."""
    number = np.full(len(neighbours) + 1, -1, dtype=np.int32)
    number[rows] = np.arange(len(rows), dtype=np.int32)
    return np.asarray(number[np.maximum(neighbours[rows], -1)])


def _parts(links: NDArray[np.int32], chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Number (m,) of the connected part each chosen cell belongs to, by its first cell; -1 of the others."""
    out = np.full(len(links), -1, dtype=np.int64)
    cells = np.flatnonzero(chosen)
    if len(cells):
        among = _links(links, cells)
        at, _ = np.nonzero(among >= 0)
        pairs = csr_array((np.ones(len(at), np.int8), (at, among[among >= 0])), shape=(len(cells), len(cells)))
        out[cells] = connected_components(pairs, directed=False)[1]
    return out


def _first_without(is_node: NDArray[np.bool_], part: NDArray[np.int64]) -> NDArray[np.int64]:
    """First cell of each part that has no node."""
    _, first = np.unique(part, return_index=True)
    with_node = np.zeros(len(first), dtype=bool)
    with_node[part[is_node]] = True
    return np.asarray(first[~with_node])


def _middles(ij: NDArray[np.int32], owner: NDArray[np.int64]) -> NDArray[np.int64]:
    """The member of each cluster of node cells that is nearest to its mean."""
    cells = np.flatnonzero(owner >= 0)
    ij, owner = ij[cells].astype(np.int64), owner[cells]
    size = np.maximum(np.bincount(owner), 1)
    mean = np.stack([np.bincount(owner, ij[:, k]) / size for k in (0, 1)], axis=-1)
    order = np.lexsort((np.sum((ij - mean[owner]) ** 2, axis=1), owner))
    _, first = np.unique(owner[order], return_index=True)
    return np.asarray(cells[order[first]])
