"""The highest score that coded contours can have, quickly, so that most of a large map need not be scored.

Let a query and a contour have observed ``m`` and ``n`` sectors, ``b`` of them both at some yaw, let ``D`` be the sum of
1 - agreement over these, and ``o = b / (m + n - b)`` the overlap. The score is ``(1 - D/b) o^(1/4)``. Three facts:

1. A wall known to be in a range of distances agrees no more than the wall of that range that is nearest to the query's.
   Summed over sectors, each rounded down, that is a cost of at most ``D``; and the less the cost, the higher the score.
2. Let each sector that only the query observed cost a quarter: ``E = D + (m - b)/4``. With ``E`` held, the derivative
   of the score by ``b`` is ``(D/b + (1 - D/b)(1 + o)/4 - 1/4) o^(1/4) / b >= 0``, so the most that ``b`` can be, the
   lesser of ``m`` and ``n``, may be put for it: then only the least ``E`` of all yaws is needed.
3. The cheaper of two yaws costs no more than either, for four sectors and so for all.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from descriptors._numba_bounds import best_scores, least_costs, pattern_table
from descriptors.codes import BINS, LEVELS, UNSEEN, Codes
from descriptors.settings import ContourSettings
from descriptors.similarity import kernel_power, relative_distance
from semmap.geometry import Array
from semmap.intersections import WallContour

Rows = NDArray[np.int64]

_UNSEEN_COST = 0.25
_ROUNDING = 1e-5
"""More than the single precision of scores and bounds adds up to."""
_MOST = 30_000
"""No sum of costs is more, and a yaw not asked for costs as much: both together stay below 2^16."""
_LANES = 64
"""Yaws are padded to a multiple of what vector instructions take at a time."""
_STEPS = 64
"""Tabulated agreements per standard deviation of the kernel."""


class Agreement:
    """The most that two sectors agree whose walls are at least so far apart."""

    def __init__(self, settings: ContourSettings) -> None:
        power = kernel_power(settings)
        wave = np.pi * np.arange(len(power))
        self._step = settings.tolerance / settings.radius / _STEPS
        gap = self._step * np.arange(np.ceil(1.0 / self._step) + 2)
        between = (power @ wave**2) * self._step**2 / 8.0  # a curve rises above its chord by its bend step² / 8 at most
        most = np.cos(np.outer(gap, wave)) @ power + between
        self._most = np.minimum(np.maximum.accumulate(most[::-1])[::-1], 1.0)

    def at_most(self, gap: Array) -> Array:
        """For gaps from 0 to 1 [radii], of any shape."""
        return np.asarray(self._most[(gap / self._step).astype(np.int64)])


class Bounds:
    """Upper bounds of the scores of coded contours against one query, over the yaws asked for.

    Parameters
    ----------
    codes, agreement : of the contours and of the settings they were made with.
    query : one contour.
    yaws : (sectors,) bool, by how many sectors the query may be turned.
    """

    def __init__(
        self, codes: Codes, agreement: Agreement, query: WallContour, settings: ContourSettings, yaws: NDArray[np.bool_]
    ) -> None:
        self._codes = codes
        self._agreement = agreement
        self._walls = relative_distance(query.pwcv, settings)
        self._observed = query.pwcv_observed
        self._yaws = np.flatnonzero(yaws)

    def by_pattern(self, rows: Rows) -> Array:
        """Bounds (k,) from patterns of four sectors and from pairs of yaws (facts 1, 2 and 3)."""
        table, unit = self._pattern_table()
        barrier = self._barrier((len(self._walls) + 1) // 2, self._yaws // 2)
        least = np.empty(len(rows), np.uint16)
        least_costs(table.ravel(), table.shape[1], self._codes.patterns, rows, 2, barrier, least)
        return self._scores(least, unit, rows)

    def by_sector(self, rows: Rows) -> Array:
        """Bounds (k,) from the bin of each sector and from each yaw (facts 1 and 2)."""
        table, unit, _ = self._sector_table
        least = np.empty(len(rows), np.uint16)
        barrier = self._barrier(len(self._walls), self._yaws)
        least_costs(table.ravel(), table.shape[1], self._codes.sectors, rows, 1, barrier, least)
        return self._scores(least, unit, rows)

    def by_overlap(self, rows: Rows) -> Array:
        """Bounds (k,) from the bin of each sector, and from what both observed, counted at each yaw (fact 1)."""
        table, unit, seen = self._sector_table
        scores = np.empty(len(rows), np.float32)
        barrier = self._barrier(len(self._walls), self._yaws)
        best_scores(
            table.ravel(), table.shape[1], self._codes.sectors, rows, barrier, UNSEEN, seen,
            np.float32(unit), np.float32(_UNSEEN_COST), scores,
        )  # fmt: skip
        return scores.astype(np.float64) + _ROUNDING

    def _scores(self, least: NDArray[np.uint16], unit: float, rows: Rows) -> Array:
        """Fact 2: scores of the least costs ``E``."""
        query, stored = np.count_nonzero(self._observed), np.arange(len(self._walls) + 1)
        both, either = np.minimum(query, stored), np.maximum(query, stored)
        overlap = np.sqrt(np.sqrt(both / np.maximum(either, 1)))
        mean_of_none = 1.0 + _UNSEEN_COST * (query - both) / np.maximum(both, 1)
        loss = unit / np.maximum(both, 1)
        most = np.where(both > 0, overlap * mean_of_none + _ROUNDING, 0.0)
        seen = self._codes.seen[rows]
        return np.asarray(np.maximum(most[seen] - (overlap * loss)[seen] * least, 0.0))

    @cached_property
    def _sector_table(self) -> tuple[NDArray[np.uint16], float, NDArray[np.uint16]]:
        """Costs (codes, width) of a sector in a unit, the unit, and where (width,) the query observed something."""
        sectors = len(self._walls)
        unit = sectors / _MOST
        bins = np.arange(BINS + 1) / BINS
        costs = np.floor(self._costs(bins, bins + 1.0 / BINS) / unit).astype(np.uint16)
        offset = np.arange(sectors - 1, -_padded(sectors), -1) % sectors
        return costs.take(offset, axis=1), unit, self._observed[offset].astype(np.uint16)

    def _pattern_table(self) -> tuple[NDArray[np.uint8], float]:
        """Costs (patterns, width) of four sectors in a unit, and the unit."""
        sectors = len(self._walls)
        unit = max(4.0 / 255.0, sectors / _MOST)
        level = np.zeros((LEVELS, sectors))
        level[:-1] = self._costs(self._codes.level_from, self._codes.level_to)
        pair = (level[:, None] + np.roll(level, -1, axis=1)).reshape(LEVELS**2, sectors)
        pair = np.floor(pair / unit).astype(np.uint8)
        last = 2 * (self._codes.patterns.shape[1] - 1)
        offset = 2 * np.arange(last + 1, -_padded((sectors + 1) // 2), -1)
        pairs = self._codes.vocabulary[:, ::2] * np.uint8(LEVELS) + self._codes.vocabulary[:, 1::2]
        table = np.empty((len(pairs), len(offset) - 1), np.uint8)
        pattern_table(pair.take(offset % sectors, axis=1), pair.take((offset - 1) % sectors, axis=1), pairs, table)
        return table, unit

    def _costs(self, nearest: Array, farthest: Array) -> Array:
        """Least cost (k + 1, sectors) of walls in ranges (k,), and of an unobserved sector, at each of the query."""
        gap = np.maximum(nearest[:, None] - self._walls, self._walls - farthest[:, None])
        walls = 1.0 - self._agreement.at_most(np.maximum(gap, 0.0))
        return np.concatenate([walls, np.full((1, len(self._walls)), _UNSEEN_COST)]) * self._observed

    def _barrier(self, yaws: int, asked: Rows) -> NDArray[np.uint16]:
        barrier = np.full(_padded(yaws), _MOST, np.uint16)
        barrier[asked] = 0
        return barrier


def _padded(yaws: int) -> int:
    return -(-yaws // _LANES) * _LANES
