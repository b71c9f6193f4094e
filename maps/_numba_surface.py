"""Kernels on surfaces of square cells that know their neighbours. Callers: `maps.surface`, `maps.clutter`."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from maps._numba_floor import DI, DJ, first_row

NONE = -1


@numba.njit(cache=True, nogil=True)
def _nearest(height: NDArray[np.float32], z: float, start: int, end: int) -> int:
    best = start
    for a in range(start + 1, end):
        if abs(height[a] - z) < abs(height[best] - z):
            best = a
    return best


@numba.njit(cache=True, nogil=True)
def end_of(ij: NDArray[np.int32], a: int) -> int:
    """One past the last row with the plan cell of row ``a``."""
    end = a + 1
    while end < ij.shape[0] and ij[end, 0] == ij[a, 0] and ij[end, 1] == ij[a, 1]:
        end += 1
    return end


@numba.njit(cache=True, nogil=True)
def link_cells(
    ij: NDArray[np.int32], height: NDArray[np.float32], rise: float, step: float, neighbours: NDArray[np.int32]
) -> None:
    """Write to ``neighbours`` (n, 8) the cell next door that is nearest in height, if each is so to the other.

    The rows are sorted by i, j and height. rise, step : the highest step is ``rise`` per cell of distance and ``step``.
    """
    n = ij.shape[0]
    neighbours[:] = NONE
    ahead = np.zeros(4, np.int64)
    start = 0
    while start < n:
        end = end_of(ij, start)
        for side in range(4):
            k = (0, 5, 6, 7)[side]
            i, j = ij[start, 0] + DI[k], ij[start, 1] + DJ[k]
            q = ahead[side]
            while q < n and (ij[q, 0] < i or (ij[q, 0] == i and ij[q, 1] < j)):
                q += 1
            ahead[side] = q
            if q == n or ij[q, 0] != i or ij[q, 1] != j:
                continue
            q_end = end_of(ij, q)
            limit = rise * np.hypot(DI[k], DJ[k]) + step
            for a in range(start, end):
                b = _nearest(height, height[a], q, q_end)
                if _nearest(height, height[b], start, end) == a and abs(height[a] - height[b]) <= limit:
                    neighbours[a, k], neighbours[b, (k + 4) % 8] = b, a
        start = end


@numba.njit(cache=True, nogil=True)
def lower_envelope(
    neighbours: NDArray[np.int32], height: NDArray[np.float32], rise: float, envelope: NDArray[np.float32]
) -> None:
    """Highest surface below ``height`` that rises by at most ``rise`` per cell of distance."""
    n = height.size
    envelope[:] = height
    changed = True
    while changed:
        changed = False
        for sweep in range(2):
            for m in range(n):
                row = m if sweep == 0 else n - 1 - m
                for k in range(8):
                    other = neighbours[row, k]
                    if other >= 0:
                        limit = envelope[other] + np.float32(rise * np.hypot(DI[k], DJ[k]))
                        if limit < envelope[row]:
                            envelope[row] = limit
                            changed = True


@numba.njit(cache=True, nogil=True)
def median_around(neighbours: NDArray[np.int32], values: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """Median of each cell and its neighbours, the lower one of two."""
    near = np.empty(9, np.float32)
    for row in range(values.size):
        near[0], count = values[row], 1
        for k in range(8):
            other = neighbours[row, k]
            if other >= 0:
                near[count] = values[other]
                count += 1
        out[row] = np.sort(near[:count])[(count - 1) // 2]


@numba.njit(cache=True, nogil=True)
def spread(
    neighbours: NDArray[np.int32], values: NDArray[np.float32], weights: NDArray[np.float32], out: NDArray[np.float32]
) -> None:
    """Mean of each cell and its neighbours, weighted."""
    for row in range(values.size):
        weight, total = weights[row], weights[row] * values[row]
        for k in range(8):
            other = neighbours[row, k]
            if other >= 0:
                weight += weights[other]
                total += weights[other] * values[other]
        out[row] = total / weight if weight > 0.0 else values[row]


@numba.njit(cache=True, nogil=True)
def ease(neighbours: NDArray[np.int32], rows: NDArray[np.int64], times: int, values: NDArray[np.float32]) -> None:
    """Draw the values of some cells to the mean of those around, again and again, the others being fixed."""
    for _ in range(times):
        for row in rows:
            total, count = np.float32(0.0), 0
            for k in range(8):
                other = neighbours[row, k]
                if other >= 0:
                    total += values[other]
                    count += 1
            if count > 0:
                values[row] = total / np.float32(count)


@numba.njit(cache=True, nogil=True)
def propose(
    ij: NDArray[np.int32],
    height: NDArray[np.float32],
    neighbours: NDArray[np.int32],
    apart: float,
    may: NDArray[np.bool_],
    write: bool,
    at: NDArray[np.int32],
    source: NDArray[np.int32],
) -> int:
    """Number of places beside the surface where it could go on: none there nearer in height than ``apart``.

    may : (n,) bool, cells to go on from. If ``write`` says so, plan cell and the cell it goes on from are filled in.
    """
    count = 0
    for row in range(ij.shape[0]):
        if not may[row]:
            continue
        for k in range(8):
            if neighbours[row, k] >= 0:
                continue
            i, j = ij[row, 0] + DI[k], ij[row, 1] + DJ[k]
            other = first_row(ij, i, j)
            taken = False
            while other < ij.shape[0] and ij[other, 0] == i and ij[other, 1] == j:
                taken |= abs(height[other] - height[row]) < apart
                other += 1
            if taken:
                continue
            if write:
                at[count, 0], at[count, 1], source[count] = i, j, row
            count += 1
    return count


@numba.njit(cache=True, nogil=True)
def in_large_piece(neighbours: NDArray[np.int32], least: int, large: NDArray[np.bool_]) -> None:
    """Whether each cell is in a connected piece of at least so many cells."""
    n = neighbours.shape[0]
    large[:] = False
    seen = np.zeros(n, np.bool_)
    queue = np.empty(n, np.int32)
    for start in range(n):
        if seen[start]:
            continue
        seen[start] = True
        queue[0] = start
        done, count = 0, 1
        while done < count:
            for other in neighbours[queue[done]]:
                if other >= 0 and not seen[other]:
                    seen[other] = True
                    queue[count] = other
                    count += 1
            done += 1
        for m in range(count):
            large[queue[m]] = count >= least
