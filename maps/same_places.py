"""Which intersections of two surveys of one mine are the same, and how the surveys lie to each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from descriptors.settings import ContourSettings
from descriptors.similarity import scores_by_yaw, spectrum
from semmap.geometry import Array
from semmap.intersections import IntersectionTable, WallContour

_SURE = 0.8
"""Two different intersections are not this similar with north kept north: such pairs tell the shift."""
_SLACK_SECTORS = 2
_MIN_PAIRS = 3
_SIGMA_OF_MAD = 1.4826
_RASTER_STD_M = 0.05
"""What the cells that invariant points are found on add to the error of all of them alike [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Shift:
    """How survey B lies to survey A: ``offset`` (3,) = A - B, ``std`` (3,) of it, from so many ``pairs`` [m]."""

    offset: Array
    std: Array
    pairs: int

    @property
    def significant(self) -> bool:
        """Whether it is more than chance."""
        return bool(np.any(np.abs(self.offset) > 3.0 * self.std))


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Intersections of A and of B, by row, that are near each other.

    row_a, row_b : (n,). offset : (n, 3) A - B [m]. similarity : (n,) of the CWCs, with north kept north.
    """

    row_a: NDArray[np.int64]
    row_b: NDArray[np.int64]
    offset: Array
    similarity: Array

    def where(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Candidates:
        """Some of them."""
        return Candidates(self.row_a[chosen], self.row_b[chosen], self.offset[chosen], self.similarity[chosen])


def candidates(a: IntersectionTable, b: IntersectionTable, radius: float, settings: ContourSettings) -> Candidates:
    """All pairs not farther apart than ``radius`` [m]."""
    p_a, p_b = a.columns.p_map, b.columns.p_map
    near = cKDTree(p_a).query_ball_point(p_b, radius) if len(p_a) and len(p_b) else []
    rows = [(i, j) for j, some in enumerate(near) for i in sorted(some)]
    row_a, row_b = np.array(rows, np.int64).reshape(-1, 2).T
    similarity = [_similarity(a.contours.at(i), b.contours.at(j), settings) for i, j in rows]
    return Candidates(row_a, row_b, p_a[row_a] - p_b[row_b], np.array(similarity, np.float64))


def _similarity(a: WallContour, b: WallContour, settings: ContourSettings) -> float:
    """Similarity of two CWCs that need not be turned, give or take two sectors."""
    scores, _ = scores_by_yaw(spectrum(a, settings, "cwc"), spectrum(b, settings, "cwc"))
    return float(np.roll(scores, _SLACK_SECTORS)[: 2 * _SLACK_SECTORS + 1].max())


def shift_between(near: Candidates, limit: float) -> Shift | None:
    """Median offset of the pairs nearer than ``limit`` [m] that surely are the same; None of fewer than three."""
    apart = np.linalg.norm(near.offset, axis=1)
    sure = one_to_one(near.where((near.similarity > _SURE) & (apart < limit)), limit)
    count = len(sure.row_a)
    if count < _MIN_PAIRS:
        return None
    offset = np.median(sure.offset, axis=0)
    spread = _SIGMA_OF_MAD * np.median(np.abs(sure.offset - offset), axis=0)
    return Shift(offset, np.hypot(spread / np.sqrt(count), _RASTER_STD_M), count)


def one_to_one(near: Candidates, scale: float) -> Candidates:
    """Of pairs that share an intersection the one that is most alike and nearest, in the order of A.

    scale : a pair this far apart [m] must be more alike by a half.
    """
    worth = near.similarity - 0.5 * np.linalg.norm(near.offset, axis=1) / scale
    chosen, taken_a, taken_b = [], set[int](), set[int]()
    for k in np.argsort(-worth, kind="stable").tolist():
        i, j = int(near.row_a[k]), int(near.row_b[k])
        if i not in taken_a and j not in taken_b:
            taken_a.add(i)
            taken_b.add(j)
            chosen.append(k)
    rows = np.array(chosen, np.int64)
    return near.where(rows[np.argsort(near.row_a[rows])])
