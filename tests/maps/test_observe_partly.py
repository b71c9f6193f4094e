"""Intersections of which five keyframes within eight metres show only a part: found, and at the map's point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from synthetic_mine import SyntheticMine, corner, t_junction, x_junction, y_junction

from descriptors.similarity import similarity
from maps.build import build_semantic_map
from maps.observe import observe_intersections
from maps.prior_map import PriorMap
from semmap.geometry import Array
from semmap.intersections import Intersection

MINES = {
    "T": replace(t_junction(4.0, 3.0), slope=(0.06, -0.04), yaw=0.3),
    "narrow T": t_junction(2.5),
    "Y": replace(y_junction(4.5), yaw=0.2),
    "X": replace(x_junction(3.6), yaw=-0.4),
}
CORNERS = {"corner": replace(corner(3.6, 90.0), yaw=0.5), "slight corner": corner(3.2, 68.0)}
PLACES: dict[str, Intersection] = {}


def place_in(name: str) -> Intersection:
    """The one intersection of a mine, from its dense cloud."""
    if name not in PLACES:
        prior = PriorMap((MINES | CORNERS)[name].cloud().astype(np.float32), np.zeros(3))
        (PLACES[name],) = build_semantic_map(prior).intersections
    return PLACES[name]


def in_by(mine: SyntheticMine, bearing: float, out: float, *, last: float) -> list[tuple[float, float]]:
    """Five places a metre apart on the way in by one branch and out by another, the last ``last`` metres past it."""

    def place(along: float) -> tuple[float, float]:
        angle = (bearing if along < 0.0 else out) - mine.yaw
        return abs(along) * float(np.cos(angle)), abs(along) * float(np.sin(angle))

    return [place(last - back) for back in (4.0, 3.0, 2.0, 1.0, 0.0)]


def off_and_scores(name: str, bearing: float, out: float, last: float) -> tuple[Array, float, float]:
    """How far the point seen lies from the map's (3,), and the similarity of PWCV and CWC; infinite where not seen."""
    mine, place = (MINES | CORNERS)[name], place_in(name)
    views = [mine.view(xy, seed=k) for k, xy in enumerate(in_by(mine, bearing, out, last=last))]
    observed = observe_intersections(views)
    if not observed:
        return np.full(3, np.inf), 0.0, 0.0
    one = min(observed, key=lambda one: float(np.linalg.norm(one.p - place.p_map)))
    pwcv, cwc = (similarity(one.contour, place.contour, by=by).score for by in ("pwcv", "cwc"))
    return one.p - place.p_map, pwcv, cwc


def check(name: str, last: float) -> None:
    bearings = place_in(name).branch_bearings
    for k, bearing in enumerate(bearings):
        off, pwcv, cwc = off_and_scores(name, bearing, bearings[k - 1], last)
        assert np.hypot(*off[:2]) < 0.5
        assert_allclose(off[2], 0.0, atol=0.3)
        assert pwcv > 0.7
        assert cwc > 0.6


@pytest.mark.parametrize("name", MINES)
@pytest.mark.parametrize("last", [-4.0, -1.0, 4.0, 8.0])
def test_the_point_is_the_maps_from_before_and_behind(name: str, last: float) -> None:
    check(name, last)


@pytest.mark.parametrize("name", CORNERS)
@pytest.mark.parametrize("last", [-3.0, -1.0, 4.0, 6.0])
def test_a_corner_is_the_maps_before_one_has_come_round(name: str, last: float) -> None:
    check(name, last)
