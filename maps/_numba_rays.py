"""Kernels that march along rays through plan-view rasters. Callers: `maps.free_space`."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

UNKNOWN, FREE, WALL = 0, 1, 2


@numba.njit(cache=True)
def mark_seen(free: NDArray[np.bool_], wall: NDArray[np.bool_], x: float, y: float, reach: NDArray[np.float64]) -> None:
    """Mark the cells that rays from (x, y) cross before a wall or before they end, all in cells.

    reach : (n,) length of the rays, which leave at equal angles, the first along x. ``free`` is written to.
    """
    n = reach.size
    for k in range(n):
        angle = 2.0 * np.pi * (k + 0.5) / n
        dx, dy = np.cos(angle), np.sin(angle)
        for step in range(int(2.0 * reach[k]) + 1):
            i = int(np.floor(x + 0.5 * step * dx))
            j = int(np.floor(y + 0.5 * step * dy))
            if i < 0 or j < 0 or i >= free.shape[0] or j >= free.shape[1] or wall[i, j]:
                break
            free[i, j] = True


@numba.njit(cache=True)
def march(
    cells: NDArray[np.uint8],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    angle: NDArray[np.float64],
    limit: float,
    distance: NDArray[np.float64],
    at_wall: NDArray[np.bool_],
) -> None:
    """Walk from each (x, y) along each angle to the first cell that is not free, ``limit`` at most, all in cells.

    Writes the distance, and whether the walk ended at a wall: in a wall cell or beside one. Outside the raster
    everything is unknown.
    """
    nx, ny = cells.shape
    for k in range(x.size):
        dx, dy = np.cos(angle[k]), np.sin(angle[k])
        distance[k], at_wall[k] = limit, False
        for step in range(int(4.0 * limit)):
            i = int(np.floor(x[k] + 0.25 * step * dx))
            j = int(np.floor(y[k] + 0.25 * step * dy))
            inside = 0 <= i < nx and 0 <= j < ny
            if inside and cells[i, j] == FREE:
                continue
            distance[k] = 0.25 * step
            for a in range(max(i - 1, 0), min(i + 2, nx)):
                for b in range(max(j - 1, 0), min(j + 2, ny)):
                    at_wall[k] |= cells[a, b] == WALL
            break
