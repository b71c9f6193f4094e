"""All contours of a map side by side, to look one up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from descriptors.settings import ContourSettings
from descriptors.similarity import (
    Similarity,
    Spectrum,
    best_yaw,
    completeness,
    scores_by_yaw,
    spectrum,
    yaw_at,
)
from semmap.geometry import Array
from semmap.intersections import WallContour

_YAW_SLACK_SECTORS = 2
YAW_SLACK = 0.35
"""How far the yaw of a match may be from a known heading [rad]."""
_APART = 0.5
"""Yaws closer than this are one [rad]."""


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

    Parameters
    ----------
    contours : in the order of the map's intersections.
    settings : those the contours were made with.
    """

    def __init__(self, contours: Sequence[WallContour], settings: ContourSettings | None = None) -> None:
        self._settings = settings or ContourSettings()
        self._contours = tuple(contours)
        self._pwcv = _stacked([spectrum(contour, self._settings) for contour in contours])

    def __len__(self) -> int:
        return len(self._contours)

    def similarities(self, query: WallContour) -> Array:
        """PWCV similarity (n,) of the query to every contour, each at its best yaw."""
        if not self._contours:
            return np.zeros(0)
        scores, _ = scores_by_yaw(spectrum(query, self._settings), self._pwcv)
        return np.asarray(scores.max(axis=-1))

    def best(self, query: WallContour, k: int, allowed: NDArray[np.bool_] | None = None) -> list[Match]:
        """The ``k`` contours whose PWCV is most similar to the query's, best first; ties by row.

        allowed : (n,) bool, the rows to look at; all by default.
        """
        rows = np.arange(len(self)) if allowed is None else np.flatnonzero(allowed)
        if not len(rows) or k < 1:
            return []
        some = Spectrum(self._pwcv.harmonics[rows], self._pwcv.observed[rows])
        scores, overlaps = scores_by_yaw(spectrum(query, self._settings), some)
        order = np.argsort(-scores.max(axis=-1), kind="stable")[:k]
        query_cwc = spectrum(query, self._settings, "cwc")
        return [self._match(int(rows[i]), best_yaw(scores[i], overlaps[i]), query, query_cwc) for i in order]

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

        min_score : least PWCV similarity; at_most : matches returned.
        allowed : (n,) bool, the rows to look at; all by default.
        yaw : only yaws within `YAW_SLACK` of this [rad], where the heading is known.
        """
        rows = np.arange(len(self)) if allowed is None else np.flatnonzero(allowed)
        if not len(rows):
            return []
        some = Spectrum(self._pwcv.harmonics[rows], self._pwcv.observed[rows])
        scores, overlaps = scores_by_yaw(spectrum(query, self._settings), some)
        sectors = scores.shape[-1]
        if yaw is not None:
            off = 2.0 * np.pi * np.arange(sectors) / sectors - yaw
            scores = np.where(np.abs(np.angle(np.exp(1j * off))) < YAW_SLACK, scores, 0.0)
        window = 2 * round(_APART * sectors / (2.0 * np.pi)) + 1
        peak = (scores == maximum_filter1d(scores, window, axis=-1, mode="wrap")) & (scores >= min_score)
        found = np.argwhere(peak)
        order = np.argsort(-scores[peak], kind="stable")[:at_most]
        query_cwc = spectrum(query, self._settings, "cwc")
        return [
            self._match(int(rows[i]), yaw_at(scores[i], overlaps[i], int(s)), query, query_cwc) for i, s in found[order]
        ]

    def _match(self, row: int, pwcv: Similarity, query: WallContour, query_cwc: Spectrum) -> Match:
        contour = self._contours[row]
        scores, _ = scores_by_yaw(query_cwc, spectrum(contour, self._settings, "cwc"))
        turned = round(pwcv.yaw / (2.0 * np.pi) * len(scores))
        near = np.arange(turned - _YAW_SLACK_SECTORS, turned + _YAW_SLACK_SECTORS + 1) % len(scores)
        cwc = float(scores[near].max())
        return Match(row, pwcv.yaw, pwcv.score, cwc, pwcv.overlap, completeness(query, contour))


def _stacked(spectra: list[Spectrum]) -> Spectrum:
    if not spectra:
        return Spectrum(np.zeros((0, 1, 1, 1), np.complex64), np.zeros((0, 1, 1), np.complex64))
    return Spectrum(np.stack([one.harmonics for one in spectra]), np.stack([one.observed for one in spectra]))
