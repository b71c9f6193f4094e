"""Views of intersections measured against a map: where their points are, and what they are similar to."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from descriptors.index import ContourIndex
from descriptors.settings import ContourSettings
from descriptors.similarity import Descriptor, similarity
from localize.settings import MatcherSettings
from maps.observe import ObservedIntersection, observe_intersections
from maps.settings import MapSettings
from semmap.geometry import Array, inverse, transform
from semmap.intersections import SemanticMap, WallContour
from tools.bench.scan_contexts import VARIANTS, ScanContexts
from tools.bench.views import Approach

_BOTH: tuple[Descriptor, ...] = ("pwcv", "cwc")
FOUND_M = 4.0
"""What is seen farther from the true place than this is another place, as for the matcher."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """v views of a map of n intersections.

    row : (v,) which one was approached. branch : (v,) by which. along : (v,) how far the last keyframe is past it [m].
    near : (v,) bool, all keyframes within eight metres of it.
    error, rise : (v,) horizontal and vertical distance of the point seen from the map's [m], inf where not seen.
    pwcv, cwc : (v, n) similarity of the view to each intersection, each at its best yaw; 0 where not seen.
    matched : (v,) row of the best CWC among the candidates by PWCV, as the matcher finds it; -1 without one.
    contexts : (v, variants, n) similarity by Scan Context.
    map_pwcv, map_cwc : (n, n) similarity of the map's intersections to one another.
    """

    row: NDArray[np.int64]
    branch: NDArray[np.int64]
    along: Array
    near: NDArray[np.bool_]
    error: Array
    rise: Array
    pwcv: Array
    cwc: Array
    matched: NDArray[np.int64]
    contexts: Array
    map_pwcv: Array
    map_cwc: Array


def measure(there: SemanticMap, views: Iterable[Approach]) -> Measured:
    """Look at every view and compare it with every intersection."""
    settings = MapSettings.model_validate(dict(there.settings))
    contours = [one.contour for one in there.intersections]
    index, contexts = ContourIndex(contours, settings.contour), ScanContexts(there)
    rows = [_measured(view, there, contours, index, contexts, settings) for view in views]
    table = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    pwcv, cwc = (np.array([_row(one, contours, settings.contour, by) for one in contours]) for by in _BOTH)
    return Measured(**table, map_pwcv=pwcv, map_cwc=cwc)


def _measured(
    view: Approach,
    there: SemanticMap,
    contours: list[WallContour],
    index: ContourIndex,
    contexts: ScanContexts,
    settings: MapSettings,
) -> dict[str, object]:
    true = transform(inverse(view.T_map_stack), there.intersections[view.row].p_map[None])[0]
    off = {one: float(np.hypot(*(one.p - true)[:2])) for one in observe_intersections(view.views, settings)}
    readings = sorted((one for one in off if off[one] < FOUND_M), key=lambda one: off[one])
    seen = readings[0] if readings else None
    return {
        "row": view.row,
        "branch": view.branch,
        "along": view.along,
        "near": view.wholly_near,
        "error": off[seen] if seen else np.inf,
        "rise": abs(seen.p[2] - true[2]) if seen else np.inf,
        "pwcv": _row(seen.contour, contours, settings.contour, "pwcv") if seen else np.zeros(len(contours)),
        "cwc": _row(seen.contour, contours, settings.contour, "cwc") if seen else np.zeros(len(contours)),
        "matched": _matched(readings, index),
        "contexts": contexts.similarities(view, seen),
    }


def _row(one: WallContour, contours: list[WallContour], settings: ContourSettings, by: Descriptor) -> Array:
    return np.array([similarity(one, other, settings, by=by).score for other in contours])


def _matched(readings: list[ObservedIntersection], index: ContourIndex) -> int:
    """What the matcher takes the place for, with nothing known of where it is."""
    m = MatcherSettings()
    tried = [index.turned(one.contour, m.min_pwcv, at_most=m.candidates) for one in readings]
    matches = max(tried, key=lambda found: max((match.pwcv for match in found), default=0.0), default=[])
    return max(matches, key=lambda match: match.cwc).row if matches else -1


def own_first(similarities: Array, row: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Views (v,) whose own intersection is more similar than every other one; similarities (v, n)."""
    views = np.arange(len(row))
    others = similarities.copy()
    others[views, row] = -1.0
    return np.asarray(similarities[views, row] > others.max(axis=1))


def own_and_other(similarities: Array, row: NDArray[np.int64]) -> tuple[Array, Array]:
    """Similarities (v,) of views to their own intersection, and (v * (n - 1),) to all others."""
    own = np.arange(similarities.shape[1]) == row[:, None]
    return similarities[own], similarities[~own]


def area_under_roc(similarities: Array, row: NDArray[np.int64]) -> float:
    """How often a pair of the same intersection is more similar than a pair of different ones."""
    own, other = own_and_other(similarities, row)
    ranks = rankdata(np.concatenate([own, other]))[: len(own)]
    return float((ranks.sum() - len(own) * (len(own) + 1) / 2) / (len(own) * len(other)))


def best_variant(measured: Measured, *, at_point: bool) -> int:
    """The variant of Scan Context that is right most often among those with one kind of centre."""
    right = [own_first(measured.contexts[:, k], measured.row).mean() for k in range(len(VARIANTS))]
    return max((k for k in range(len(VARIANTS)) if VARIANTS[k].at_point == at_point), key=lambda k: right[k])
