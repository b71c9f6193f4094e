"""LZF, the compression of binary_compressed PCD files."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True, nogil=True)
def lzf_decompress(packed: NDArray[np.uint8], data: NDArray[np.uint8]) -> int:
    """Undo LZF: runs of literal bytes and references back to what is already there.

    packed : (n,) the compressed block; data : (m,) receives the result.
    Returns the number of bytes made, -1 where the input is damaged.
    """
    i, o = 0, 0
    while i < len(packed):
        control = int(packed[i])
        i += 1
        if control < 32:
            length = control + 1
            if i + length > len(packed) or o + length > len(data):
                return -1
            data[o : o + length] = packed[i : i + length]
            i += length
        else:
            length = (control >> 5) + 2
            if length == 9:
                if i >= len(packed):
                    return -1
                length += int(packed[i])
                i += 1
            if i >= len(packed):
                return -1
            source = o - ((control & 31) << 8) - int(packed[i]) - 1
            i += 1
            if source < 0 or o + length > len(data):
                return -1
            for k in range(length):
                data[o + k] = data[source + k]
        o += length
    return o
