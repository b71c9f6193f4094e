"""Wall contours in a byte a sector, and in patterns of four sectors: what a search of a large map looks at first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from descriptors.settings import ContourSettings
from descriptors.similarity import relative_distance
from semmap.geometry import Array
from semmap.intersections import WallContour

BINS = 254
"""Bins of wall distances, all of one width."""
OPEN, UNSEEN = BINS, BINS + 1
"""Codes of a sector without a wall within the radius, and of one that was not observed."""
LEVELS = 16
"""Coarser codes of the sectors of a pattern: ranges of bins, and three that follow."""
LEVEL_OPEN, LEVEL_UNSEEN, LEVEL_NONE = LEVELS - 3, LEVELS - 2, LEVELS - 1
"""Open, not observed, and none: past the last sector."""
_BLOCK = 4096
"""Contours that are coded at a time."""


@dataclass(frozen=True, slots=True, eq=False)
class Codes:
    """Contours (n) as codes.

    sectors : (n, sectors) uint8: `OPEN`, `UNSEEN` or the bin b of a wall between b and b + 1 `BINS`-ths of the radius.
    patterns : (n, ceil(sectors / 4)) uint16: four neighbouring sectors as a row of ``vocabulary``.
    vocabulary : (m, 4) uint8: the levels of every pattern that occurs.
    level_from, level_to : (LEVEL_OPEN + 1,) wall distances that each level stands for [radii].
    seen : (n,) number of observed sectors.
    """

    sectors: NDArray[np.uint8]
    patterns: NDArray[np.uint16]
    vocabulary: NDArray[np.uint8]
    level_from: Array
    level_to: Array
    seen: NDArray[np.int64]

    @classmethod
    def of(cls, contours: WallContour, settings: ContourSettings) -> Codes:
        """Codes of stacked contours."""
        sectors = np.empty(contours.pwcv.shape, np.uint8)
        for rows in _blocks(len(sectors)):
            sectors[rows] = _coded(contours.pwcv[rows], contours.pwcv_observed[rows], settings)
        level = _levels(np.bincount(sectors.ravel(), minlength=BINS + 2)[:BINS])
        patterns, vocabulary = _patterns(level, sectors)
        bins = [np.flatnonzero(level == one) for one in range(LEVEL_OPEN + 1)]
        level_from = np.array([some.min(initial=BINS) / BINS for some in bins])
        level_to = np.array([(some.max(initial=0) + 1) / BINS for some in bins])
        return cls(sectors, patterns, vocabulary, level_from, level_to, (sectors != UNSEEN).sum(axis=1))


def _blocks(n: int) -> list[slice]:
    return [slice(k, k + _BLOCK) for k in range(0, n, _BLOCK)]


def _coded(pwcv: NDArray[np.float32], observed: NDArray[np.bool_], settings: ContourSettings) -> NDArray[np.uint8]:
    bins = np.floor(relative_distance(pwcv, settings) * BINS).astype(np.uint8)
    return np.where(observed, bins, np.uint8(UNSEEN))


def _levels(counts: NDArray[np.int64]) -> NDArray[np.uint8]:
    """The level (BINS + 2,) of each code; each level of walls stands for about as many of the walls counted."""
    before = np.cumsum(counts) - counts
    walls = LEVEL_OPEN * before // max(int(counts.sum()), 1)
    return np.concatenate([np.minimum(walls, LEVEL_OPEN - 1), [LEVEL_OPEN, LEVEL_UNSEEN]]).astype(np.uint8)


def _patterns(level: NDArray[np.uint8], sectors: NDArray[np.uint8]) -> tuple[NDArray[np.uint16], NDArray[np.uint8]]:
    """Each four sectors as a row of the vocabulary, and the vocabulary: patterns by their levels, those that occur."""
    n, count = sectors.shape
    numbers = np.empty((n, -(-count // 4)), np.uint16)
    for rows in _blocks(n):
        padded = np.pad(level[sectors[rows]], ((0, 0), (0, -count % 4)), constant_values=LEVEL_NONE)
        fours = padded.reshape(len(padded), -1, 4).astype(np.uint16)
        numbers[rows] = fours @ np.array([LEVELS**3, LEVELS**2, LEVELS, 1], np.uint16)
    occurs = np.zeros(LEVELS**4, np.bool_)
    occurs[numbers] = True
    place = np.cumsum(occurs) - 1
    which = np.flatnonzero(occurs)
    vocabulary = np.stack([which // LEVELS**power % LEVELS for power in (3, 2, 1, 0)], axis=-1)
    return place.astype(np.uint16)[numbers], vocabulary.astype(np.uint8)
