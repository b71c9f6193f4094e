"""Kernels that thin the floor to lines and follow them. Caller: `maps.skeleton`."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True, nogil=True)
def thin(kept: NDArray[np.bool_], neighbours: NDArray[np.int32], order: NDArray[np.int64]) -> None:
    """Clear cells of ``kept`` (n,) in the given order unless that would cut a line, join two holes or shorten an end.

    neighbours : (n, 8) row of the cell next door in each direction, counter-clockwise, the first across a side;
        negative where there is none.
    A cell may go if Yokoi's connectivity number of its eight neighbours is 1.
    """
    gone = np.zeros(9, dtype=np.int64)
    for row in order:
        count = 0
        for k in range(8):
            other = neighbours[row, k]
            gone[k] = 0 if other >= 0 and kept[other] else 1
            count += 1 - gone[k]
        if count < 2:
            continue
        gone[8] = gone[0]
        number = 0
        for k in range(0, 8, 2):
            number += gone[k] - gone[k] * gone[k + 1] * gone[k + 2]
        if number == 1:
            kept[row] = False


@numba.njit(cache=True, nogil=True)
def trace(
    links: NDArray[np.int32], owner: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Follow every line of a skeleton from a node to the next one.

    links : (m, 8) the neighbours of each cell in the skeleton, negative where there is none.
    owner : (m,) number of the node a cell belongs to; -1 of a cell on a line, which has just two neighbours.
    Gives for each line its two nodes (e, 2), where its cells end (e,), and the cells of all lines one after the other.
    """
    m = links.shape[0]
    ends, stops, cells = np.empty((m, 2), np.int64), np.empty(m, np.int64), np.empty(m, np.int64)
    followed = np.zeros(m, np.bool_)
    lines, filled = 0, 0
    for start in range(m):
        if owner[start] < 0:
            continue
        for k in range(8):
            before, here = start, links[start, k]
            if here < 0 or owner[here] >= 0 or followed[here]:
                continue
            while owner[here] < 0:
                followed[here] = True
                cells[filled] = here
                filled += 1
                ahead = here
                for d in range(8):
                    if links[here, d] >= 0 and links[here, d] != before:
                        ahead = links[here, d]
                before, here = here, ahead
            ends[lines, 0], ends[lines, 1], stops[lines] = owner[start], owner[here], filled
            lines += 1
    return ends[:lines], stops[:lines], cells[:filled]
