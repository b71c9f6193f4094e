"""Wall contours of a crossing that is known exactly: from a dense map and from five sparse views in each branch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from descriptors.settings import ContourSettings
from descriptors.similarity import Descriptor, completeness, similarity
from descriptors.wall_contour import ray_angles, wall_contour
from semmap.geometry import Array
from semmap.intersections import WallContour

SETTINGS = ContourSettings()
ROOF, SENSOR = 3.0, 1.3
BEARINGS = (0.0, np.pi, -0.5 * np.pi)
Inside = Callable[[Array], NDArray[np.bool_]]


def t_crossing(half: float, side: float) -> Inside:
    """A roadway along x and one that leaves it along -y, of these half widths [m]."""

    def inside(xy: Array) -> NDArray[np.bool_]:
        along = np.abs(xy[..., 1]) < half
        return np.asarray(along | ((np.abs(xy[..., 0]) < side) & (xy[..., 1] < half)))

    return inside


def to_wall(inside: Inside, p: Array, angle: Array, limit: float) -> Array:
    """Distances (n,) from ``p`` (2,) along angles (n,) to the rock, ``limit`` at most."""
    steps = np.arange(0.0, limit, 0.01)
    way = p + steps[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    blocked = ~inside(way)
    return np.asarray(np.where(blocked.any(axis=0), steps[blocked.argmax(axis=0)], limit))


def rim(inside: Inside, yaw: float) -> tuple[Array, Array]:
    """Directions and true distances (rays,) of what a look round from the crossing meets, its frame turned by yaw."""
    angle = ray_angles(SETTINGS)
    return angle, to_wall(inside, np.zeros(2), angle - yaw, SETTINGS.radius)


def dense(inside: Inside, yaw: float = 0.0) -> WallContour:
    """As a map has it: everything seen, points every 5 cm of height."""
    angle, distance = rim(inside, yaw)
    wall = distance < SETTINGS.radius
    plan = distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    height = np.arange(0.0, ROOF, 0.05)
    surface = np.column_stack([np.repeat(plan[wall], len(height), axis=0), np.tile(height, wall.sum())])
    return wall_contour(surface, distance, wall, SETTINGS)


def sparse(inside: Inside, bearing: float, last: float, yaw: float) -> WallContour:
    """As five keyframes of 16 beams have it that come in by a branch, the last ``last`` metres before the crossing."""
    sensors = [(last + back) * np.array([np.cos(bearing), np.sin(bearing)]) for back in range(5)]
    angle, distance = rim(inside, yaw)
    edge = (distance - 0.05)[:, None] * np.stack([np.cos(angle - yaw), np.sin(angle - yaw)], axis=-1)
    seen = np.any([in_sight(inside, sensor, edge) for sensor in sensors], axis=0)
    surface = np.concatenate([hits(inside, sensor) for sensor in sensors])
    R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    surface[:, :2] = surface[:, :2] @ R.T
    return wall_contour(
        surface, np.where(seen, distance, 0.5 * distance), seen & (distance < SETTINGS.radius), SETTINGS
    )


def in_sight(inside: Inside, sensor: Array, xy: Array) -> NDArray[np.bool_]:
    """Whether nothing but air lies between a sensor (2,) and points (n, 2)."""
    way = sensor + np.linspace(0.0, 1.0, 200)[:, None, None] * (xy - sensor)
    return np.asarray(inside(way).all(axis=0))


def hits(inside: Inside, sensor: Array) -> Array:
    """Points (n, 3) on the walls that 16 beams of 450 columns meet."""
    angle = 2.0 * np.pi * np.arange(450) / 450
    reach = to_wall(inside, sensor, angle, 25.0)
    height = SENSOR + reach[:, None] * np.tan(np.radians(np.linspace(-15.0, 15.0, 16)))
    met = (reach < 25.0)[:, None] & (height > 0.0) & (height < ROOF)
    plan = sensor + reach[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.column_stack([np.repeat(plan, 16, axis=0), height.ravel()])[met.ravel()]


CROSSINGS = {"narrow": t_crossing(1.4, 1.1), "wide": t_crossing(2.6, 2.0), "even": t_crossing(2.0, 2.0)}


@pytest.mark.parametrize("bearing", BEARINGS)
@pytest.mark.parametrize("name", CROSSINGS)
@pytest.mark.parametrize("by", ["pwcv", "cwc"])
def test_sparse_views_from_every_branch_are_like_the_dense_map(name: str, bearing: float, by: Descriptor) -> None:
    yaw = 0.7 + bearing
    maps = {other: dense(inside) for other, inside in CROSSINGS.items()}
    for last in (-3.0, 0.0, 3.0):
        view = sparse(CROSSINGS[name], bearing, last, yaw)
        match = similarity(view, maps[name], SETTINGS, by=by)
        assert match.score > 0.8
        assert_allclose(np.angle(np.exp(1j * (match.yaw + yaw))), 0.0, atol=np.radians(1.5))
        assert all(
            similarity(view, maps[other], SETTINGS, by=by).score < match.score for other in maps if other != name
        )


@pytest.mark.parametrize("bearing", BEARINGS)
def test_what_a_view_does_not_see_is_masked_and_what_it_sees_is_right(bearing: float) -> None:
    inside = CROSSINGS["wide"]
    whole, view = dense(inside), sparse(inside, bearing, 4.0, 0.0)
    assert whole.pwcv_observed.all()
    assert 0.5 < view.pwcv_observed.mean() < 1.0
    assert np.quantile(np.abs(view.pwcv - whole.pwcv)[view.pwcv_observed], 0.98) < 0.1
    assert not view.pwcv[~view.pwcv_observed].any()
    assert np.quantile(np.abs(view.cwc - whole.cwc)[view.cwc_observed], 0.98) < 0.35
    assert completeness(view, whole) == np.count_nonzero(view.pwcv) / np.count_nonzero(whole.pwcv)
    assert completeness(view, whole) < 1.0 == completeness(whole, whole)


def shifted(one: WallContour, sectors: int) -> WallContour:
    return WallContour(
        np.roll(one.pwcv, sectors),
        np.roll(one.pwcv_observed, sectors),
        np.roll(one.cwc, sectors, axis=1),
        np.roll(one.cwc_observed, sectors, axis=1),
    )


def by_definition(a: WallContour, b: WallContour, by: Descriptor) -> Array:
    """Scores (sectors,) of a turned by 0, 1, 2 … sectors against b: the formula, sector by sector."""
    out = []
    for turn in range(SETTINGS.sectors):
        t = shifted(a, turn)
        (da, ma), (db, mb) = ((getattr(c, by), getattr(c, f"{by}_observed")) for c in (t, b))
        wall_a, wall_b = (np.where(d > 0.0, np.minimum(d, SETTINGS.radius), SETTINGS.radius) for d in (da, db))
        agreement = np.exp(-0.5 * ((wall_a - wall_b) / SETTINGS.tolerance) ** 2)[ma & mb].mean()
        out.append(agreement * ((ma & mb).sum() / (ma | mb).sum()) ** 0.25)
    return np.array(out)


@pytest.mark.parametrize("by", ["pwcv", "cwc"])
def test_the_similarity_is_the_best_of_all_yaws_one_by_one(by: Descriptor) -> None:
    for a in (sparse(CROSSINGS["wide"], 0.0, 4.0, 0.4), dense(CROSSINGS["narrow"], 1.0)):
        for inside in CROSSINGS.values():
            b = dense(inside)
            scores, match = by_definition(a, b, by), similarity(a, b, SETTINGS, by=by)
            assert_allclose(match.score, scores.max(), atol=0.015)
            turn = round(match.yaw / (2.0 * np.pi) * SETTINGS.sectors) % SETTINGS.sectors
            assert scores[turn] > scores.max() - 0.02


def test_open_counts_against_a_wall_and_unobserved_does_not() -> None:
    whole = dense(CROSSINGS["even"])
    hidden = (whole.pwcv > 0.0) & (np.arange(SETTINGS.sectors) < 30)
    unseen = WallContour(whole.pwcv * ~hidden, whole.pwcv_observed & ~hidden, whole.cwc, whole.cwc_observed)
    opened = WallContour(whole.pwcv * ~hidden, whole.pwcv_observed, whole.cwc, whole.cwc_observed)
    same, blind, gone = (similarity(one, whole, SETTINGS) for one in (whole, unseen, opened))
    share = 1.0 - hidden.mean()
    assert_allclose(same.score, 1.0, atol=1e-5)
    assert_allclose(blind.score, share**0.25, atol=1e-3)
    assert_allclose(blind.overlap, share)
    assert gone.score < blind.score - 0.1
    assert_allclose([same.overlap, gone.overlap], 1.0)
