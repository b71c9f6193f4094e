"""All contours of a map side by side, to look one up: exactly, though of many only a few are scored."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from descriptors.bounds import Agreement, Bounds
from descriptors.codes import Codes
from descriptors.settings import ContourSettings
from descriptors.similarity import Descriptor, Spectrum, completeness, scores_by_yaw, spectrum, yaw_at
from semmap.geometry import Array
from semmap.intersections import WallContour

Rows = NDArray[np.int64]
Turns = Callable[[Array], NDArray[np.bool_]]
"""Picks from scores (k, sectors) by yaw those that are matches."""

_YAW_SLACK_SECTORS = 2
YAW_SLACK = 0.35
"""How far the yaw of a match may be from a known heading [rad]."""
_APART = 0.5
"""Yaws closer than this are one [rad]."""
_FIRST = 256
"""The contours most promising from afar are scored first: what they reach rules most others out."""
_AT_ONCE = 8
"""Contours scored before those left are held against what was found."""
_ABOVE_ZERO = float(np.finfo(np.float32).tiny)
"""Less similar contours have nothing in common and are no match."""
_BLOCK = 256
"""Contours whose spectra are in memory at a time."""


@dataclass(frozen=True, slots=True)
class Match:
    """A contour of the index that may be the one asked for.

    row : which contour of the index.
    yaw : rotation about z [rad] that takes the directions of the query to those of the match.
    pwcv : similarity of the PWCVs at that yaw.
    cwc : similarity of the CWCs at that yaw, give or take two sectors.
    overlap : share of the sectors that both observed.
    completeness : share of the match's walls that the query shows (paper 004, Eq. 32).
    """

    row: int
    yaw: float
    pwcv: float
    cwc: float
    overlap: float
    completeness: float


class ContourIndex:
    """Wall contours of a map, made with the same settings, ready for queries.

    Answers are those of scoring every contour, to the last bit. Most are ruled out by upper bounds of their scores
    instead (`descriptors.bounds`), for which the index keeps 190 bytes a contour of 120 sectors.

    Parameters
    ----------
    contours : in the order of the map's intersections, one by one or stacked; stacked ones are not copied.
    settings : those the contours were made with.
    """

    def __init__(self, contours: WallContour | Sequence[WallContour], settings: ContourSettings | None = None) -> None:
        self._settings = settings or ContourSettings()
        self._contours = contours if isinstance(contours, WallContour) else WallContour.stacked(contours)
        self._codes = Codes.of(self._contours, self._settings)
        self._agreement = Agreement(self._settings)

    def __len__(self) -> int:
        return len(self._contours.pwcv)

    def similarities(self, query: WallContour, by: Descriptor = "pwcv") -> Array:
        """Similarity (n,) of the query to every contour, each at its best yaw; of m stacked queries (m, n)."""
        of_query, queries = spectrum(query, self._settings, by), query.pwcv.shape[:-1]
        best = np.zeros((*queries, len(self)))
        for k in range(0, len(self), _BLOCK):
            block = spectrum(self._contours.at(slice(k, k + _BLOCK)), self._settings, by)
            for one in np.ndindex(queries):
                scores, _ = scores_by_yaw(Spectrum(of_query.harmonics[one], of_query.observed[one]), block)
                best[one][k : k + _BLOCK] = scores.max(axis=-1)
        return best

    def best(self, query: WallContour, k: int, allowed: NDArray[np.bool_] | None = None) -> list[Match]:
        """The ``k`` contours whose PWCV is most similar to the query's, best first; ties by row.

        Fewer than ``k`` where the similarity of the others is 0.

        allowed : (n,) bool, the rows to look at; all by default.
        """
        return self._found(query, _best_turn, _Best(k, 0.0), np.ones(len(query.pwcv), np.bool_), allowed)

    def turned(
        self,
        query: WallContour,
        min_score: float,
        *,
        at_most: int,
        allowed: NDArray[np.bool_] | None = None,
        yaw: float | None = None,
    ) -> list[Match]:
        """Contours and the yaws at which the query is like them, best first: a symmetric crossing comes several times.

        min_score : least PWCV similarity; at_most : matches returned; ties by row, then by yaw from 0 up.
        allowed : (n,) bool, the rows to look at; all by default.
        yaw : only yaws within `YAW_SLACK` of this [rad], where the heading is known.
        """
        off = 2.0 * np.pi * np.arange(len(query.pwcv)) / len(query.pwcv) - (yaw or 0.0)
        yaws = (np.abs(np.angle(np.exp(1j * off))) < YAW_SLACK) | (yaw is None)
        return self._found(query, _peaks, _Best(at_most, min_score), yaws, allowed)

    def _found(
        self, query: WallContour, turns: Turns, best: _Best, yaws: NDArray[np.bool_], allowed: NDArray[np.bool_] | None
    ) -> list[Match]:
        """The best matches at some of the ``yaws`` (sectors,)."""
        rows = np.arange(len(self)) if allowed is None else np.flatnonzero(allowed)
        if not len(rows) or best.at_most < 1:
            return []
        of_query = spectrum(query, self._settings)
        bounds = Bounds(self._codes, self._agreement, query, self._settings, yaws)
        for some in _promising(bounds, rows, best):
            scores, overlaps = scores_by_yaw(of_query, spectrum(self._contours.at(some), self._settings))
            scores = np.where(yaws, scores, 0.0)
            best.add(some, scores, overlaps, turns(scores) & yaws)
        return self._matches(query, best.found) if best.found else []

    def _matches(self, query: WallContour, found: list[_Turned]) -> list[Match]:
        contours = self._contours.at(np.array([one.row for one in found]))
        of_query, stored = spectrum(query, self._settings, "cwc"), spectrum(contours, self._settings, "cwc")
        by_cwc, _ = scores_by_yaw(of_query, stored)
        return [_match(one, by_cwc[k], completeness(query, contours.at(k))) for k, one in enumerate(found)]


def _match(one: _Turned, by_cwc: Array, complete: float) -> Match:
    pwcv = yaw_at(one.scores, one.overlaps, one.turn)
    turned = round(pwcv.yaw / (2.0 * np.pi) * len(by_cwc))
    near = np.arange(turned - _YAW_SLACK_SECTORS, turned + _YAW_SLACK_SECTORS + 1) % len(by_cwc)
    return Match(one.row, pwcv.yaw, pwcv.score, float(by_cwc[near].max()), pwcv.overlap, complete)


@dataclass(frozen=True, slots=True, eq=False)
class _Turned:
    """A contour, by how many sectors the query is turned, and the scores and overlaps (sectors,) at every turn."""

    row: int
    turn: int
    scores: Array
    overlaps: Array

    def __lt__(self, other: _Turned) -> bool:
        """Whether it is the better match."""
        return self._rank() < other._rank()

    def _rank(self) -> tuple[float, int, int]:
        return -float(self.scores[self.turn]), self.row, self.turn


class _Best:
    """The best matches found so far, in order, and ``least``: the score another one needs."""

    def __init__(self, at_most: int, least: float) -> None:
        self.at_most = at_most
        self.least = max(least, _ABOVE_ZERO)
        self.found: list[_Turned] = []

    def add(self, rows: Rows, scores: Array, overlaps: Array, turns: NDArray[np.bool_]) -> None:
        """Those of the scores (k, sectors) of some contours that ``turns`` marks."""
        marked = np.argwhere(turns & (scores >= self.least))
        found = [_Turned(int(rows[k]), int(turn), scores[k], overlaps[k]) for k, turn in marked]
        self.found = sorted(self.found + found)[: self.at_most]
        if len(self.found) == self.at_most:
            last = self.found[-1]
            self.least = float(last.scores[last.turn])


def _promising(bounds: Bounds, rows: Rows, best: _Best) -> Iterator[Rows]:
    """Contours that may be among the best, a few at a time, until by what was found meanwhile no other may."""
    if len(rows) > _FIRST:
        most = bounds.by_pattern(rows)
        order = np.argpartition(-most, _FIRST)
        yield from _ranked(bounds, rows[order[:_FIRST]], best)
        others = order[_FIRST:]
        rows = rows[others[most[others] >= best.least]]
    yield from _ranked(bounds, rows, best)


def _ranked(bounds: Bounds, rows: Rows, best: _Best) -> Iterator[Rows]:
    rows = rows[bounds.by_sector(rows) >= best.least]
    most = bounds.by_overlap(rows)
    order = np.argsort(-most)
    for k in range(0, len(order), _AT_ONCE):
        some = order[k : k + _AT_ONCE]
        some = some[most[some] >= best.least]
        if not len(some):
            return
        yield rows[some]


def _best_turn(scores: Array) -> NDArray[np.bool_]:
    """The first of the highest scores of each contour."""
    return np.asarray(np.arange(scores.shape[1]) == scores.argmax(axis=1)[:, None])


def _peaks(scores: Array) -> NDArray[np.bool_]:
    """Scores that none within `_APART` is above."""
    window = 2 * round(_APART * scores.shape[1] / (2.0 * np.pi)) + 1
    return np.asarray(scores == maximum_filter1d(scores, window, axis=1, mode="wrap"))
