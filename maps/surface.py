"""A surface of square cells that know their neighbours: the floor while it is being made."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from maps._numba_surface import in_large_piece, link_cells, lower_envelope, median_around, propose, spread
from maps.settings import FreeSpaceSettings
from maps.storeys import LEAST_AREA_M2, Storeys

APART_M, _STEP_M = 1.0, 0.6
"""Floors over each other are at least so far apart; what is nearer belongs together, be it a ledge of the wall."""
_THICK_M = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Floor cells, sorted by i, j and height.

    cell : side of a cell [m].
    ij : (n, 2) int32. height, headroom : (n,) float32 [m].
    seen : (n,) bool, there are points of the floor in the cell; the others carry it on.
    clutter : (n,) bool, there is no such point, but it is free below the roof.
    neighbours : (n, 8) int32, -1 where there is none.
    """

    cell: float
    ij: NDArray[np.int32]
    height: NDArray[np.float32]
    headroom: NDArray[np.float32]
    seen: NDArray[np.bool_]
    clutter: NDArray[np.bool_]
    neighbours: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.ij)

    @classmethod
    def linked(
        cls,
        cell: float,
        ij: NDArray[np.int32],
        height: NDArray[np.float32],
        headroom: NDArray[np.float32],
        seen: NDArray[np.bool_],
        clutter: NDArray[np.bool_],
        settings: FreeSpaceSettings,
    ) -> Surface:
        """The surface that cells make, given in any order."""
        order = np.lexsort((height, ij[:, 1], ij[:, 0]))
        ij, height = ij[order], height[order]
        neighbours = np.empty((len(ij), 8), np.int32)
        link_cells(ij, height, settings.max_slope * cell, _STEP_M, neighbours)
        return cls(cell, ij, height, headroom[order], seen[order], clutter[order], neighbours)

    def only(self, kept: NDArray[np.bool_], settings: FreeSpaceSettings) -> Surface:
        """The surface of some of the cells (n,)."""
        return Surface.linked(
            self.cell,
            self.ij[kept],
            self.height[kept],
            self.headroom[kept],
            self.seen[kept],
            self.clutter[kept],
            settings,
        )

    def gently_sloping(self, settings: FreeSpaceSettings) -> Surface:
        """Without the cells above the highest surface that is nowhere steeper than a roadway: the feet of walls."""
        envelope = np.empty_like(self.height)
        lower_envelope(self.neighbours, self.height, settings.max_slope * self.cell, envelope)
        return self.only(self.height <= envelope + _THICK_M, settings)

    def without_scraps(self, settings: FreeSpaceSettings) -> Surface:
        """Without pieces too small to be a place: what of walls and machines looked like floor."""
        large = np.empty(len(self), np.bool_)
        in_large_piece(self.neighbours, round(LEAST_AREA_M2 / self.cell**2), large)
        return self.only(large, settings)

    def with_steady_roof(self) -> Surface:
        """With the median headroom around: beside walls that lean in, a column may show the next level's floor."""
        headroom = np.empty_like(self.headroom)
        median_around(self.neighbours, self.headroom, headroom)
        return replace(self, headroom=headroom)

    def carried_on(self, rounds: int, settings: FreeSpaceSettings) -> Surface:
        """With so many more cells around every edge, at the height of the floor beside them."""
        surface = self
        for _ in range(rounds):
            at, source = surface.beyond(np.ones(len(surface), np.bool_))
            surface = surface.extended(*grouped(at, surface.height[source], surface.headroom[source]), False, settings)
        return surface

    def beyond(self, may: NDArray[np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Plan cells (m, 2) the surface could go on to from the cells ``may`` (n,), and the row (m,) each is beside."""
        count = propose(self.ij, self.height, self.neighbours, APART_M, may, False, *_places(0))
        places = _places(count)
        propose(self.ij, self.height, self.neighbours, APART_M, may, True, *places)
        return places

    def extended(
        self,
        ij: NDArray[np.int32],
        height: NDArray[np.float32],
        headroom: NDArray[np.float32],
        clutter: bool,
        settings: FreeSpaceSettings,
    ) -> Surface:
        """With cells more that were not seen."""
        return Surface.linked(
            self.cell,
            np.concatenate([self.ij, ij]),
            np.concatenate([self.height, height]),
            np.concatenate([self.headroom, headroom]),
            np.concatenate([self.seen, np.zeros(len(ij), np.bool_)]),
            np.concatenate([self.clutter, np.full(len(ij), clutter)]),
            settings,
        )

    def spread(self, values: NDArray[np.float32], weights: NDArray[np.float32], times: int) -> NDArray[np.float32]:
        """Weighted means (n,) of values over the cells around, as often as told."""
        for _ in range(times):
            mean = np.empty_like(values)
            spread(self.neighbours, values, weights, mean)
            values = mean
        return values


def grouped(
    ij: NDArray[np.int32], height: NDArray[np.float32], headroom: NDArray[np.float32]
) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
    """Cells (m, 2) that were named more than once, at nearly the same height, as one each with the mean height."""
    order = np.lexsort((headroom, height, ij[:, 1], ij[:, 0]))
    ij, height, headroom = ij[order], height[order], headroom[order]
    new = np.ones(len(ij), np.bool_)
    new[1:] = (np.diff(ij, axis=0) != 0).any(axis=1) | (np.diff(height) > 0.5 * APART_M)
    starts = np.flatnonzero(new)
    if not len(starts):
        return ij, height, headroom
    count = np.diff(np.append(starts, len(ij)))
    mean = (np.add.reduceat(height, starts) / count).astype(np.float32)
    return ij[starts], mean, np.minimum.reduceat(headroom, starts)


def floor_of(storeys: Storeys, cell: float, settings: FreeSpaceSettings) -> Surface:
    """The floor as far as it was seen."""
    seen = np.ones(len(storeys.ij), np.bool_)
    surface = Surface.linked(cell, storeys.ij, storeys.height, storeys.headroom, seen, ~seen, settings)
    return surface.gently_sloping(settings).without_scraps(settings).with_steady_roof()


def _places(count: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    return np.empty((count, 2), np.int32), np.empty(count, np.int32)
