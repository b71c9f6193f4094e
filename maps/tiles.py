"""Points sorted into square tiles, in memory or in files, so that no step of a build needs all of them at once.

Tiles are whole numbers of plan cells wide and anchored at 0 of the map's relative coordinates. No cell is cut, and what
is made of the points of a cell or around a place does not ask for their order: it does not depend on the tiles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from maps.columns import Columns, columns_of
from maps.prior_map import PriorMap
from maps.settings import FreeSpaceSettings
from semmap.geometry import Array

TILE_M = 20.0
"""Side of a tile, unless somebody wants another."""
PART_POINTS = 1_000_000
"""Points that are worth a task of their own."""

_READ_ROWS = 1_000_000
_MARGIN_M = 0.001  # far more than the rounding of coordinates

Cloud32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Tiling:
    """How a map is cut.

    cell : side of a plan cell [m].
    cells : cells along the side of a tile.
    """

    cell: float
    cells: int

    @classmethod
    def of(cls, side: float, cell: float) -> Tiling:
        """Tiles of as near to ``side`` [m] as whole cells come."""
        return cls(cell, max(1, round(side / cell)))

    def cells_of(self, points: NDArray[np.floating]) -> NDArray[np.int64]:
        """Plan cell (n, 2) of each point (n, 2 or 3), as `columns_of` has it."""
        return np.floor(points[:, :2].astype(np.float64) / self.cell).astype(np.int64)

    def tiles_of(self, points: NDArray[np.floating]) -> NDArray[np.int64]:
        """Tile (n, 2) of each point (n, 2 or 3)."""
        return np.asarray(self.cells_of(points) // self.cells)


class Store(Protocol):
    """Where the points of a map lie, in numbered files, and what was made of its parts."""

    def read(self, file: int, start: int, stop: int) -> Cloud32:
        """Rows ``start`` to ``stop`` of a file: points (n, 3)."""

    def kept(self, part: int, make: Callable[[], Columns]) -> Columns:
        """The columns of a part, made now unless they were before."""


@dataclass(frozen=True, slots=True, eq=False)
class PointsInMemory:
    """A `Store` of one file that is an array (n, 3); it keeps nothing else."""

    points: Cloud32

    def read(self, file: int, start: int, stop: int) -> Cloud32:
        return self.points[start:stop]

    def kept(self, part: int, make: Callable[[], Columns]) -> Columns:
        return make()


@dataclass(frozen=True, slots=True, eq=False)
class Tiles:
    """Which rows of which file are in which tile.

    tile : (k, 2), in the order of i and j.
    run : (k, 3) file, first row, row after the last.
    """

    tile: NDArray[np.int64]
    run: NDArray[np.int64]

    @classmethod
    def joined(cls, parts: Iterable[Tiles]) -> Tiles:
        """The tiles of several files, or several parts of one."""
        listed = list(parts)
        tile = np.concatenate([np.zeros((0, 2), np.int64), *(part.tile for part in listed)])
        run = np.concatenate([np.zeros((0, 3), np.int64), *(part.run for part in listed)])
        order = np.lexsort((tile[:, 1], tile[:, 0]))
        return cls(tile[order], run[order])

    def counts(self) -> NDArray[np.int64]:
        """Points (k,) in each run."""
        return np.asarray(self.run[:, 2] - self.run[:, 1])

    def within(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> NDArray[np.int64]:
        """Runs (m, 3) of the tiles from ``low`` (2,) to ``high`` (2,), both included."""
        a, b = np.searchsorted(self.tile[:, 0], [low[0], high[0] + 1])
        j = self.tile[a:b, 1]
        return _in_file_order(self.run[a:b][(j >= low[1]) & (j <= high[1])])


def sorted_into_tiles(points: Cloud32, tiling: Tiling, file: int = 0, row: int = 0) -> tuple[Cloud32, Tiles]:
    """The points (n, 3) tile by tile, and their tiles once they lie in ``file`` from ``row`` on."""
    if not len(points):
        return points, Tiles.joined([])
    tile = tiling.tiles_of(points)
    low = tile.min(axis=0)
    flat = (tile[:, 0] - low[0]) * (np.ptp(tile[:, 1]) + 1) + tile[:, 1] - low[1]
    order = np.argsort(flat.astype(np.min_scalar_type(flat.max())), kind="stable")  # few tiles: short numbers, fast
    begins = np.flatnonzero(np.diff(flat[order], prepend=-1))
    ends = np.append(begins[1:], len(flat))
    run = np.stack([np.full_like(begins, file), row + begins, row + ends], axis=-1)
    return points[order], Tiles(tile[order][begins], run)


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Some plan cells of a map, none of which are in another part, with all their points.

    runs : (m, 3) where the points lie, see `Tiles`.
    strip : first column of cells (i) that counts, and the one after the last; everything where it is None.
    """

    number: int
    store: Store
    tiling: Tiling
    runs: NDArray[np.int64]
    strip: tuple[int, int] | None = None

    def points(self) -> Cloud32:
        """The points (n, 3)."""
        return _joined(self._counting(block) for block in _blocks(self.store, self.runs))

    def columns(self, settings: FreeSpaceSettings) -> Columns:
        """The columns of the cells, kept by the store."""
        return self.store.kept(self.number, lambda: columns_of(self.points(), settings))

    def _counting(self, points: Cloud32) -> Cloud32:
        if self.strip is None:
            return points
        i = self.tiling.cells_of(points)[:, 0]
        return points[(i >= self.strip[0]) & (i < self.strip[1])]


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """The points of a map around a place.

    p : (3,) [m], relative to the origin. radius : in plan [m]. runs : (m, 3) where points lie that may be among them.
    """

    store: Store
    runs: NDArray[np.int64]
    p: Array
    radius: float

    def points(self) -> Cloud32:
        """The points (n, 3) within the radius."""
        return _joined(block[self._is_near(block)] for block in _blocks(self.store, self.runs))

    def _is_near(self, points: Cloud32) -> NDArray[np.bool_]:
        away = points[:, :2] - self.p[:2]
        return np.asarray(np.sum(away**2, axis=1) < self.radius**2)


