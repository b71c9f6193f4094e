"""Storeys: where columns have head-room over something to stand on, and which of that is the floor of a roadway.

A mine's columns have head-room over its floors, but also over its roofs, between the roof of one level and the floor of
the next, and on top of machines. What tells them apart is what is at the border: a floor ends at walls, that rise from
it; a roof seen from above just ends; a machine's top drops down to the floor around.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maps._numba_storeys import bounds_of_sheets, count_gaps, count_support, link_gaps, link_narrow_gaps, write_gaps
from maps.columns import Columns
from maps.settings import FreeSpaceSettings

_HEADROOM_M, _COMMON_M = 1.2, 1.0
"""Least free height over a floor, and that neighbouring floors must have in common. Both cells are wide and slope."""
_STEP_M = 0.2
"""Step from cell to cell that a floor may have beyond its slope: stones, noise, sleepers."""
THIN_M = 0.2
_SUPPORT = 4
_LOOK_M, _NARROW_M = 2.4, 4.0
MAX_TABLE_HEIGHT_M, MAX_TABLE_AREA_M2 = 4.0, 60.0
"""A machine's top is at most so high and so large."""
_TABLE_SHARE, _ISLAND_SHARE = 0.25, 0.7
"""At least such shares of its border are over the floor: the second of machines that stand free, of any size."""
_WALL_SHARE = 0.3
LEAST_AREA_M2 = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class Storeys:
    """Floors of roadways, as far as points lie on them.

    ij : (n, 2) int32, cells of the columns, sorted by i, j and height.
    height, headroom : (n,) float32, of the floor and above it up to the roof, infinite under the sky [m].
    """

    ij: NDArray[np.int32]
    height: NDArray[np.float32]
    headroom: NDArray[np.float32]


def storeys_of(columns: Columns, settings: FreeSpaceSettings) -> Storeys:
    """The floors in the columns of a map."""
    begins = count_gaps(columns.first, columns.bottom, columns.top, _HEADROOM_M)
    height, headroom = np.empty((2, begins[-1]), np.float32)
    write_gaps(columns.first, columns.bottom, columns.top, columns.mean, _HEADROOM_M, THIN_M, height, headroom)
    rise = settings.max_slope * columns.cell
    support = np.empty(len(height), np.int8)
    count_support(columns.ij, begins, height, headroom, rise, _STEP_M, _COMMON_M, support)
    sheet = np.empty(len(height), np.int64)
    linking = (columns.ij, begins, height, headroom, support, _SUPPORT, rise, _STEP_M, _COMMON_M)
    link_gaps(*linking, sheet)
    link_narrow_gaps(*linking, round(_NARROW_M / columns.cell), sheet)
    tally = np.zeros((len(height), 4), np.int32)
    band = np.array([settings.wall_from, settings.wall_to])
    bounds_of_sheets(
        columns.ij,
        columns.first,
        columns.bottom,
        columns.top,
        begins,
        height,
        headroom,
        sheet,
        rise,
        _STEP_M,
        _COMMON_M,
        round(_LOOK_M / columns.cell),
        band,
        MAX_TABLE_HEIGHT_M,
        tally,
    )
    kept = _is_floor(tally, columns.cell)[sheet]
    ij = np.repeat(columns.ij, np.diff(begins), axis=0)
    return Storeys(ij[kept], height[kept], headroom[kept])


def _is_floor(tally: NDArray[np.int32], cell: float) -> NDArray[np.bool_]:
    """Which sheets are floors of roadways, from how many of their cells' sides end at walls, over floors, nowhere."""
    wall, below, nowhere, cells = tally.T
    border = np.maximum(wall + below + nowhere, 1)
    area = cells * cell**2
    table = (below > _ISLAND_SHARE * border) | (below > _TABLE_SHARE * border) & (area < MAX_TABLE_AREA_M2)
    return np.asarray((area > LEAST_AREA_M2) & (wall > _WALL_SHARE * border) & ~table)
