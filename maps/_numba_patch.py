"""Kernel that puts points on a floor raster. Caller: `maps.floor_patch`."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True, nogil=True)
def heights_on(
    floor: NDArray[np.float32],
    roof: NDArray[np.float32],
    x0: float,
    y0: float,
    cell: float,
    below: float,
    over: float,
    roofless: float,
    points: NDArray[np.floating],
    heights: NDArray[np.float64],
) -> None:
    """Write to ``heights`` (n,) how far points (n, 3) lie above the floor, linear between cell centres.

    NaN where they lie off the raster or are more than ``below`` under the floor or ``over`` above the roof of their
    cell; where its roof is infinite, more than ``roofless`` above the floor.
    """
    nx, ny = floor.shape
    for n in range(points.shape[0]):
        heights[n] = np.nan
        x, y = (points[n, 0] - x0) / cell, (points[n, 1] - y0) / cell
        i, j = int(np.floor(x)), int(np.floor(y))
        if i < 0 or j < 0 or i >= nx or j >= ny:
            continue
        top = floor[i, j] + roofless if roof[i, j] == np.inf else roof[i, j] + over
        if points[n, 2] < floor[i, j] - below or points[n, 2] > top:
            continue
        x, y = min(max(x - 0.5, 0.0), nx - 1.0), min(max(y - 0.5, 0.0), ny - 1.0)
        i, j = min(int(x), nx - 2), min(int(y), ny - 2)
        u, v = x - i, y - j
        before = (1.0 - v) * floor[i, j] + v * floor[i, j + 1]
        beyond = (1.0 - v) * floor[i + 1, j] + v * floor[i + 1, j + 1]
        heights[n] = points[n, 2] - (1.0 - u) * before - u * beyond
