"""Live views against the map: the same invariant point and contour, from every side, in any frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_mine import SyntheticMine, straight, t_junction, y_junction

from descriptors.similarity import similarity
from maps.build import build_semantic_map
from maps.observe import ObservedIntersection, observe_intersections
from maps.prior_map import PriorMap
from maps.views import View
from semmap.geometry import Array, yaw_rotation
from semmap.intersections import Intersection

MINES = {
    "T": replace(t_junction(4.0, 3.0), slope=(0.06, -0.04), yaw=0.3),
    "Y": y_junction(5.0),
    "narrow": t_junction(2.5),
}


def mapped(mine: SyntheticMine) -> Intersection:
    cloud = mine.cloud()
    (intersection,) = build_semantic_map(PriorMap(cloud.astype(np.float32), np.zeros(3))).intersections
    return intersection


def approach(mine: SyntheticMine, bearing: float, *, ends_at: float) -> list[View]:
    """Five views a metre apart along a branch, the last ``ends_at`` metres from the middle."""
    c, s = np.cos(bearing), np.sin(bearing)
    return [mine.view((c * d, s * d), seed=int(10 * d) + 90) for d in ends_at + np.arange(5.0)[::-1]]


def moved(views: list[View], R: Array, t: Array) -> list[View]:
    """The views in another gravity-aligned frame."""
    return [View((view.points - t) @ R.T, R @ (view.p_sensor - t)) for view in views]


def best(observed: list[ObservedIntersection], p: Array) -> ObservedIntersection:
    assert observed
    return min(observed, key=lambda one: float(np.linalg.norm(one.p - p)))


@pytest.mark.parametrize("name", MINES)
@pytest.mark.parametrize("ends_at", [1.0, -1.0, -3.0])
def test_views_from_every_branch_give_the_maps_point_and_contour(name: str, ends_at: float) -> None:
    mine = MINES[name]
    place = mapped(mine)
    for k, bearing in enumerate(place.branch_bearings - mine.yaw):
        R, t = yaw_rotation(1.1 + k), place.p_map + [3.0, -2.0, 0.4]
        one = best(observe_intersections(moved(approach(mine, bearing, ends_at=ends_at), R, t)), R @ (place.p_map - t))
        assert np.linalg.norm((R.T @ one.p + t - place.p_map)[:2]) < 0.3
        assert abs((R.T @ one.p + t - place.p_map)[2]) < 0.3
        assert len(one.branch_bearings) == 3
        for by in ("pwcv", "cwc"):
            match = similarity(one.contour, place.contour, by=by)
            assert match.score > 0.8
            if name != "Y":
                assert abs(np.angle(np.exp(1j * (match.yaw + 1.1 + k)))) < np.radians(2.0)


def test_quality_is_the_share_of_directions_seen() -> None:
    mine = MINES["T"]
    observed = observe_intersections(approach(mine, 0.0, ends_at=-2.0))
    assert observed
    assert observed[0].quality == observed[0].contour.pwcv_observed.mean()
    assert [one.quality for one in observed] == sorted((one.quality for one in observed), reverse=True)
    assert observed[0].quality > 0.9


def test_an_intersection_far_ahead_is_not_yet_told_of() -> None:
    views = approach(t_junction(), 0.0, ends_at=13.0)
    assert all(np.linalg.norm(one.p[:2]) > 5.0 for one in observe_intersections(views))


def test_a_straight_roadway_shows_nothing() -> None:
    assert observe_intersections([straight().view((x, 0.0), seed=x + 9) for x in (-4, -2, 0)]) == []


@pytest.mark.parametrize(
    "views",
    [
        [],
        [View(np.zeros((0, 3)), np.zeros(3))],
        [View(np.random.default_rng(0).uniform(1.0, 5.0, (50, 3)), np.zeros(3))],
    ],
    ids=["none", "empty", "no floor"],
)
def test_views_without_a_floor_give_an_empty_list(views: list[View]) -> None:
    assert observe_intersections(views) == []


def test_readings_of_one_place_share_parts() -> None:
    mine = SyntheticMine(((-30, 0, 30, 0, 4.0), (-2.75, 0, -2.75, 25, 4.0), (2.75, 0, 2.75, -25, 4.0)))
    views = [mine.view((x, 0.0), seed=x + 9) for x in (-6, -4, -2, 0, 2, 4, 6)]
    readings = observe_intersections(views)
    assert sorted(one.kind for one in readings) == ["T", "T", "X"]
    whole = next(one for one in readings if one.kind == "X")
    assert all(one.parts <= whole.parts for one in readings)


def test_single_precision_points_do() -> None:
    mine = MINES["narrow"]
    views = [View(view.points.astype(np.float32), view.p_sensor) for view in approach(mine, 0.0, ends_at=-1.0)]
    assert np.linalg.norm(best(observe_intersections(views), np.zeros(3)).p[:2]) < 1.0
