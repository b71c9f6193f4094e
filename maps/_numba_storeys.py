"""Kernels that find floors in columns: gaps with head-room, sheets of them, and what bounds a sheet.

Callers: `maps.storeys`.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from maps._numba_floor import DI, DJ, first_row

REACH = 2
"""Gaps of columns at most so many cells apart are linked: thinly sampled floor has holes."""


@numba.njit(cache=True, nogil=True)
def count_gaps(
    first: NDArray[np.int64], bottom: NDArray[np.float32], top: NDArray[np.float32], least: float
) -> NDArray[np.int64]:
    """(c + 1,) where the gaps of each column begin: those over a run with ``least`` free height above it."""
    begins = np.zeros(first.size, np.int64)
    for c in range(first.size - 1):
        gaps = 0
        for r in range(first[c], first[c + 1]):
            gaps += r + 1 == first[c + 1] or bottom[r + 1] - top[r] >= least
        begins[c + 1] = begins[c] + gaps
    return begins


@numba.njit(cache=True, nogil=True)
def write_gaps(
    first: NDArray[np.int64],
    bottom: NDArray[np.float32],
    top: NDArray[np.float32],
    mean: NDArray[np.float32],
    least: float,
    thin: float,
    height: NDArray[np.float32],
    headroom: NDArray[np.float32],
) -> None:
    """Floor height of each gap and free height over it, infinite under the sky.

    The surface of a run is its mean if it is thin, else ``thin`` below its top or above its bottom.
    """
    gap = 0
    for c in range(first.size - 1):
        for r in range(first[c], first[c + 1]):
            last = r + 1 == first[c + 1]
            if last or bottom[r + 1] - top[r] >= least:
                height[gap] = max(mean[r], top[r] - thin)
                headroom[gap] = np.inf if last else min(mean[r + 1], bottom[r + 1] + thin) - height[gap]
                gap += 1


@numba.njit(cache=True, nogil=True)
def _column(ij: NDArray[np.int32], i: int, j: int) -> int:
    c = first_row(ij, i, j)
    return c if c < ij.shape[0] and ij[c, 0] == i and ij[c, 1] == j else -1


@numba.njit(cache=True, nogil=True)
def _root(parent: NDArray[np.int64], a: int) -> int:
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    return a


@numba.njit(cache=True, nogil=True)
def _fits(
    a: int, b: int, height: NDArray[np.float32], headroom: NDArray[np.float32], step: float, common: float
) -> bool:
    """Whether one can go from gap to gap: a small enough step, and enough free height that is common to both."""
    low, high = max(height[a], height[b]), min(height[a] + headroom[a], height[b] + headroom[b])
    return bool(abs(height[a] - height[b]) <= step and high - low >= common)


@numba.njit(cache=True, nogil=True)
def count_support(
    ij: NDArray[np.int32],
    begins: NDArray[np.int64],
    height: NDArray[np.float32],
    headroom: NDArray[np.float32],
    rise: float,
    step: float,
    common: float,
    support: NDArray[np.int8],
) -> None:
    """Write to ``support`` (g,) in how many of the eight columns around each gap goes on.

    rise : of the steepest floor per cell. step : what may be added to it. common : free height two gaps must share.
    """
    n = ij.shape[0]
    support[:] = 0
    ahead = np.zeros(4, np.int64)
    for c in range(n):
        for side in range(4):
            i, j = ij[c, 0] + (0, 1, 1, 1)[side], ij[c, 1] + (1, -1, 0, 1)[side]
            q = ahead[side]
            while q < n and (ij[q, 0] < i or (ij[q, 0] == i and ij[q, 1] < j)):
                q += 1
            ahead[side] = q
            if q == n or ij[q, 0] != i or ij[q, 1] != j:
                continue
            limit = step + rise * (1.0 if side in (0, 2) else np.sqrt(2.0))
            for a in range(begins[c], begins[c + 1]):
                for b in range(begins[q], begins[q + 1]):
                    if _fits(a, b, height, headroom, limit, common):
                        support[a] += 1
                        break
            for b in range(begins[q], begins[q + 1]):
                for a in range(begins[c], begins[c + 1]):
                    if _fits(a, b, height, headroom, limit, common):
                        support[b] += 1
                        break


@numba.njit(cache=True, nogil=True)
def _no_column_between(ij: NDArray[np.int32], i: int, j: int, di: int, dj: int) -> bool:
    """Whether (i, j) and the cell (di, dj) on, two at most, are neighbours or have a hole between them.

    Over what has points one goes from neighbour to neighbour: a leap could climb a box and then the wall beside it.
    """
    if max(abs(di), abs(dj)) < 2:
        return True
    for a in range(di // 2, (di + 1) // 2 + 1):
        for b in range(dj // 2, (dj + 1) // 2 + 1):
            if max(abs(a), abs(b)) == 1 and _column(ij, i + a, j + b) < 0:
                return True
    return False


@numba.njit(cache=True, nogil=True)
def link_gaps(
    ij: NDArray[np.int32],
    begins: NDArray[np.int64],
    height: NDArray[np.float32],
    headroom: NDArray[np.float32],
    support: NDArray[np.int8],
    least: int,
    rise: float,
    step: float,
    common: float,
    sheet: NDArray[np.int64],
) -> None:
    """Write to ``sheet`` (g,) the first gap of the sheet each gap is in.

    A gap with less support than ``least`` is at the border of a sheet and joins no sheets: else they would climb from
    the floor to the roof over the tops of what points of a wall are in one column.
    """
    n = ij.shape[0]
    sheet[:] = np.arange(sheet.size)
    nearest = np.full(sheet.size, np.float32(np.inf))
    border = np.full(sheet.size, np.int64(-1))
    ahead = np.zeros(REACH + 1, np.int64)
    for c in range(n):
        i, j = ij[c, 0], ij[c, 1]
        for di in range(REACH + 1):
            q = ahead[di]
            while q < n and (ij[q, 0] < i + di or (ij[q, 0] == i + di and ij[q, 1] < j - REACH)):
                q += 1
            ahead[di] = q
            while q < n and ij[q, 0] == i + di and ij[q, 1] <= j + REACH:
                if q > c and _no_column_between(ij, i, j, di, ij[q, 1] - j):
                    limit = rise * np.hypot(di, ij[q, 1] - j) + step
                    for a in range(begins[c], begins[c + 1]):
                        for b in range(begins[q], begins[q + 1]):
                            if not _fits(a, b, height, headroom, limit, common):
                                continue
                            off = abs(height[a] - height[b])
                            if support[a] >= least and support[b] >= least:
                                ra, rb = _root(sheet, a), _root(sheet, b)
                                sheet[max(ra, rb)] = min(ra, rb)
                            elif support[a] >= least and off < nearest[b]:
                                nearest[b], border[b] = off, a
                            elif support[b] >= least and off < nearest[a]:
                                nearest[a], border[a] = off, b
                q += 1
    for a in range(sheet.size):
        sheet[a] = _root(sheet, a if border[a] < 0 else border[a])


@numba.njit(cache=True, nogil=True)
def link_narrow_gaps(
    ij: NDArray[np.int32],
    begins: NDArray[np.int64],
    height: NDArray[np.float32],
    headroom: NDArray[np.float32],
    support: NDArray[np.int8],
    least: int,
    rise: float,
    step: float,
    common: float,
    farthest: int,
    sheet: NDArray[np.int64],
) -> None:
    """Let the border of each sheet go on over gaps of little support, ``farthest`` cells at most: past machines."""
    column = np.repeat(np.arange(ij.shape[0], dtype=np.int32), np.diff(begins))
    depth = np.zeros(sheet.size, np.uint8)
    queue = np.empty(sheet.size, np.int64)
    done, count = 0, 0
    for a in range(sheet.size):
        if support[a] < least and support[sheet[a]] >= least:
            queue[count] = a
            count += 1
    while done < count:
        a = queue[done]
        done += 1
        if depth[a] == farthest:
            continue
        for k in range(8):
            q = _column(ij, ij[column[a], 0] + DI[k], ij[column[a], 1] + DJ[k])
            if q < 0:
                continue
            limit = rise * np.hypot(DI[k], DJ[k]) + step
            for b in range(begins[q], begins[q + 1]):
                loose = support[b] < least and support[sheet[b]] < least
                if loose and _fits(a, b, height, headroom, limit, common):
                    sheet[b], depth[b] = sheet[a], depth[a] + 1
                    queue[count] = b
                    count += 1


@numba.njit(cache=True, nogil=True)
def bounds_of_sheets(
    ij: NDArray[np.int32],
    first: NDArray[np.int64],
    bottom: NDArray[np.float32],
    top: NDArray[np.float32],
    begins: NDArray[np.int64],
    height: NDArray[np.float32],
    headroom: NDArray[np.float32],
    sheet: NDArray[np.int64],
    rise: float,
    step: float,
    common: float,
    reach: int,
    band: NDArray[np.float64],
    deepest: float,
    tally: NDArray[np.int32],
) -> None:
    """Count for each sheet how its sides go on, into ``tally`` (g, 2, 3): up a wall, down to a floor, nowhere.

    Those of gaps under the open sky come first, those below a roof after them. From each gap one looks in four
    directions as far as ``reach`` cells: where the sheet goes on behind a hole it has no border. A wall has points in
    the lower and in the upper half of ``band`` (2,) above the floor, as far as the roof is higher; a floor below is at
    most ``deepest`` down.
    """
    for c in range(ij.shape[0]):
        for a in range(begins[c], begins[c + 1]):
            end = min(band[1], headroom[a] - band[0])
            middle = 0.5 * (band[0] + end)
            for k in range(4):
                di, dj = (1, 0, -1, 0)[k], (0, 1, 0, -1)[k]
                low, high, below, on = False, False, False, False
                for away in range(1, reach + 1):
                    q = _column(ij, ij[c, 0] + away * di, ij[c, 1] + away * dj)
                    if q < 0:
                        continue
                    for b in range(begins[q], begins[q + 1]):
                        on |= _fits(a, b, height, headroom, rise * away + step, common)
                        drop = height[a] - height[b]
                        below |= away <= 3 and 0.0 < drop <= deepest and headroom[b] >= drop + common
                    for r in range(first[q], first[q + 1]):
                        low |= top[r] > height[a] + band[0] and bottom[r] < height[a] + middle
                        high |= top[r] > height[a] + middle and bottom[r] < height[a] + end
                    if on or below or (low and high):
                        break
                if on:
                    continue
                tally[sheet[a], int(headroom[a] < np.inf), 1 if below else 0 if low and high else 2] += 1
