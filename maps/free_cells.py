"""Free space of a map: which cells of its floor a robot can be over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maps._numba_surface import (
    NONE,
    all_around,
    any_around,
    fill_islands,
    neighbours_of_parts,
    steps_from,
    surroundings,
)
from maps.clutter import with_clutter
from maps.columns import Columns
from maps.free_space import FreeSpace
from maps.settings import FreeSpaceSettings
from maps.storeys import storeys_of
from maps.surface import Surface, floor_of
from semmap.errors import CloudError

_THIN, _THIN_M = 0.8, 1.0
"""Floor is thinly sampled where fewer than this share of its cells, averaged over some metres, hold a point."""
_BELOW_ROOF_M = 0.4


def split_ground_and_walls(columns: Columns, settings: FreeSpaceSettings) -> FreeSpace:
    """Free space of a dense map, on as many levels as it has. Raises `CloudError` where it shows no floor."""
    parts = round(settings.ground_cell / settings.cell)
    coarse = columns.coarser(parts)
    surface = floor_of(storeys_of(coarse, settings), coarse.cell, settings)
    if not len(surface):
        raise CloudError("shows no floor", mend="check that z points up and the floor was scanned")
    surface = with_clutter(surface, coarse, settings)
    margin = round(0.5 * settings.max_gap_sparse / settings.ground_cell)
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
    free = (_closed(surface, floor, parts, settings) | clutter) & ~wall
    free = _opened(surface, free, parts)
    fill_islands(surface.neighbours, parts, free, round(settings.max_clutter / settings.cell**2))
    return _free_space(surface, free, wall, height, parts, settings)


def _band_top(surface: Surface, settings: FreeSpaceSettings) -> NDArray[np.float32]:
    """Height (n,) above the floor up to which points are walls [m]: less where the roof is low."""
    known = np.isfinite(surface.headroom)
    room = surface.spread(np.where(known, surface.headroom, np.float32(0.0)), known.astype(np.float32), 3)
    room = np.where(room > 0.0, room, np.float32(np.inf))
    return np.asarray(np.clip(room - _BELOW_ROOF_M, 2.0 * settings.wall_from, settings.wall_to), np.float32)


def _closed(surface: Surface, floor: NDArray[np.bool_], parts: int, settings: FreeSpaceSettings) -> NDArray[np.bool_]:
    """Floor without the holes that the sampling left: small ones, and wide ones where the floor is thinly sampled."""
    reach = [round(0.5 * gap / settings.cell) for gap in (settings.max_gap, settings.max_gap_sparse)]
    away = np.empty(floor.size, np.uint8)
    steps_from(surface.neighbours, parts, floor, False, reach[1], away)
    inward = np.empty_like(away)
    closed = []
    for n in reach:
        steps_from(surface.neighbours, parts, away > n, True, n, inward)
        closed.append(inward > n)
    little, wide = closed
    covered, all_of_it = (mask.reshape(-1, parts**2).mean(axis=1, dtype=np.float32) for mask in (floor, wide))
    times = round(1.5 * (_THIN_M / surface.cell) ** 2)
    share = surface.spread(covered / np.maximum(all_of_it, 1e-6), all_of_it, times)
    return np.asarray(np.where(np.repeat(share < _THIN, parts**2), wide, little))


def _opened(surface: Surface, free: NDArray[np.bool_], parts: int) -> NDArray[np.bool_]:
    """Free cells that are in a square of three by three free ones."""
    inner, opened = np.empty_like(free), np.empty_like(free)
    all_around(surface.neighbours, parts, free, inner)
    any_around(surface.neighbours, parts, inner, opened)
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
    rows = np.flatnonzero(free)
    owner, part = np.divmod(rows, parts**2)
    ij = surface.ij[owner] * np.int32(parts) + np.stack(np.divmod(part, parts), axis=-1).astype(np.int32)
    order = np.lexsort((height[rows], ij[:, 1], ij[:, 0]))
    rows, owner, ij = rows[order], owner[order], ij[order]
    number = np.full(free.size, NONE, np.int32)
    number[rows] = np.arange(len(rows), dtype=np.int32)
    beside_wall = np.empty_like(wall)
    any_around(surface.neighbours, parts, wall, beside_wall)
    neighbours = np.empty((len(rows), 8), np.int32)
    neighbours_of_parts(surface.neighbours, parts, rows, number, beside_wall, neighbours)
    headroom = surface.height[owner] + surface.headroom[owner] - height[rows]
    return FreeSpace.of_cells(settings.cell, (0.0, 0.0), ij, height[rows], headroom, neighbours)
