"""How alike the intersections of a map look, which can be taken for each other, and what tells them apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from descriptors.index import ContourIndex
from descriptors.settings import ContourSettings
from localize.settings import LocalizeSettings
from localize.verification import Verifier, start_of
from maps.settings import MapSettings
from semmap.geometry import Array
from semmap.intersections import SemanticMap, WallContour
from tools.progress import Advance
from tools.report.anchors import Proposal, propose_anchors
from tools.report.journeys import NEVER, passed_until_told, ways_of

WHOLE = 400
"""Maps of up to so many intersections are shown as whole matrices, larger ones by those most easily confused."""
_SHOWN = 200
_PARTNERS = 24
"""Look-alikes sought of each intersection among those after it."""
_TURNED = 4
"""An intersection may be like another at several turns."""
_CHECKED = 150
"""Pairs whose rock is compared."""


@dataclass(frozen=True, slots=True)
class LookAlike:
    """Two intersections that can be taken for each other.

    a, b : rows of the map. yaw : turn [rad] that lays a onto b. pwcv, cwc : similarities at it, in [0, 1].
    rock : likeness of their clouds after ICP, as the localizer measures it, NaN where it was not looked at.
    passed : more intersections a robot passes, at the worst, until their order tells; `journeys.NEVER`: it does not.
    """

    a: int
    b: int
    yaw: float
    pwcv: float
    cwc: float
    rock: float
    passed: int


@dataclass(frozen=True, slots=True)
class Level:
    """What is left when more and more is looked at: the pairs still alike, by number, and anchors for them."""

    name: str
    pairs: tuple[int, ...]
    anchors: Proposal


@dataclass(frozen=True, slots=True, eq=False)
class Likeness:
    """Of one map.

    rows : (m,) those of the matrices pwcv and cwc (m, m). pairs : most alike first. levels : see `Level`.
    capped : whether some intersection has more look-alikes than were sought.
    """

    rows: NDArray[np.int64]
    pwcv: Array
    cwc: Array
    pairs: tuple[LookAlike, ...]
    levels: tuple[Level, ...]
    capped: bool


def likeness_of(semantic_map: SemanticMap, settings: LocalizeSettings, progress: Advance | None = None) -> Likeness:
    """Compare every intersection with every other as the localizer would, by `LocalizeSettings`' thresholds."""
    contour = MapSettings.model_validate(dict(semantic_map.settings)).contour
    index = ContourIndex(semantic_map.contours, contour)
    found, capped = _alike(index, semantic_map, settings, progress)
    passed = passed_until_told(ways_of(semantic_map), {pair: yaw for pair, (yaw, _, _) in found.items()})
    ranked = sorted(found.items(), key=lambda one: (-one[1][1] - one[1][2], one[0]))
    rock = _rock(semantic_map, settings, [(a, b, yaw) for (a, b), (yaw, _, _) in ranked[:_CHECKED]])
    pairs = tuple(
        LookAlike(a, b, yaw, pwcv, cwc, rock.get((a, b), np.nan), passed[a, b]) for (a, b), (yaw, pwcv, cwc) in ranked
    )
    rows = _shown_rows(len(semantic_map), pairs)
    pwcv, cwc = _matrices(semantic_map.contours.at(rows), contour)
    return Likeness(rows, pwcv, cwc, pairs, _levels(semantic_map, pairs, settings), capped)


def _matrices(contours: WallContour, settings: ContourSettings) -> tuple[Array, Array]:
    """PWCV and CWC similarities (n, n) of some contours."""
    if not len(contours.pwcv):
        return np.zeros((0, 0)), np.zeros((0, 0))
    index = ContourIndex(contours, settings)
    return index.similarities(contours, "pwcv"), index.similarities(contours, "cwc")


Found = dict[tuple[int, int], tuple[float, float, float]]


def _alike(
    index: ContourIndex, semantic_map: SemanticMap, settings: LocalizeSettings, progress: Advance | None
) -> tuple[Found, bool]:
    """Pairs of rows whose PWCV are similar enough to be matched: yaw, PWCV and CWC similarity of each."""
    least, found, capped = settings.matcher.min_pwcv, Found(), False
    rows, contours = np.arange(len(semantic_map)), semantic_map.contours
    for row in range(len(semantic_map)):
        matches = index.turned(contours.at(row), least, at_most=_TURNED * _PARTNERS, allowed=rows > row)
        capped |= len(matches) == _TURNED * _PARTNERS
        for match in matches:
            known = found.get((row, match.row))
            if known is None or match.pwcv + match.cwc > known[1] + known[2]:
                found[row, match.row] = (match.yaw, match.pwcv, match.cwc)
        if progress is not None:
            progress(row + 1, len(semantic_map))
    return found, capped


def _rock(
    semantic_map: SemanticMap, settings: LocalizeSettings, pairs: Sequence[tuple[int, int, float]]
) -> dict[tuple[int, int], float]:
    """Likeness of the clouds of pairs of rows, registered by the localizer's own check from a turn by yaw."""
    verifier, likeness = Verifier(settings.verification), {}
    for a, b, yaw in pairs:
        one, other = semantic_map.intersections[a], semantic_map.intersections[b]
        points = verifier.around(one.cloud, np.zeros(3))
        if len(points) < settings.verification.min_points or not len(other.cloud):
            continue
        T, _ = verifier.first_look(points, other, start_of(np.zeros(3), yaw))
        likeness[a, b] = verifier.verify(points, other, T).likeness
    return likeness


def _shown_rows(n: int, pairs: Sequence[LookAlike]) -> NDArray[np.int64]:
    if n <= WHOLE:
        return np.arange(n)
    rows = list(dict.fromkeys(row for pair in pairs for row in (pair.a, pair.b)))[:_SHOWN]
    return np.array(sorted(rows or range(_SHOWN)), np.int64)


def _levels(semantic_map: SemanticMap, pairs: Sequence[LookAlike], settings: LocalizeSettings) -> tuple[Level, ...]:
    """From the first glance on: what each further thing that is looked at leaves."""
    cwc, rock = settings.matcher.min_cwc, settings.proof.no_likeness
    ids: Mapping[int, int] = dict(enumerate(semantic_map.columns.id.tolist()))
    steps = {
        "PWCV": lambda pair: True,
        "PWCV and CWC": lambda pair: pair.cwc >= cwc,
        "and the order of intersections": lambda pair: pair.cwc >= cwc and pair.passed >= NEVER,
        "and the rock itself (ICP)": lambda pair: pair.cwc >= cwc and pair.passed >= NEVER and not pair.rock < rock,
    }
    levels = []
    for name, alike in steps.items():
        left = tuple(number for number, pair in enumerate(pairs) if alike(pair))
        proposal = propose_anchors((ids[pairs[k].a], ids[pairs[k].b]) for k in left)
        levels.append(Level(name, left, proposal))
    return tuple(levels)


def told_by(pair: LookAlike, settings: LocalizeSettings) -> str:
    """What tells a pair apart, in words."""
    told = []
    if pair.cwc < settings.matcher.min_cwc:
        told.append("CWC")
    if pair.passed == 1:
        told.append("the next intersection")
    elif pair.passed < NEVER:
        told.append(f"the next {pair.passed} intersections")
    if pair.rock < settings.proof.no_likeness:
        told.append("the rock")
    return ", ".join(told) or "nothing here: an anchor would"