@dataclass(frozen=True, slots=True, eq=False)
class TiledMap:
    """A prior map by tiles. ``origin``, ``sources`` and ``crs`` as in `PriorMap`."""

    store: Store
    tiling: Tiling
    tiles: Tiles
    origin: Array
    sources: Mapping[str, str] = field(default_factory=dict)
    crs: str | None = None

    @classmethod
    def in_memory(cls, prior: PriorMap, cell: float) -> TiledMap:
        """A prior map that is in memory. cell : side of a plan cell [m]."""
        tiling = Tiling.of(TILE_M, cell)
        points, tiles = sorted_into_tiles(prior.points, tiling)
        return cls(PointsInMemory(points), tiling, tiles, prior.origin, prior.sources, prior.crs)

    def parts(self) -> list[Part]:
        """The map in parts of about a million points: many empty tiles in one, crowded tiles in strips."""
        found: list[Part] = []
        for tiles in _batches(self.tiles):
            runs, strips = _in_file_order(tiles.run), self._strips(tiles)
            found += [Part(len(found) + k, self.store, self.tiling, runs, strip) for k, strip in enumerate(strips)]
        return found

    def around(self, p: Array, radius: float) -> Surroundings:
        """What is within ``radius`` [m] of ``p`` (3,) in plan."""
        reach = np.array([[-1.0], [1.0]]) * (radius + _MARGIN_M)
        low, high = self.tiling.tiles_of(p[None, :2] + reach)
        return Surroundings(self.store, self.tiles.within(low, high), p, radius)

    def _strips(self, tiles: Tiles) -> list[tuple[int, int] | None]:
        """One strip, or as many as a single tile with too many points needs."""
        wanted = min(int(tiles.counts().sum()) // PART_POINTS, self.tiling.cells)
        if wanted < 2 or (tiles.tile != tiles.tile[0]).any():
            return [None]
        first = int(tiles.tile[0, 0]) * self.tiling.cells
        edges = [first + k * self.tiling.cells // wanted for k in range(wanted + 1)]
        return list(pairwise(edges))


def _batches(tiles: Tiles) -> Iterator[Tiles]:
    """Tiles one after another, as many together as have about a million points."""
    begins = np.flatnonzero(np.diff(tiles.tile, axis=0, prepend=np.iinfo(np.int64).min // 2).any(axis=1))
    counts = np.add.reduceat(tiles.counts(), begins) if len(begins) else np.zeros(0, np.int64)
    ends = np.append(begins[1:], len(tiles.tile))
    start, held = 0, 0
    for count, begin, end in zip(counts.tolist(), begins.tolist(), ends.tolist(), strict=False):
        if held and held + count > PART_POINTS:
            yield Tiles(tiles.tile[start:begin], tiles.run[start:begin])
            start, held = begin, 0
        held += count
        if end == len(tiles.tile):
            yield Tiles(tiles.tile[start:], tiles.run[start:])


def _in_file_order(runs: NDArray[np.int64]) -> NDArray[np.int64]:
    """Runs (m, 3) by file and row, those that follow on each other as one."""
    runs = runs[np.lexsort((runs[:, 1], runs[:, 0]))]
    apart = (runs[1:, 0] != runs[:-1, 0]) | (runs[1:, 1] != runs[:-1, 2])
    first = np.flatnonzero(np.r_[True, apart][: len(runs)])
    last = np.append(first[1:], len(runs))[: len(first)] - 1
    return np.column_stack([runs[first, :2], runs[last, 2]])


def _joined(blocks: Iterable[Cloud32]) -> Cloud32:
    return np.concatenate([np.zeros((0, 3), np.float32), *blocks])


def _blocks(store: Store, runs: NDArray[np.int64]) -> Iterator[Cloud32]:
    """The points of some runs, up to a million at a time."""
    for file, start, stop in runs.tolist():
        for row in range(start, stop, _READ_ROWS):
            yield store.read(file, row, min(row + _READ_ROWS, stop))
