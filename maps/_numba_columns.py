"""Kernels that turn sorted points into columns of occupied heights. Callers: `maps.columns`."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True, nogil=True)
def pack(
    points: NDArray[np.floating],
    cell: float,
    step: float,
    low: NDArray[np.int64],
    size: NDArray[np.int64],
    keys: NDArray[np.int64],
) -> None:
    """Write to ``keys`` (n,) plan cell and height of each point as one number that sorts by i, j and height.

    low, size : (3,) of i, j and the height in steps, the lowest and how many there are.
    """
    for k in range(len(keys)):
        i = np.int64(np.floor(np.float64(points[k, 0]) / cell)) - low[0]
        j = np.int64(np.floor(np.float64(points[k, 1]) / cell)) - low[1]
        z = np.int64(np.rint(np.float64(points[k, 2]) / step)) - low[2]
        keys[k] = (i * size[1] + j) * size[2] + z


@numba.njit(cache=True, nogil=True)
def count_runs(keys: NDArray[np.int64], levels: int, gap: int) -> tuple[int, int]:
    """Number of plan cells, and of runs, in sorted keys; heights more than ``gap`` apart are different runs."""
    cells, runs = 0, 0
    for k in range(keys.size):
        new_cell = k == 0 or keys[k] // levels != keys[k - 1] // levels
        cells += new_cell
        runs += new_cell or keys[k] - keys[k - 1] > gap
    return cells, runs


@numba.njit(cache=True, nogil=True)
def write_runs(
    keys: NDArray[np.int64],
    levels: int,
    gap: int,
    flat: NDArray[np.int64],
    first: NDArray[np.int64],
    bottom: NDArray[np.int64],
    top: NDArray[np.int64],
    total: NDArray[np.int64],
    count: NDArray[np.int32],
) -> None:
    """Fill in cells (c,) and the runs (r,) they begin with, in steps; ``total`` is the sum of the heights of a run."""
    cell, run = -1, -1
    for k in range(keys.size):
        number, z = keys[k] // levels, keys[k] % levels
        new_cell = cell < 0 or number != flat[cell]
        if new_cell or z - top[run] > gap:
            run += 1
            bottom[run], total[run], count[run] = z, 0, 0
        if new_cell:
            cell += 1
            flat[cell], first[cell] = number, run
        top[run] = z
        total[run] += z
        count[run] += 1
    first[cell + 1] = run + 1


@numba.njit(cache=True, nogil=True)
def merge_columns(
    ij: NDArray[np.int32],
    first: NDArray[np.int64],
    bottom: NDArray[np.float32],
    top: NDArray[np.float32],
    mean: NDArray[np.float32],
    count: NDArray[np.int32],
    factor: int,
    gap: float,
    write: bool,
    new_ij: NDArray[np.int32],
    new_first: NDArray[np.int64],
    new_bottom: NDArray[np.float32],
    new_top: NDArray[np.float32],
    new_mean: NDArray[np.float32],
    new_count: NDArray[np.int32],
) -> tuple[int, int]:
    """Merge the columns of each ``factor`` by ``factor`` plan cells, and return how many columns and runs there are.

    The new arrays are only filled in if ``write`` says so.
    """
    n = ij.shape[0]
    at = np.empty(factor + 1, np.int64)  # where the next column of each fine row is, and where the last row ends
    ends = np.empty(factor, np.int64)
    members = np.empty(1024, np.int64)
    cells, runs, start = 0, 0, 0
    while start < n:
        coarse_i = ij[start, 0] // factor
        rows, stop = 0, start
        while stop < n and ij[stop, 0] // factor == coarse_i:
            if stop == start or ij[stop, 0] != ij[stop - 1, 0]:
                at[rows] = stop
                rows += 1
            stop += 1
        at[rows] = stop
        for row in range(rows):
            ends[row] = at[row + 1]
        while True:
            coarse_j = np.int64(2**62)
            for row in range(rows):
                if at[row] < ends[row]:
                    coarse_j = min(coarse_j, ij[at[row], 1] // factor)
            if coarse_j == 2**62:
                break
            total = 0
            for row in range(rows):
                while at[row] < ends[row] and ij[at[row], 1] // factor == coarse_j:
                    for r in range(first[at[row]], first[at[row] + 1]):
                        if total == members.size:
                            members = np.concatenate((members, members))
                        k = total
                        while k > 0 and bottom[members[k - 1]] > bottom[r]:
                            members[k] = members[k - 1]
                            k -= 1
                        members[k] = r
                        total += 1
                    at[row] += 1
            if write:
                new_ij[cells, 0], new_ij[cells, 1] = coarse_i, coarse_j
                new_first[cells] = runs
            highest = np.float32(-np.inf)
            for k in range(total):
                r = members[k]
                begins = bottom[r] - highest > gap
                highest = max(highest, top[r])
                runs += begins
                if not write:
                    continue
                if begins:
                    new_bottom[runs - 1], new_mean[runs - 1], new_count[runs - 1] = bottom[r], mean[r], count[r]
                else:
                    new_count[runs - 1] += count[r]
                    new_mean[runs - 1] += (mean[r] - new_mean[runs - 1]) * count[r] / new_count[runs - 1]
                new_top[runs - 1] = highest
            cells += 1
        start = stop
    if write:
        new_first[cells] = runs
    return cells, runs
