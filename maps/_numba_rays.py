"""Kernel that marks what rays cross in a plan-view raster. Caller: `maps.views`; `maps.free_space` reads such."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

UNKNOWN, FREE, WALL = 0, 1, 2


@numba.njit(cache=True, nogil=True)
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
