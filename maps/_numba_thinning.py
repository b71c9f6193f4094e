"""Kernel that thins a raster to lines. Caller: `maps.skeleton`."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

_DI = np.array([0, -1, -1, -1, 0, 1, 1, 1])
_DJ = np.array([1, 1, 0, -1, -1, -1, 0, 1])


@numba.njit(cache=True)
def thin(mask: NDArray[np.bool_], order: NDArray[np.int64]) -> None:
    """Clear the cells of ``mask`` in the given order unless that would cut a line, join two holes or shorten an end.

    ``mask`` (nx, ny) is written to and must be False along its border; ``order`` holds flat cell numbers.
    A cell may go if Yokoi's connectivity number of its eight neighbours is 1.
    """
    ny = mask.shape[1]
    around = np.zeros(9, dtype=np.int64)
    for cell in order:
        i, j = cell // ny, cell % ny
        count = 0
        for k in range(8):
            around[k] = 0 if mask[i + _DI[k], j + _DJ[k]] else 1
            count += 1 - around[k]
        if count < 2:
            continue
        around[8] = around[0]
        number = 0
        for k in range(0, 8, 2):
            number += around[k] - around[k] * around[k + 1] * around[k + 2]
        if number == 1:
            mask[i, j] = False
