"""Columns: which heights are occupied over each plan cell of a map.

They hold what floor, roof and walls are told from, in memory that goes with the surface of the mine and not with the
number of points. The column of a cell is a function of the points in that cell alone, in any order, and the cells lie
on a grid that is anchored at 0: a map may be cut into tiles at cell borders in any way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maps._numba_columns import count_runs, merge_columns, pack, write_runs
from maps.grid import Points
from maps.settings import FreeSpaceSettings
from semmap.errors import CloudError

RUN_GAP_M = 0.3
"""Points of a column that are nearer to each other in height are one run."""
_STEP_M = 1.0 / 1024.0
"""Heights are kept as whole numbers of such steps until they have been summed: sums do not depend on the order."""


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Occupied heights by plan cell.

    cell : side of a cell [m]; cell (i, j) covers x from ``i cell`` and y from ``j cell``.
    ij : (c, 2) int32, the cells with points, sorted by i, then j.
    first : (c + 1,) int64; the runs of cell ``k`` are rows ``first[k]`` to ``first[k + 1]`` of the others, upwards.
    bottom, top, mean : (r,) float32, lowest, highest and mean height of each run [m].
    count : (r,) int32, points in it.
    """

    cell: float
    ij: NDArray[np.int32]
    first: NDArray[np.int64]
    bottom: NDArray[np.float32]
    top: NDArray[np.float32]
    mean: NDArray[np.float32]
    count: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.ij)

    @classmethod
    def joined(cls, parts: Sequence[Columns]) -> Columns:
        """The columns of several parts of a map as one. No cell may have points in two parts.

        Raises `ValueError` where one has, or the parts have cells of different sizes.
        """
        if len({part.cell for part in parts}) != 1:
            raise ValueError("columns to join need cells of one size")
        ij = np.concatenate([part.ij for part in parts])
        order = np.lexsort((ij[:, 1], ij[:, 0]))
        ij = ij[order]
        if len(ij) > 1 and (np.diff(ij, axis=0) == 0).all(axis=1).any():
            raise ValueError("columns to join share a cell")
        runs = np.concatenate([np.diff(part.first) for part in parts])
        begins = np.cumsum(runs) - runs
        first = np.concatenate([[0], np.cumsum(runs[order])])
        # where each run comes from: its place within the column, after the column's old beginning
        source = np.repeat(begins[order] - first[:-1], runs[order]) + np.arange(first[-1])
        return cls(
            parts[0].cell,
            ij,
            first,
            np.concatenate([part.bottom for part in parts])[source],
            np.concatenate([part.top for part in parts])[source],
            np.concatenate([part.mean for part in parts])[source],
            np.concatenate([part.count for part in parts])[source],
        )

    def coarser(self, factor: int) -> Columns:
        """The columns of cells ``factor`` times as wide."""
        old = (self.ij, self.first, self.bottom, self.top, self.mean, self.count, factor, RUN_GAP_M)
        cells, runs = merge_columns(*old, False, *_empty(0, 0))
        new = _empty(cells, runs)
        merge_columns(*old, True, *new)
        return Columns(self.cell * factor, *new)


def columns_of(points: Points, settings: FreeSpaceSettings) -> Columns:
    """Columns of a cloud (n, 3), z up. Raises `CloudError` where it stretches too far to be one tile of a mine."""
    if not len(points):
        return Columns(settings.cell, *_empty(0, 0))
    scale = np.array([settings.cell, settings.cell, _STEP_M])
    low, high = (np.rint(extreme(points, axis=0) / scale).astype(np.int64) for extreme in (np.min, np.max))
    low, size = low - 1, high - low + 3
    if np.log2(size.astype(np.float64)).sum() >= 62.0:
        raise CloudError("stretches too far", mend="remove stray points")
    keys = np.empty(len(points), np.int64)
    pack(points, settings.cell, _STEP_M, low, size, keys)
    keys.sort()
    gap = round(RUN_GAP_M / _STEP_M)
    cells, runs = count_runs(keys, size[2], gap)
    flat, first = np.empty(cells, np.int64), np.empty(cells + 1, np.int64)
    bottom, top, total = np.empty((3, runs), np.int64)
    count = np.empty(runs, np.int32)
    write_runs(keys, size[2], gap, flat, first, bottom, top, total, count)
    ij = np.stack([flat // size[1] + low[0], flat % size[1] + low[1]], axis=-1).astype(np.int32)
    return Columns(
        settings.cell,
        ij,
        first,
        _metres(bottom + low[2]),
        _metres(top + low[2]),
        _metres(total / count + low[2]),
        count,
    )


def _metres(steps: NDArray[np.number]) -> NDArray[np.float32]:
    return np.asarray(steps * _STEP_M, np.float32)


def _empty(
    cells: int, runs: int
) -> tuple[
    NDArray[np.int32],
    NDArray[np.int64],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.int32],
]:
    """Arrays for so many cells and runs: ij, first, bottom, top, mean, count."""
    bottom, top, mean = (np.empty(runs, np.float32) for _ in range(3))
    return np.empty((cells, 2), np.int32), np.zeros(cells + 1, np.int64), bottom, top, mean, np.empty(runs, np.int32)
