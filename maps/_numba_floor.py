"""Kernels on floor cells that know their neighbours. Callers: `maps.free_space`."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

WALL, UNKNOWN = -1, -2
DI = np.array([0, -1, -1, -1, 0, 1, 1, 1])
DJ = np.array([1, 1, 0, -1, -1, -1, 0, 1])
_DIRECTION = np.array([[3, 2, 1], [4, -1, 0], [5, 6, 7]])
_FAR = 32000


@numba.njit(cache=True, nogil=True)
def nearest_edges(neighbours: NDArray[np.int32], to_edge: NDArray[np.int16]) -> None:
    """Write to ``to_edge`` (n, 2) the steps in plan from each free cell to the nearest one that is not free.

    The steps are handed from cell to cell, back and forth until nothing gets nearer: the walk stays on the surface.
    """
    n = neighbours.shape[0]
    to_edge[:] = _FAR
    changed = True
    while changed:
        changed = False
        for sweep in range(2):
            for m in range(n):
                row = m if sweep == 0 else n - 1 - m
                a, b = np.int64(to_edge[row, 0]), np.int64(to_edge[row, 1])
                best = a * a + b * b
                for k in range(8):
                    other = neighbours[row, k]
                    c, d = DI[k], DJ[k]
                    if other >= 0:
                        if to_edge[other, 0] == _FAR:
                            continue
                        c += to_edge[other, 0]
                        d += to_edge[other, 1]
                    # 0 where a folded surface passes under itself: its edge is not where the cell is
                    if 0 < c * c + d * d < best:
                        best = c * c + d * d
                        to_edge[row, 0], to_edge[row, 1] = c, d
                        changed = True


@numba.njit(cache=True, nogil=True)
def first_row(ij: NDArray[np.int32], i: int, j: int) -> int:
    """First row whose plan cell is not before (i, j); the rows are sorted by i, then j."""
    low, high = 0, ij.shape[0]
    while low < high:
        middle = (low + high) // 2
        if ij[middle, 0] < i or (ij[middle, 0] == i and ij[middle, 1] < j):
            low = middle + 1
        else:
            high = middle
    return low


@numba.njit(cache=True, nogil=True)
def find_cells(
    ij: NDArray[np.int32],
    height: NDArray[np.float32],
    at: NDArray[np.int64],
    z: NDArray[np.float64],
    reach: float,
    rows: NDArray[np.int64],
) -> None:
    """Write to ``rows`` (m,) the row of plan cell ``at`` (m, 2) nearest in height to ``z``, -1 beyond ``reach``."""
    for m in range(z.size):
        rows[m] = -1
        best = reach
        row = first_row(ij, at[m, 0], at[m, 1])
        while row < ij.shape[0] and ij[row, 0] == at[m, 0] and ij[row, 1] == at[m, 1]:
            off = abs(height[row] - z[m])
            if off < best:
                best = off
                rows[m] = row
            row += 1


@numba.njit(cache=True, nogil=True)
def reached(
    ij: NDArray[np.int32], neighbours: NDArray[np.int32], start: int, x: float, y: float, radius: float
) -> NDArray[np.int64]:
    """Rows (k,), ascending, of the cells with centres within ``radius`` of (x, y) on a walk from ``start`` over such.

    All in cells: the centre of cell (i, j) is (i + 0.5, j + 0.5).
    """
    low, high = int(np.floor(x - radius)), int(np.floor(x + radius))
    first = np.empty(high - low + 1, np.int64)
    before = np.zeros(high - low + 2, np.int64)
    for i in range(low, high + 1):
        first[i - low] = first_row(ij, i, int(np.floor(y - radius)))
        end = first_row(ij, i, int(np.floor(y + radius)) + 1)
        before[i - low + 1] = before[i - low] + end - first[i - low]
    seen = np.zeros(before[-1], np.bool_)
    queue = np.empty(before[-1], np.int64)
    queue[0] = start
    i = ij[start, 0] - low
    seen[before[i] + start - first[i]] = True
    done, count = 0, 1
    while done < count:
        row = queue[done]
        done += 1
        for k in range(8):
            other = neighbours[row, k]
            if other < 0 or (ij[other, 0] + 0.5 - x) ** 2 + (ij[other, 1] + 0.5 - y) ** 2 > radius**2:
                continue
            i = ij[other, 0] - low
            number = before[i] + other - first[i]
            if not seen[number]:
                seen[number] = True
                queue[count] = other
                count += 1
    return np.sort(queue[:count])


@numba.njit(cache=True, nogil=True)
def walk_rays(
    ij: NDArray[np.int32],
    neighbours: NDArray[np.int32],
    rows: NDArray[np.int64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    angle: NDArray[np.float64],
    limit: float,
    distance: NDArray[np.float64],
    at_wall: NDArray[np.bool_],
) -> None:
    """Walk from each (x, y) in cell ``rows`` along each angle as far as the floor goes, ``limit`` at most, in cells.

    Writes the distance, and whether the walk ended at a wall. A walk that begins off the floor (-1) ends there.
    """
    for k in range(x.size):
        dx, dy = np.cos(angle[k]), np.sin(angle[k])
        row = rows[k]
        distance[k], at_wall[k] = limit if row >= 0 else 0.0, False
        if row < 0:
            continue
        for step in range(int(4.0 * limit)):
            di = int(np.floor(x[k] + 0.25 * step * dx)) - ij[row, 0]
            dj = int(np.floor(y[k] + 0.25 * step * dy)) - ij[row, 1]
            if di == 0 and dj == 0:
                continue
            row = neighbours[row, _DIRECTION[di + 1, dj + 1]]
            if row < 0:
                distance[k], at_wall[k] = 0.25 * step, row == WALL
                break
