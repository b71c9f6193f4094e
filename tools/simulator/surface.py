"""The rock face as a triangle mesh: surface nets over sparse blocks of one common grid.

Every grid node is evaluated once and every cell that the surface crosses gets one vertex, so neighbouring
blocks share their vertices and the mesh is closed wherever the blocks cover the surface.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from semmap.geometry import Array
from tools.simulator.rock import RockField, SweptRoadway

_BLOCK = 16
_MARGIN = 1.5
"""[m] beyond the clear section in which the rough surface may lie."""
_CHUNK = 256

Int = NDArray[np.int64]
_CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1]


def surface_of(
    field: RockField, voxel: float, progress: Callable[[int, int], None] | None = None
) -> tuple[Array, NDArray[np.int32]]:
    """Vertices (n, 3) float64 [m] and triangles (m, 3) int32 of the largest connected rock face.

    Triangles are wound so that their normals point into the roadway. ``progress(done, total)`` counts blocks.
    """
    blocks = _blocks_near(field.roadways, voxel * _BLOCK)
    values = np.empty((len(blocks), _BLOCK, _BLOCK, _BLOCK), np.float32)
    for index, block in enumerate(blocks):
        x, y, z = ((block[axis] * _BLOCK + np.arange(_BLOCK)) * voxel for axis in range(3))
        values[index] = field(x, y, z)
        if progress and index % 50 == 0:
            progress(index, len(blocks))
    grid = _Grid(blocks, values)
    cells, vertices = grid.vertices()
    quads = grid.quads(cells)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return _largest_part(vertices * voxel, triangles)


def _blocks_near(roadways: tuple[SweptRoadway, ...], size: float) -> Int:
    """Integer corners (n, 3), sorted, of the blocks that the walls of any roadway may cross."""
    found: set[tuple[int, int, int]] = set()
    for roadway in roadways:
        side = roadway.width / 2 + _MARGIN
        below, above = np.array([side, side, _MARGIN]), np.array([side, side, roadway.height + _MARGIN])
        for p in _samples(roadway):
            low = np.floor((p - below) / size).astype(int)
            high = np.floor((p + above) / size).astype(int)
            ranges = [range(a, b + 1) for a, b in zip(low.tolist(), high.tolist(), strict=True)]
            found.update((i, j, k) for i in ranges[0] for j in ranges[1] for k in ranges[2])
    return np.array(sorted(found), dtype=np.int64)


def _samples(roadway: SweptRoadway) -> Iterator[Array]:
    """Points on the axis, at most a metre apart."""
    for start, step in zip(roadway.starts, roadway.steps, strict=True):
        count = int(np.ceil(np.linalg.norm(step)))
        yield from (start + step * part for part in np.linspace(0.0, 1.0, count + 1))


class _Grid:
    """Field values in blocks, read with one layer of the neighbours' nodes."""

    def __init__(self, blocks: Int, values: NDArray[np.float32]) -> None:
        self._blocks, self._values = blocks, values
        self._index = {tuple(block): index for index, block in enumerate(blocks.tolist())}
        self._low = blocks.min(axis=0) * _BLOCK - 1
        self._shape = (blocks.max(axis=0) + 1) * _BLOCK - self._low + 1

    def vertices(self) -> tuple[Int, Array]:
        """Sorted keys (n,) of the cells that the surface crosses, and their vertices (n, 3) in cells."""
        parts = [self._chunk_vertices(start) for start in range(0, len(self._blocks), _CHUNK)]
        keys, points = (np.concatenate(column) for column in zip(*parts, strict=True))
        order = np.argsort(keys)
        return keys[order], points[order]

    def quads(self, cells: Int) -> Int:
        """Quadrilaterals (q, 4), indices into ``cells``: one for each grid edge that the surface crosses."""
        parts = [
            self._chunk_quads(start, axis, cells) for start in range(0, len(self._blocks), _CHUNK) for axis in range(3)
        ]
        return np.concatenate(parts)

    def _chunk_vertices(self, start: int) -> tuple[Int, Array]:
        padded = self._padded(start)
        rock = padded > 0.0
        count = np.zeros((len(padded), _BLOCK, _BLOCK, _BLOCK), np.int8)
        for corner in _CORNERS:
            count += _shifted(rock, corner)
        at = np.nonzero((count > 0) & (count < 8))
        corners = np.stack([_shifted(padded, corner)[at] for corner in _CORNERS], axis=1).astype(np.float64)
        cell = self._blocks[start + at[0]] * _BLOCK + np.stack(at[1:], axis=1)
        return self._key(cell), cell + _mean_crossing(corners)

    def _chunk_quads(self, start: int, axis: int, cells: Int) -> Int:
        padded = self._padded(start)
        here, there = (
            _shifted(padded, np.zeros(3, int)) > 0.0,
            _shifted(padded, np.eye(3, dtype=int)[axis]) > 0.0,
        )
        at = np.nonzero(here != there)
        node = self._blocks[start + at[0]] * _BLOCK + np.stack(at[1:], axis=1)
        e1, e2 = np.eye(3, dtype=np.int64)[(axis + 1) % 3], np.eye(3, dtype=np.int64)[(axis + 2) % 3]
        around = np.stack([node - e1 - e2, node - e2, node, node - e1], axis=1)
        quads = np.searchsorted(cells, self._key(around))
        into_rock = there[at]
        quads[into_rock] = quads[into_rock, ::-1]
        return quads

    def _key(self, cell: Int) -> Int:
        """One number (...,) for integer cells (..., 3)."""
        i, j, k = np.moveaxis(cell - self._low, -1, 0)
        return np.asarray((i * self._shape[1] + j) * self._shape[2] + k)

    def _padded(self, start: int) -> NDArray[np.float32]:
        """Values (c, 17, 17, 17) of a chunk of blocks; where there is no neighbour, there is rock."""
        blocks = self._blocks[start : start + _CHUNK]
        padded = np.ones((len(blocks), _BLOCK + 1, _BLOCK + 1, _BLOCK + 1), np.float32)
        for corner in _CORNERS:
            for row, block in enumerate((blocks + corner).tolist()):
                index = self._index.get(tuple(block))
                if index is not None:
                    ours = tuple(slice(_BLOCK, None) if c else slice(0, _BLOCK) for c in corner)
                    theirs = tuple(slice(0, 1) if c else slice(None) for c in corner)
                    padded[(row, *ours)] = self._values[(index, *theirs)]
        return padded


