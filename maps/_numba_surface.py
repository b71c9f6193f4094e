"""Kernels on surfaces of square cells that know their neighbours. Callers: `maps.surface`, `.clutter`, `.free_cells`.

A cell may be parted into ``parts`` by ``parts`` small ones, numbered cell by cell.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from maps._numba_floor import DI, DJ, UNKNOWN, WALL, first_row

_DIRECTION = np.array([[3, 2, 1], [4, -1, 0], [5, 6, 7]])
NONE = -1


@numba.njit(cache=True)
def _nearest(height: NDArray[np.float32], z: float, start: int, end: int) -> int:
    best = start
    for a in range(start + 1, end):
        if abs(height[a] - z) < abs(height[best] - z):
            best = a
    return best


@numba.njit(cache=True)
def _end(ij: NDArray[np.int32], a: int) -> int:
    """One past the last row with the plan cell of row ``a``."""
    end = a + 1
    while end < ij.shape[0] and ij[end, 0] == ij[a, 0] and ij[end, 1] == ij[a, 1]:
        end += 1
    return end


@numba.njit(cache=True)
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
        end = _end(ij, start)
        for side in range(4):
            k = (0, 5, 6, 7)[side]
            i, j = ij[start, 0] + DI[k], ij[start, 1] + DJ[k]
            q = ahead[side]
            while q < n and (ij[q, 0] < i or (ij[q, 0] == i and ij[q, 1] < j)):
                q += 1
            ahead[side] = q
            if q == n or ij[q, 0] != i or ij[q, 1] != j:
                continue
            q_end = _end(ij, q)
            limit = rise * np.hypot(DI[k], DJ[k]) + step
            for a in range(start, end):
                b = _nearest(height, height[a], q, q_end)
                if _nearest(height, height[b], start, end) == a and abs(height[a] - height[b]) <= limit:
                    neighbours[a, k], neighbours[b, (k + 4) % 8] = b, a
        start = end


@numba.njit(cache=True)
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


@numba.njit(cache=True)
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


@numba.njit(cache=True)
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


@numba.njit(cache=True)
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


@numba.njit(cache=True)
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


@numba.njit(cache=True)
def next_part(neighbours: NDArray[np.int32], parts: int, row: int, k: int) -> int:
    """Number of the small cell next to small cell ``row`` in direction ``k``, or NONE."""
    cell, part = row // (parts * parts), row % (parts * parts)
    a, b = part // parts + DI[k], part % parts + DJ[k]
    ca, cb = (a + parts) // parts - 1, (b + parts) // parts - 1
    if ca != 0 or cb != 0:
        cell = neighbours[cell, _DIRECTION[ca + 1, cb + 1]]
        if cell < 0:
            return NONE
    return int(cell * parts * parts + (a - ca * parts) * parts + b - cb * parts)


@numba.njit(cache=True)
def surroundings(
    ij: NDArray[np.int32],
    height: NDArray[np.float32],
    neighbours: NDArray[np.int32],
    cell: float,
    parts: int,
    max_slope: float,
    band_top: NDArray[np.float32],
    band_bottom: float,
    column_ij: NDArray[np.int32],
    first: NDArray[np.int64],
    bottom: NDArray[np.float32],
    top: NDArray[np.float32],
    part_height: NDArray[np.float32],
    floor: NDArray[np.bool_],
    wall: NDArray[np.bool_],
) -> None:
    """Floor height of every small cell, and whether its column shows floor there, and wall in the band above it."""
    side = cell / parts
    for row in range(ij.shape[0]):
        slope_i, slope_j = _slope(height, neighbours, row, 6, 2, cell), _slope(height, neighbours, row, 0, 4, cell)
        slope_i, slope_j = min(max(slope_i, -max_slope), max_slope), min(max(slope_j, -max_slope), max_slope)
        for a in range(parts):
            i = ij[row, 0] * parts + a
            column = first_row(column_ij, i, ij[row, 1] * parts)
            for b in range(parts):
                part = (row * parts + a) * parts + b
                j = ij[row, 1] * parts + b
                z = height[row] + side * ((a - 0.5 * (parts - 1)) * slope_i + (b - 0.5 * (parts - 1)) * slope_j)
                part_height[part] = z
                if column == column_ij.shape[0] or column_ij[column, 0] != i or column_ij[column, 1] != j:
                    continue
                for r in range(first[column], first[column + 1]):
                    floor[part] |= bottom[r] <= z + band_bottom and top[r] >= z - band_bottom
                    wall[part] |= top[r] > z + band_bottom and bottom[r] < z + band_top[row]
                column += 1


@numba.njit(cache=True)
def _slope(
    height: NDArray[np.float32], neighbours: NDArray[np.int32], row: int, k: int, back: int, cell: float
) -> float:
    """Rise of the surface over run towards neighbour ``k``, away from neighbour ``back``."""
    a, b = neighbours[row, k], neighbours[row, back]
    if a >= 0 and b >= 0:
        return float((height[a] - height[b]) / (2.0 * cell))
    if a >= 0:
        return float((height[a] - height[row]) / cell)
    return float((height[row] - height[b]) / cell) if b >= 0 else 0.0


@numba.njit(cache=True)
def steps_from(
    neighbours: NDArray[np.int32], parts: int, mask: NDArray[np.bool_], edge: bool, limit: int, steps: NDArray[np.uint8]
) -> None:
    """Steps in the four directions from each small cell to the nearest of ``mask``, ``limit`` + 1 where farther.

    edge : whether what lies beyond the last cells counts as of the mask.
    """
    n = mask.size
    for row in range(n):
        steps[row] = 0 if mask[row] else limit + 1
    changed = True
    while changed:
        changed = False
        for sweep in range(2):
            for m in range(n):
                row = m if sweep == 0 else n - 1 - m
                if steps[row] <= 1:
                    continue
                best = steps[row]
                for k in range(0, 8, 2):
                    other = next_part(neighbours, parts, row, k)
                    if other >= 0:
                        best = min(best, steps[other] + 1)
                    elif edge:
                        best = 1
                if best < steps[row]:
                    steps[row] = best
                    changed = True


@numba.njit(cache=True)
def all_around(neighbours: NDArray[np.int32], parts: int, mask: NDArray[np.bool_], out: NDArray[np.bool_]) -> None:
    """Small cells of the mask whose eight neighbours are in it."""
    for row in range(mask.size):
        out[row] = mask[row]
        for k in range(8):
            if not out[row]:
                break
            other = next_part(neighbours, parts, row, k)
            out[row] = other >= 0 and mask[other]


@numba.njit(cache=True)
def any_around(neighbours: NDArray[np.int32], parts: int, mask: NDArray[np.bool_], out: NDArray[np.bool_]) -> None:
    """Small cells in the mask or with one of their eight neighbours in it."""
    for row in range(mask.size):
        out[row] = mask[row]
        for k in range(8):
            if out[row]:
                break
            other = next_part(neighbours, parts, row, k)
            out[row] = other >= 0 and mask[other]


@numba.njit(cache=True)
def fill_islands(neighbours: NDArray[np.int32], parts: int, mask: NDArray[np.bool_], limit: int) -> None:
    """Set the parts of the complement of ``mask``, connected in four directions, of fewer than ``limit`` small cells.

    Not those at the edge of the surface: nobody knows how large they are.
    """
    seen = mask.copy()
    queue = np.empty(mask.size, np.int32)
    for start in range(mask.size):
        if seen[start]:
            continue
        seen[start] = True
        queue[0] = start
        done, count, closed = 0, 1, True
        while done < count:
            row = queue[done]
            done += 1
            for k in range(0, 8, 2):
                other = next_part(neighbours, parts, row, k)
                closed &= other >= 0
                if other >= 0 and not seen[other]:
                    seen[other] = True
                    queue[count] = other
                    count += 1
        if closed and count < limit:
            for m in range(count):
                mask[queue[m]] = True


@numba.njit(cache=True)
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


@numba.njit(cache=True)
def neighbours_of_parts(
    neighbours: NDArray[np.int32],
    parts: int,
    rows: NDArray[np.int64],
    number: NDArray[np.int32],
    beside_wall: NDArray[np.bool_],
    out: NDArray[np.int32],
) -> None:
    """Neighbours (k, 8) of the free small cells ``rows`` (k,) as numbers, or ``WALL`` or ``UNKNOWN``.

    number : of each small cell, NONE of those that are not free.
    """
    for m in range(rows.size):
        for k in range(8):
            other = next_part(neighbours, parts, rows[m], k)
            if other < 0:
                out[m, k] = UNKNOWN
            elif number[other] >= 0:
                out[m, k] = number[other]
            else:
                out[m, k] = WALL if beside_wall[other] else UNKNOWN
