"""Similarity: its formula, its yaw, and what it does not see."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from descriptors.settings import ContourSettings
from descriptors.similarity import Descriptor, completeness, scores_by_yaw, similarity, spectrum
from semmap.geometry import Array
from semmap.intersections import WallContour

SETTINGS = ContourSettings(sectors=72, layers=3)


def contour(seed: int, *, seen: float = 1.0) -> WallContour:
    """A smooth random contour with some open sectors, of which the share ``seen`` was observed, in one stretch."""
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * np.arange(SETTINGS.sectors) / SETTINGS.sectors
    waves = sum(rng.normal() * np.cos(k * angle + rng.uniform(0, 7)) for k in range(1, 6))
    distance = np.clip(5.0 + 2.5 * waves, 1.2, None)
    distance[distance > SETTINGS.radius] = 0.0
    observed = np.roll(np.arange(SETTINGS.sectors) < seen * SETTINGS.sectors, int(rng.integers(SETTINGS.sectors)))
    layers = distance * (1.0 - 0.03 * np.arange(SETTINGS.layers)[:, None])
    layer_seen = np.repeat(observed[None], SETTINGS.layers, axis=0)
    return WallContour(
        np.where(observed, distance, 0.0).astype(np.float32),
        observed,
        np.where(layer_seen, layers, 0.0).astype(np.float32),
        layer_seen,
    )


def rolled(one: WallContour, sectors: int) -> WallContour:
    """What the same place shows to somebody turned: sector s of the old is sector s + sectors of the new."""
    return WallContour(
        np.roll(one.pwcv, sectors),
        np.roll(one.pwcv_observed, sectors),
        np.roll(one.cwc, sectors, axis=1),
        np.roll(one.cwc_observed, sectors, axis=1),
    )


def scores_one_by_one(a: WallContour, b: WallContour) -> Array:
    """Mean Gaussian agreement times overlap^(1/4) for a turned by every number of sectors, by the definition."""
    out = []
    for turn in range(SETTINGS.sectors):
        t = rolled(a, turn)
        both, either = t.pwcv_observed & b.pwcv_observed, t.pwcv_observed | b.pwcv_observed
        da, db = (np.where(c.pwcv > 0, np.minimum(c.pwcv, SETTINGS.radius), SETTINGS.radius) for c in (t, b))
        agreement = np.exp(-0.5 * ((da - db) / SETTINGS.tolerance) ** 2)[both]
        out.append(agreement.mean() * (both.sum() / either.sum()) ** 0.25 if both.any() else 0.0)
    return np.array(out)


@pytest.mark.parametrize("seen", [1.0, 0.6])
def test_all_yaws_at_once_are_the_formula_one_by_one(seen: float) -> None:
    for seed in range(4):
        a, b = contour(seed), contour(seed + 10, seen=seen)
        scores, _ = scores_by_yaw(spectrum(a, SETTINGS), spectrum(b, SETTINGS))
        assert_allclose(scores, scores_one_by_one(a, b), atol=0.015)


@pytest.mark.parametrize("by", ["pwcv", "cwc"])
@pytest.mark.parametrize("sectors", [0, 1, 7, 36, 71])
def test_the_yaw_takes_a_to_b(by: str, sectors: int) -> None:
    a = contour(1)
    match = similarity(a, rolled(a, sectors), SETTINGS, by=by)
    assert_allclose(match.score, 1.0, atol=1e-5)
    assert match.overlap == 1.0
    assert_allclose(np.exp(1j * match.yaw), np.exp(2j * np.pi * sectors / SETTINGS.sectors), atol=1e-3)
    assert -np.pi <= match.yaw < np.pi


def test_the_yaw_is_finer_than_a_sector() -> None:
    angle = 2.0 * np.pi * np.arange(72) / 72

    def of(turn: float) -> WallContour:
        pwcv = (5.0 + np.cos(angle - turn) + 0.7 * np.cos(3.0 * (angle - turn))).astype(np.float32)
        seen = np.ones(72, dtype=bool)
        return WallContour(pwcv, seen, np.repeat(pwcv[None], 3, axis=0), np.repeat(seen[None], 3, axis=0))

    for turn in np.radians([0.0, 1.1, 2.2, 3.7, 44.0]):
        assert abs(similarity(of(0.0), of(turn), SETTINGS).yaw - turn) < np.radians(0.3)


def test_similarity_is_symmetric_and_bounded() -> None:
    for seed in range(10):
        a, b = contour(seed), contour(seed + 50, seen=0.5 + 0.05 * seed)
        forth, back = similarity(a, b, SETTINGS), similarity(b, a, SETTINGS)
        assert_allclose(forth.score, back.score, atol=1e-5)
        assert_allclose(np.exp(1j * (forth.yaw + back.yaw)), 1.0, atol=1e-2)
        assert 0.0 <= forth.score <= 1.0


@pytest.mark.parametrize("by", ["pwcv", "cwc"])
def test_one_is_for_equal_contours_only(by: str) -> None:
    a = contour(3)
    nudged = WallContour(a.pwcv + np.float32(0.1), a.pwcv_observed, a.cwc + np.float32(0.1), a.cwc_observed)
    hidden = WallContour(a.pwcv, a.pwcv_observed & (np.arange(72) > 3), a.cwc, a.cwc_observed & (np.arange(72) > 3))
    for other in (nudged, hidden, contour(4)):
        assert similarity(a, other, SETTINGS, by=by).score < 0.997


def test_the_less_is_seen_of_the_same_place_the_lower_the_score() -> None:
    whole = contour(5)
    scores = []
    for seen in (1.0, 0.8, 0.5, 0.2):
        mask = np.arange(72) < 72 * seen
        part = WallContour(whole.pwcv * mask, mask, whole.cwc * mask, np.repeat(mask[None], 3, axis=0))
        scores.append(similarity(part, whole, SETTINGS).score)
        assert_allclose(scores[-1], seen**0.25, atol=0.01)
    assert scores == sorted(scores, reverse=True)


def test_nothing_seen_is_like_nothing() -> None:
    dark, darks = np.zeros(72, bool), np.zeros((3, 72), bool)
    blind = WallContour(dark.astype(np.float32), dark, darks.astype(np.float32), darks)
    assert similarity(blind, contour(1), SETTINGS).score == 0.0
    assert similarity(blind, blind, SETTINGS).score == 0.0


def test_completeness_counts_sectors_with_a_wall() -> None:
    whole = contour(6)
    half = WallContour(whole.pwcv * (np.arange(72) < 36), whole.pwcv_observed, whole.cwc, whole.cwc_observed)
    assert completeness(whole, whole) == 1.0
    assert completeness(half, whole) == np.count_nonzero(half.pwcv) / np.count_nonzero(whole.pwcv)
    assert completeness(whole, half) == 1.0
    blank = WallContour(0.0 * whole.pwcv, whole.pwcv_observed, whole.cwc, whole.cwc_observed)
    assert completeness(whole, blank) == 0.0


@pytest.mark.parametrize("by", ["pwcv", "cwc"])
def test_what_stands_beside_a_contour_does_not_change_its_scores(by: Descriptor) -> None:
    stack = WallContour.stacked([contour(seed, seen=0.5 + 0.02 * seed) for seed in range(21)])
    of_query = spectrum(contour(50, seen=0.7), SETTINGS, by)
    together = scores_by_yaw(of_query, spectrum(stack, SETTINGS, by))
    for rows in ([3], [0, 20], [5, 6, 7, 8], list(range(17))):
        some = scores_by_yaw(of_query, spectrum(stack.at(np.array(rows)), SETTINGS, by))
        assert_array_equal(some[0], together[0][rows])
        assert_array_equal(some[1], together[1][rows])
    for row in range(21):
        alone = scores_by_yaw(of_query, spectrum(stack.at(row), SETTINGS, by))
        assert_array_equal(alone[0], together[0][row])
