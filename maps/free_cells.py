"""Free space of a map: which cells of its floor a robot can be over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maps._numba_parts import (
    all_around,
    any_around,
    bridge,
    doors_of,
    fill_islands,
    in_order,
    neighbours_of_parts,
    steps_from,
    surroundings,
)
from maps.clutter import with_clutter
from maps.columns import Columns
from maps.free_space import FreeSpace
from maps.settings import FreeSpaceSettings
from maps.storeys import LEAST_AREA_M2, storeys_of
from maps.surface import Surface, floor_of
from semmap.errors import CloudError

_THIN, _VERY_THIN, _THIN_M = 0.8, 0.3, 1.0
"""Floor is thinly sampled where fewer than such shares of its cells, averaged over some metres, hold a point."""
_BELOW_ROOF_M = 0.4


def split_ground_and_walls(columns: Columns, settings: FreeSpaceSettings) -> FreeSpace:
    """Free space of a dense map, on as many levels as it has. Raises `CloudError` where it shows no floor."""
    parts = max(1, round(settings.ground_cell / settings.cell))
    coarse = columns.coarser(parts)
    surface = floor_of(storeys_of(coarse, settings), coarse.cell, settings)
    if not len(surface):
        raise CloudError("shows no floor", mend="check that z points up and the floor was scanned")
    surface = with_clutter(surface, coarse, settings)
    margin = round(0.5 * settings.max_gap_sparse / coarse.cell)
    surface = smoothed(surface.carried_on(margin, settings))
    return _free_cells(surface, columns, parts, settings)


def smoothed(surface: Surface) -> Surface:
    """With heights averaged over about a metre; those of cells that were not seen hardly count."""
    weights = np.where(surface.seen, np.float32(1.0), np.float32(0.05))
    height = surface.spread(surface.height, weights, 2)
    return Surface(
        surface.cell, surface.ij, height, surface.headroom, surface.seen, surface.clutter, surface.neighbours
    )


def _free_cells(surface: Surface, columns: Columns, parts: int, settings: FreeSpaceSettings) -> FreeSpace:
    n = len(surface) * parts**2
    height, floor, wall = np.empty(n, np.float32), np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    surroundings(
        surface.ij,
        surface.height,
        surface.neighbours,
        surface.cell,
        parts,
        settings.max_slope,
        _band_top(surface, settings),
        settings.wall_from,
        columns.ij,
        columns.first,
        columns.bottom,
        columns.top,
        height,
        floor,
        wall,
    )
    clutter = np.repeat(surface.clutter, parts**2)
    wall &= ~clutter
    floor, wall = _closed(surface, floor, wall, parts, settings)
    free = (floor | clutter) & ~wall
    free = _opened(surface, free, parts)
    doors = doors_of(parts)
    fill_islands(surface.neighbours, doors, free, round(settings.max_clutter / settings.cell**2))
    rock = ~free
    fill_islands(surface.neighbours, doors, rock, round(LEAST_AREA_M2 / settings.cell**2))
    return _free_space(surface, ~rock, wall, height, parts, settings)


def _band_top(surface: Surface, settings: FreeSpaceSettings) -> NDArray[np.float32]:
    """Height (n,) above the floor up to which points are walls [m]: less where the roof is low."""
    known = np.isfinite(surface.headroom)
    room = surface.spread(np.where(known, surface.headroom, np.float32(0.0)), known.astype(np.float32), 3)
    room = np.where(room > 0.0, room, np.float32(np.inf))
    return np.asarray(np.clip(room - _BELOW_ROOF_M, 2.0 * settings.wall_from, settings.wall_to), np.float32)


def _closed(
    surface: Surface, floor: NDArray[np.bool_], wall: NDArray[np.bool_], parts: int, settings: FreeSpaceSettings
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Floor and walls without the holes that the sampling left.

    Small ones in the floor; wider ones where it is thinly sampled, and small ones in the walls, which stop it.
    """
    little, wide = (round(0.5 * gap / settings.cell) for gap in (settings.max_gap, settings.max_gap_sparse))
    whole = _without_gaps(surface, floor, parts, wide)
    covered = np.repeat(_covered(surface, floor, whole, parts), parts**2)
    middle = _without_gaps(surface, floor, parts, (little + wide) // 2)
    narrow = _without_gaps(surface, floor, parts, little)
    whole_wall = np.empty_like(wall)
    bridge(surface.neighbours, doors_of(parts), wall, round(settings.max_gap / settings.cell), whole_wall)
    wall = wall | (covered < _THIN) & whole_wall
    return np.select([covered < _VERY_THIN, covered < _THIN], [whole, middle], narrow), wall


def _covered(surface: Surface, floor: NDArray[np.bool_], whole: NDArray[np.bool_], parts: int) -> NDArray[np.float32]:
    """Share (n,) of the floor's small cells that hold a point, averaged over some metres."""
    seen, all_of_it = (mask.reshape(-1, parts**2).mean(axis=1, dtype=np.float32) for mask in (floor, whole))
    times = round(1.5 * (_THIN_M / surface.cell) ** 2)
    return surface.spread(seen / np.maximum(all_of_it, np.float32(1e-6)), all_of_it, times)


def _without_gaps(surface: Surface, mask: NDArray[np.bool_], parts: int, reach: int) -> NDArray[np.bool_]:
    """The mask widened by ``reach`` small cells, and narrowed again."""
    doors, steps = doors_of(parts), np.empty(mask.size, np.uint8)
    steps_from(surface.neighbours, doors, mask, False, reach, steps)
    outside = steps > reach
    steps_from(surface.neighbours, doors, outside, True, reach, steps)
    return np.asarray((steps > reach) | mask)


def _opened(surface: Surface, free: NDArray[np.bool_], parts: int) -> NDArray[np.bool_]:
    """Free cells that are in a square of three by three free ones."""
    inner, opened = np.empty_like(free), np.empty_like(free)
    all_around(surface.neighbours, doors_of(parts), free, inner)
    any_around(surface.neighbours, doors_of(parts), inner, opened)
    return opened


def _free_space(
    surface: Surface,
    free: NDArray[np.bool_],
    wall: NDArray[np.bool_],
    height: NDArray[np.float32],
    parts: int,
    settings: FreeSpaceSettings,
) -> FreeSpace:
    """The free cells alone, in order."""
    count = int(np.count_nonzero(free))
    rows, ij = np.empty(count, np.int32), np.empty((count, 2), np.int32)
    in_order(surface.ij, parts, free, rows, ij)
    beside_wall = np.empty_like(wall)
    any_around(surface.neighbours, doors_of(parts), wall, beside_wall)
    neighbours = np.empty((count, 8), np.int32)
    neighbours_of_parts(surface.neighbours, doors_of(parts), rows, beside_wall, neighbours)
    height = height[rows]
    headroom = (surface.height + surface.headroom)[rows // parts**2] - height
    return FreeSpace.of_cells(settings.cell, (0.0, 0.0), ij, height, headroom, neighbours)