def _shifted(padded: NDArray[Any], corner: Int) -> NDArray[Any]:
    """The (c, 16, 16, 16) part of a padded chunk that starts at ``corner``."""
    i, j, k = corner
    return padded[:, i : i + _BLOCK, j : j + _BLOCK, k : k + _BLOCK]


def _mean_crossing(corners: Array) -> Array:
    """Mean (n, 3) of the points where the surface crosses the unit cell's edges; ``corners`` (n, 8)."""
    total, count = np.zeros((len(corners), 3)), np.zeros((len(corners), 1))
    for a, b in _EDGES:
        crosses = (corners[:, a] > 0.0) != (corners[:, b] > 0.0)
        step = np.where(crosses, corners[:, a] - corners[:, b], 1.0)
        t = np.where(crosses, corners[:, a] / step, 0.0)[:, None]
        total += crosses[:, None] * (_CORNERS[a] + t * (_CORNERS[b] - _CORNERS[a]))
        count += crosses[:, None]
    return total / count


def _largest_part(vertices: Array, triangles: Int) -> tuple[Array, NDArray[np.int32]]:
    """The connected part with the most vertices: noise may have left a stone in the air."""
    a, b = triangles[:, :2].ravel(), triangles[:, 1:].ravel()
    links = coo_array((np.ones(len(a), bool), (a, b)), shape=(len(vertices), len(vertices)))
    label = connected_components(links, directed=False)[1]
    kept = label == np.bincount(label).argmax()
    number = np.cumsum(kept) - 1
    return vertices[kept], number[triangles[kept[triangles[:, 0]]]].astype(np.int32)
