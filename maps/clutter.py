"""Clutter: machines, boxes and unseen floor that a map shows free below the roof, and that bound no roadway.

A pillar reaches the roof. Over a parked machine the roof goes on, and between the two it is free; where there is no
roof, a machine shows a level top.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from maps._numba_clutter import count_sides, walk_under
from maps._numba_surface import all_around, any_around, ease, link_cells
from maps.columns import Columns
from maps.settings import FreeSpaceSettings
from maps.storeys import MAX_TABLE_AREA_M2, MAX_TABLE_HEIGHT_M
from maps.surface import APART_M, Surface
from semmap.geometry import Array

_CLEAR_M = 0.3
_FARTHEST_M, _LOOK_M = 4.0, 1.2
_LEVEL_M = 0.2
_LEAST_AREA_M2 = 1.0
_BESIDE_M = 2.5
_NOTHING = np.float32(-1e6)
_EASE = 60
_MOST_OPEN, _MOST_OPEN_ROOFLESS = 0.25, 0.12
"""Clutter stands on floor and before walls: at most this share of its sides may end at nothing, as the tops of walls
do, which pass for clutter where there is no roof over them."""


def with_clutter(surface: Surface, columns: Columns, settings: FreeSpaceSettings) -> Surface:
    """The floor carried on below machines, and wherever the roof shows that it goes on.

    columns : with cells of the surface's size.
    """
    floor, roof, top = np.empty((3, len(columns)), np.float32)
    walk_under(
        surface.ij,
        surface.height,
        surface.headroom,
        surface.neighbours,
        _BESIDE_M,
        columns.ij,
        columns.first,
        columns.bottom,
        columns.top,
        settings.max_slope * columns.cell + _LEVEL_M,
        _CLEAR_M,
        MAX_TABLE_HEIGHT_M,
        round(_FARTHEST_M / columns.cell),
        floor,
        roof,
        top,
    )
    found = np.flatnonzero(np.isfinite(floor))
    labels = _bodies(columns.ij[found], np.maximum(top[found], _NOTHING), columns.cell)
    clutter = (labels >= 0) & _stands(found, labels, floor, roof, top, surface, columns, settings)
    found = found[_with_sides(clutter, columns.ij[found], floor[found], np.isfinite(roof[found]))]
    return _eased(
        surface.extended(columns.ij[found], floor[found], roof[found] - floor[found], True, settings), settings
    )


def _eased(surface: Surface, settings: FreeSpaceSettings) -> Surface:
    """With the floor below clutter between that around it: the walk there carried on the height where it began."""
    neighbours = np.empty_like(surface.neighbours)
    link_cells(surface.ij, surface.height, settings.max_slope * surface.cell, _BESIDE_M, neighbours)
    height = surface.height.copy()
    ease(neighbours, np.flatnonzero(surface.clutter), _EASE, height)
    headroom = surface.headroom + surface.height - height
    return Surface.linked(surface.cell, surface.ij, height, headroom, surface.seen, surface.clutter, settings)


def _bodies(ij: NDArray[np.int32], top: NDArray[np.float32], cell: float) -> NDArray[np.int32]:
    """Number (n,) of the body each cell (n, 2), sorted, is of: of one level top (n,), and no larger than a machine.

    -1 for ledges, leaning walls and the upper ends of walls, which are narrow.
    """
    neighbours = np.empty((len(ij), 8), np.int32)
    link_cells(ij, top, 0.0, _LEVEL_M, neighbours)
    wide = np.where(top == _NOTHING, _in_large_square(neighbours), _in_square(neighbours))
    rows, k = np.nonzero((neighbours >= 0) & wide[:, None])
    others = neighbours[rows, k]
    both = wide[others]
    joined = coo_matrix((both[both], (rows[both], others[both])), shape=(len(ij), len(ij)))
    labels = connected_components(joined, directed=False)[1].astype(np.int32)
    area: Array = np.bincount(labels, minlength=1)[labels] * cell**2
    wide &= (area > _LEAST_AREA_M2) & ((area < MAX_TABLE_AREA_M2) | (top == _NOTHING))
    return np.where(wide, labels, np.int32(-1))


def _in_square(neighbours: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Cells (n,) that make a square of two by two with three neighbours, or of which a neighbour does."""
    there = neighbours >= 0
    corner = there & np.roll(there, -1, axis=1) & np.roll(there, -2, axis=1)
    return np.asarray(corner[:, ::2].any(axis=1))


def _in_large_square(neighbours: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Cells (n,) of squares of three by three."""
    inner, wide = np.empty((2, len(neighbours)), np.bool_)
    all_around(neighbours, 1, np.ones(len(neighbours), np.bool_), inner)
    any_around(neighbours, 1, inner, wide)
    return wide


def _stands(
    found: NDArray[np.int64],
    labels: NDArray[np.int32],
    floor: NDArray[np.float32],
    roof: NDArray[np.float32],
    top: NDArray[np.float32],
    surface: Surface,
    columns: Columns,
    settings: FreeSpaceSettings,
) -> NDArray[np.bool_]:
    """Whether what the columns ``found`` (n,) are of has floor or walls nearly all around."""
    tally = np.zeros((labels.max(initial=-1) + 2, 2), np.int64)
    count_sides(
        found,
        labels,
        floor,
        top,
        surface.ij,
        surface.height,
        _BESIDE_M,
        columns.ij,
        columns.first,
        columns.bottom,
        columns.top,
        settings.wall_from,
        settings.wall_to,
        round(_LOOK_M / columns.cell),
        tally,
    )
    most = np.where(np.isfinite(roof[found]), _MOST_OPEN, _MOST_OPEN_ROOFLESS)
    return np.asarray(tally[labels, 1] <= most * tally[labels].sum(axis=1))


def _with_sides(
    clutter: NDArray[np.bool_], ij: NDArray[np.int32], floor: NDArray[np.float32], roofed: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """The clutter (n,) and what stands within two cells of it, free below a roof: the sides of machines."""
    neighbours = np.empty((len(ij), 8), np.int32)
    link_cells(ij, floor, 0.0, APART_M, neighbours)
    once, twice = np.empty((2, len(ij)), np.bool_)
    any_around(neighbours, 1, clutter, once)
    any_around(neighbours, 1, once & roofed, twice)
    return np.asarray(clutter | (twice & roofed))
