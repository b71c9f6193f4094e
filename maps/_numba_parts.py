"""Kernels on the small cells of a surface, ``parts`` by ``parts`` to a cell, numbered cell by cell.

Callers: `maps.free_cells`, and `maps.clutter` with one part to a cell.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from maps._numba_floor import DI, DJ, UNKNOWN, WALL, first_row
from maps._numba_surface import NONE, end_of

_DIRECTION = np.array([[3, 2, 1], [4, -1, 0], [5, 6, 7]])


@numba.njit(cache=True, nogil=True)
def doors_of(parts: int) -> NDArray[np.int64]:
    """For each small cell of a cell and each direction (parts², 8, 2): which neighbour of the cell, and which of its.

    The neighbour is -1 where it is the cell itself.
    """
    doors = np.empty((parts * parts, 8, 2), np.int64)
    for part in range(parts * parts):
        for k in range(8):
            a, b = part // parts + DI[k], part % parts + DJ[k]
            ca, cb = (a + parts) // parts - 1, (b + parts) // parts - 1
            doors[part, k, 0] = _DIRECTION[ca + 1, cb + 1]
            doors[part, k, 1] = (a - ca * parts) * parts + b - cb * parts
    return doors


@numba.njit(cache=True, nogil=True)
def _beyond(neighbours: NDArray[np.int32], doors: NDArray[np.int64], cell: int, part: int, k: int) -> int:
    """Number of the small cell next to small cell ``part`` of a cell in direction ``k``, or NONE."""
    if doors[part, k, 0] >= 0:
        cell = neighbours[cell, doors[part, k, 0]]
        if cell < 0:
            return NONE
    return int(cell * doors.shape[0] + doors[part, k, 1])


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True)
def steps_from(
    neighbours: NDArray[np.int32],
    doors: NDArray[np.int64],
    mask: NDArray[np.bool_],
    edge: bool,
    limit: int,
    steps: NDArray[np.uint8],
) -> None:
    """Steps in the four directions from each small cell to the nearest of ``mask``, ``limit`` + 1 where farther.

    edge : whether what lies beyond the last cells counts as of the mask.
    """
    size = doors.shape[0]
    queue = np.empty(mask.size, np.int32)
    done, count = 0, 0
    for row in range(mask.size):
        steps[row] = 0 if mask[row] else limit + 1
    for seed in range(2):  # first those of the mask, then those at the edge: the queue is in the order of the steps
        for row in range(mask.size if seed == 0 or edge else 0):
            if mask[row] != (seed == 0):
                continue
            for k in range(0, 8, 2):
                other = _beyond(neighbours, doors, row // size, row % size, k)
                if (seed == 0 and other >= 0 and not mask[other]) or (seed == 1 and other < 0):
                    steps[row] = seed
                    queue[count] = row
                    count += 1
                    break
    while done < count:
        row = queue[done]
        done += 1
        if steps[row] >= limit:
            continue
        for k in range(0, 8, 2):
            other = _beyond(neighbours, doors, row // size, row % size, k)
            if other >= 0 and steps[other] > steps[row] + 1:
                steps[other] = steps[row] + 1
                queue[count] = other
                count += 1


@numba.njit(cache=True, nogil=True)
def all_around(
    neighbours: NDArray[np.int32], doors: NDArray[np.int64], mask: NDArray[np.bool_], out: NDArray[np.bool_]
) -> None:
    """Small cells of the mask whose eight neighbours are in it."""
    size = doors.shape[0]
    for row in range(mask.size):
        out[row] = mask[row]
        for k in range(8):
            if not out[row]:
                break
            other = _beyond(neighbours, doors, row // size, row % size, k)
            out[row] = other >= 0 and mask[other]


@numba.njit(cache=True, nogil=True)
def any_around(
    neighbours: NDArray[np.int32], doors: NDArray[np.int64], mask: NDArray[np.bool_], out: NDArray[np.bool_]
) -> None:
    """Small cells in the mask or with one of their eight neighbours in it."""
    size = doors.shape[0]
    out[:] = mask
    for row in range(mask.size):
        if mask[row]:
            for k in range(8):
                other = _beyond(neighbours, doors, row // size, row % size, k)
                if other >= 0:
                    out[other] = True


@numba.njit(cache=True, nogil=True)
def bridge(
    neighbours: NDArray[np.int32], doors: NDArray[np.int64], mask: NDArray[np.bool_], gap: int, out: NDArray[np.bool_]
) -> None:
    """The mask, and the small cells between two of its cells on opposite sides (135 degrees or more), ``gap`` apart."""
    size = doors.shape[0]
    away = np.empty(8, np.int64)
    for row in range(mask.size):
        out[row] = mask[row]
        if mask[row]:
            continue
        for k in range(8):
            other, away[k] = row, gap + 1
            for step in range(1, gap + 1):
                other = _beyond(neighbours, doors, other // size, other % size, k)
                if other < 0 or mask[other]:
                    away[k] = step if other >= 0 else gap + 1
                    break
        for k in range(8):
            out[row] |= away[k] + min(away[(k + 3) % 8], away[(k + 4) % 8]) <= gap + 1


@numba.njit(cache=True, nogil=True)
def fill_islands(neighbours: NDArray[np.int32], doors: NDArray[np.int64], mask: NDArray[np.bool_], limit: int) -> None:
    """Set the parts of the complement of ``mask``, connected in four directions, of fewer than ``limit`` small cells.

    Not those at the edge of the surface: nobody knows how large they are.
    """
    size = doors.shape[0]
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
                other = _beyond(neighbours, doors, row // size, row % size, k)
                closed &= other >= 0
                if other >= 0 and not seen[other]:
                    seen[other] = True
                    queue[count] = other
                    count += 1
        if closed and count < limit:
            for m in range(count):
                mask[queue[m]] = True


@numba.njit(cache=True, nogil=True)
def in_order(
    ij: NDArray[np.int32], parts: int, mask: NDArray[np.bool_], rows: NDArray[np.int32], plan: NDArray[np.int32]
) -> None:
    """Write the small cells of the mask (m,), and their plan cells (m, 2), sorted by i, j and as the cells are."""
    count, start, n = 0, 0, ij.shape[0]
    while start < n:
        stop = start
        while stop < n and ij[stop, 0] == ij[start, 0]:
            stop += 1
        for a in range(parts):
            cell = start
            while cell < stop:
                end = end_of(ij, cell)
                for b in range(parts):
                    for level in range(cell, end):
                        row = (level * parts + a) * parts + b
                        if mask[row]:
                            rows[count] = row
                            plan[count, 0], plan[count, 1] = ij[cell, 0] * parts + a, ij[cell, 1] * parts + b
                            count += 1
                cell = end
        start = stop


@numba.njit(cache=True, nogil=True)
def neighbours_of_parts(
    neighbours: NDArray[np.int32],
    doors: NDArray[np.int64],
    rows: NDArray[np.int32],
    beside_wall: NDArray[np.bool_],
    out: NDArray[np.int32],
) -> None:
    """Neighbours (m, 8) of the free small cells ``rows`` (m,): their places in ``rows``, ``WALL`` or ``UNKNOWN``."""
    size = doors.shape[0]
    place = np.full(beside_wall.size, NONE, np.int32)
    for m in range(rows.size):
        place[rows[m]] = m
    for m in range(rows.size):
        for k in range(8):
            other = _beyond(neighbours, doors, rows[m] // size, rows[m] % size, k)
            if other < 0:
                out[m, k] = UNKNOWN
            elif place[other] >= 0:
                out[m, k] = place[other]
            else:
                out[m, k] = WALL if beside_wall[other] else UNKNOWN
