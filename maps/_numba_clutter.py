"""Kernel that walks from the floor in under the roof, over what stands there. Caller: `maps.clutter`."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from maps._numba_floor import DI, DJ, first_row


@numba.njit(cache=True, nogil=True)
def _free_over(
    bottom: NDArray[np.float32],
    top: NDArray[np.float32],
    start: int,
    end: int,
    floor: float,
    roof: float,
    step: float,
    clear: float,
    highest: float,
) -> tuple[bool, float, float]:
    """Whether the runs ``start`` to ``end`` leave a column free below the roof, with the top of what is in it and roof.

    The top is that of the highest run above the floor and below the roof, -inf if there is none.
    """
    over, obstacle = np.inf, -np.inf
    if roof < np.inf:
        off = step
        for r in range(start, end):
            if abs(bottom[r] - roof) <= off:
                off, over = abs(bottom[r] - roof), bottom[r]
        if over == np.inf:
            return False, over, obstacle
    for r in range(start, end):
        if bottom[r] < over and top[r] > floor - clear:
            obstacle = max(obstacle, top[r])
    if roof < np.inf:
        return over - obstacle >= clear, over, obstacle
    return clear < obstacle - floor <= highest, over, obstacle


@numba.njit(cache=True, nogil=True)
def _has_floor(ij: NDArray[np.int32], height: NDArray[np.float32], i: int, j: int, z: float, apart: float) -> bool:
    row = first_row(ij, i, j)
    while row < ij.shape[0] and ij[row, 0] == i and ij[row, 1] == j:
        if abs(height[row] - z) < apart:
            return True
        row += 1
    return False


@numba.njit(cache=True, nogil=True)
def walk_under(
    ij: NDArray[np.int32],
    height: NDArray[np.float32],
    headroom: NDArray[np.float32],
    neighbours: NDArray[np.int32],
    apart: float,
    column_ij: NDArray[np.int32],
    first: NDArray[np.int64],
    bottom: NDArray[np.float32],
    top: NDArray[np.float32],
    step: float,
    clear: float,
    highest: float,
    farthest: int,
    floor: NDArray[np.float32],
    roof: NDArray[np.float32],
    obstacle: NDArray[np.float32],
) -> None:
    """Go on from the edges of a surface over columns that are free below the roof, ``farthest`` cells at most.

    Writes for each column walked over (the others stay NaN) the floor below, the roof, and the top of what is there.
    step : the roof may change so much from cell to cell. clear : least free height below the roof. highest : of an
    obstacle under the open sky. apart : floors over each other are at least so far apart.
    """
    floor[:] = np.nan
    n = column_ij.shape[0]
    queue = np.empty(n, np.int64)
    depth = np.zeros(n, np.uint8)
    done, count, row = 0, 0, 0
    while row < ij.shape[0] or done < count:
        if row < ij.shape[0]:
            i, j, z, roof_z, away = ij[row, 0], ij[row, 1], height[row], height[row] + headroom[row], 0
        else:
            c = queue[done]
            done += 1
            i, j, z, roof_z, away = column_ij[c, 0], column_ij[c, 1], floor[c], roof[c], depth[c]
        for k in range(8):
            if away >= farthest or (row < ij.shape[0] and neighbours[row, k] >= 0):
                continue
            q = first_row(column_ij, i + DI[k], j + DJ[k])
            if q == n or column_ij[q, 0] != i + DI[k] or column_ij[q, 1] != j + DJ[k] or not np.isnan(floor[q]):
                continue
            if _has_floor(ij, height, i + DI[k], j + DJ[k], z, apart):
                continue
            is_free, new_roof, highest_run = _free_over(
                bottom, top, first[q], first[q + 1], z, roof_z, step, clear, highest
            )
            if is_free:
                floor[q], roof[q], obstacle[q], depth[q] = z, new_roof, highest_run, away + 1
                queue[count] = q
                count += 1
        if row < ij.shape[0]:
            row += 1


@numba.njit(cache=True, nogil=True)
def count_sides(
    found: NDArray[np.int64],
    labels: NDArray[np.int32],
    floor: NDArray[np.float32],
    obstacle: NDArray[np.float32],
    ij: NDArray[np.int32],
    height: NDArray[np.float32],
    apart: float,
    column_ij: NDArray[np.int32],
    first: NDArray[np.int64],
    bottom: NDArray[np.float32],
    top: NDArray[np.float32],
    band_from: float,
    band_to: float,
    reach: int,
    tally: NDArray[np.int64],
) -> None:
    """Count for each label of the columns ``found`` how many sides end at something, and at nothing: ``tally`` (l, 2).

    Something within ``reach`` cells: floor, a wall, or an obstacle that was walked over (``floor`` is not NaN).
    """
    label_of = np.full(column_ij.shape[0], -1, np.int32)
    for m in range(found.size):
        label_of[found[m]] = labels[m]
    for m in range(found.size):
        c = found[m]
        for k in range(0, 8, 2):
            inside, ends = False, False
            for away in range(1, reach + 1):
                i, j = column_ij[c, 0] + away * DI[k], column_ij[c, 1] + away * DJ[k]
                ends |= _has_floor(ij, height, i, j, floor[c], apart)
                q = first_row(column_ij, i, j)
                if q < column_ij.shape[0] and column_ij[q, 0] == i and column_ij[q, 1] == j:
                    inside |= label_of[q] == labels[m]
                    ends |= abs(floor[q] - floor[c]) < apart and obstacle[q] > -np.inf
                    for r in range(first[q], first[q + 1]):
                        ends |= top[r] > floor[c] + band_from and bottom[r] < floor[c] + band_to
                if inside or ends:
                    break
            if not inside:
                tally[labels[m], 0 if ends else 1] += 1
