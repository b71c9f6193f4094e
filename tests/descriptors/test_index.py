"""The index against scoring every contour: the same rows, the same bits, the same order."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from random_contours import crossings, joined, oddities, rolled, stacked

from descriptors import index as index_module
from descriptors.index import YAW_SLACK, ContourIndex, Match
from descriptors.settings import ContourSettings
from descriptors.similarity import completeness, scores_by_yaw, similarity, spectrum
from semmap.geometry import Array
from semmap.intersections import WallContour

SETTINGS = ContourSettings(sectors=36, layers=2)


def all_scores(query: WallContour, contours: WallContour, settings: ContourSettings) -> Array:
    """Scores (n, sectors) of the query against every contour."""
    return scores_by_yaw(spectrum(query, settings), spectrum(contours, settings))[0]


def best_of_all(scores: Array, k: int, allowed: NDArray[np.bool_]) -> list[tuple[int, float]]:
    """Row and score of the k most similar, ties by row, without those that have nothing in common."""
    best = [(-float(one.max()), row) for row, one in enumerate(scores) if allowed[row] and one.max() > 0.0]
    return [(row, -score) for score, row in sorted(best)[:k]]


def peaks_of_all(
    scores: Array, least: float, at_most: int, allowed: NDArray[np.bool_], yaw: float | None
) -> list[tuple[int, int, float]]:
    """Row, turn and score of every yaw that none within half a radian is better than, one by one; ties by row, turn."""
    sectors = scores.shape[1]
    off = 2.0 * np.pi * np.arange(sectors) / sectors - (0.0 if yaw is None else yaw)
    asked = np.abs(np.angle(np.exp(1j * off))) < (4.0 if yaw is None else YAW_SLACK)
    reach = round(0.5 * sectors / (2.0 * np.pi))
    found = []
    for row in np.flatnonzero(allowed):
        for t in np.flatnonzero(asked & (scores[row] >= least) & (scores[row] > 0.0)):
            near = np.arange(t - reach, t + reach + 1) % sectors
            if scores[row, t] == scores[row, near][asked[near]].max():
                found.append((-float(scores[row, t]), int(row), int(t)))
    return [(row, t, -score) for score, row, t in sorted(found)[:at_most]]


def world(n: int, seed: int, settings: ContourSettings = SETTINGS) -> WallContour:
    """Crossings seen more or less, some of them twice or turned, and contours no mine has."""
    likely = crossings(max(n - n // 4, 1), settings, seed, hidden=0.5)
    odd = oddities(max(n // 8, 1), settings, seed + 1)
    again = rolled(likely.at(np.arange(max(n // 8, 1)) % len(likely.pwcv)), seed % settings.sectors)
    return joined(likely, again, odd, likely.at(np.arange(1)))


def asked(there: WallContour, seed: int, settings: ContourSettings = SETTINGS) -> list[WallContour]:
    """Contours of the map turned, in other rock and partly hidden; strangers; and nothing."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(len(there.pwcv), size=4)
    part = there.at(rows)
    rough = np.where(part.pwcv > 0.0, part.pwcv + rng.normal(0.0, 0.15, part.pwcv.shape), 0.0)
    hidden = rng.uniform(size=rough.shape) < 0.2
    same = stacked(np.maximum(rough, 0.0), part.pwcv_observed & ~hidden, settings)
    others = joined(crossings(2, settings, seed + 5, hidden=0.5), oddities(4, settings, seed + 6))
    blind = stacked(np.zeros((1, settings.sectors)), np.zeros((1, settings.sectors), np.bool_), settings)
    queries = joined(rolled(same, 5), others, blind)
    return [there.at(int(rows[0])), *(queries.at(k) for k in range(len(queries.pwcv)))]


@pytest.mark.parametrize("n", [1, 2, 30, 300, 900])
def test_best_is_the_exhaustive_search(n: int) -> None:
    rng = np.random.default_rng(n)
    there = world(n, n)
    index = ContourIndex(there, SETTINGS)
    for number, query in enumerate(asked(there, n + 1)):
        scores = all_scores(query, there, SETTINGS)
        allowed = np.ones(len(index), np.bool_) if number % 2 else rng.uniform(size=len(index)) < 0.5
        for k in (1, 5, 20, 2000):
            matches = index.best(query, k, None if number % 2 else allowed)
            assert [(match.row, match.pwcv) for match in matches] == best_of_all(scores, k, allowed)
        assert_array_equal(index.similarities(query), scores.max(axis=1))


@pytest.mark.parametrize(("n", "least", "yaw"), [(30, 0.0, None), (300, 0.7, None), (900, 0.4, 1.0), (900, 0.6, None)])
def test_turned_is_the_exhaustive_search(n: int, least: float, yaw: float | None) -> None:
    rng = np.random.default_rng(n)
    there = world(n, n)
    index = ContourIndex(there, SETTINGS)
    for number, query in enumerate(asked(there, n + 2)):
        scores = all_scores(query, there, SETTINGS)
        allowed = np.ones(len(index), np.bool_) if number % 2 else rng.uniform(size=len(index)) < 0.5
        for at_most in (1, 5, 50):
            matches = index.turned(query, least, at_most=at_most, allowed=None if number % 2 else allowed, yaw=yaw)
            expected = peaks_of_all(scores, least, at_most, allowed, yaw)
            assert [(match.row, match.pwcv) for match in matches] == [(row, score) for row, _, score in expected]
            turns = [t * 2.0 * np.pi / SETTINGS.sectors for _, t, _ in expected]
            off = np.abs(np.angle(np.exp(1j * (np.array([match.yaw for match in matches]) - turns))))
            assert (off <= np.pi / SETTINGS.sectors + 1e-6).all()


@pytest.mark.parametrize("settings", [
    ContourSettings(sectors=9, layers=1, tolerance=3.0),
    ContourSettings(sectors=90, layers=1, radius=20.0, tolerance=0.3),
    ContourSettings(layers=1),
])  # fmt: skip
def test_no_default_is_needed(settings: ContourSettings) -> None:
    there = world(400, 11, settings)
    index = ContourIndex(there, settings)
    everywhere = np.ones(len(index), np.bool_)
    for query in asked(there, 12, settings):
        expected = best_of_all(all_scores(query, there, settings), 7, everywhere)
        assert [(match.row, match.pwcv) for match in index.best(query, 7)] == expected


def test_similarities_of_stacked_queries_are_those_of_each() -> None:
    there, queries = world(300, 13), crossings(3, SETTINGS, 14, hidden=0.5)
    index = ContourIndex(there, SETTINGS)
    together = index.similarities(queries)
    assert_array_equal(together, [index.similarities(queries.at(k)) for k in range(3)])
    for k in range(3):
        assert_array_equal(together[k], all_scores(queries.at(k), there, SETTINGS).max(axis=1))


def test_similarities_are_by_the_cwc_if_asked() -> None:
    there, query = world(20, 13), crossings(1, SETTINGS, 14, hidden=0.5).at(0)
    found = ContourIndex(there, SETTINGS).similarities(query, "cwc")
    assert_array_equal(found, [similarity(query, there.at(k), SETTINGS, by="cwc").score for k in range(20)])


def test_equal_contours_come_in_the_order_of_their_rows() -> None:
    one, other = crossings(2, SETTINGS, 1).at(0), crossings(2, SETTINGS, 1).at(1)
    index = ContourIndex([other, one, one, other, one] * 70, SETTINGS)
    matches = index.best(rolled(one, 7), 4)
    assert [match.row for match in matches] == [1, 2, 4, 6]
    assert len({match.pwcv for match in matches}) == 1


def test_a_match_tells_all_about_it() -> None:
    there = crossings(40, SETTINGS, 2, hidden=0.3)
    query = rolled(crossings(40, SETTINGS, 2, hidden=0.5).at(17), 11)
    for match in ContourIndex(there, SETTINGS).best(query, 5):
        alone = similarity(query, there.at(match.row), SETTINGS)
        assert (match.pwcv, match.yaw, match.overlap) == (alone.score, alone.yaw, alone.overlap)
        assert match.completeness == completeness(query, there.at(match.row))
        assert match.cwc <= similarity(query, there.at(match.row), SETTINGS, by="cwc").score


def test_a_turned_query_finds_the_same_places_turned() -> None:
    there = crossings(500, SETTINGS, 3, hidden=0.3)
    index = ContourIndex(there, SETTINGS)
    query = crossings(1, SETTINGS, 4, hidden=0.4).at(0)
    still = index.best(query, 5)
    for sectors in (1, 10, 35):
        matches = index.best(rolled(query, sectors), 5)
        assert [match.row for match in matches] == [match.row for match in still]
        for a, b in zip(matches, still, strict=True):
            assert_allclose([a.pwcv, a.cwc], [b.pwcv, b.cwc], atol=1e-5)
            turned = np.exp(1j * (b.yaw - a.yaw - 2.0 * np.pi * sectors / SETTINGS.sectors))
            assert_allclose(turned, 1.0, atol=1e-3)


def symmetric() -> WallContour:
    """A crossing that looks the same from both ends."""
    walls = 4.0 + 2.0 * np.cos(4.0 * np.pi * np.arange(SETTINGS.sectors) / SETTINGS.sectors)
    return stacked(walls[None], np.ones((1, SETTINGS.sectors), np.bool_), SETTINGS).at(0)


def test_a_symmetric_crossing_comes_at_both_yaws() -> None:
    index = ContourIndex([crossings(1, SETTINGS, 1).at(0), symmetric()], SETTINGS)
    query = rolled(symmetric(), 10)
    matches = index.turned(query, 0.9, at_most=5)
    assert [match.row for match in matches] == [1, 1]
    expected = -2.0 * np.pi * 10 / SETTINGS.sectors
    cosines = sorted(float(np.cos(match.yaw - expected)) for match in matches)
    assert_allclose(cosines, [-1.0, 1.0], atol=1e-5)
    (match,) = index.turned(query, 0.9, at_most=5, yaw=expected + 0.1)
    assert_allclose(match.yaw, expected, atol=1e-3)
    assert len(index.turned(query, 0.9, at_most=1)) == 1
    assert index.turned(query, 0.9, at_most=5, allowed=np.array([True, False])) == []


def test_stacked_contours_are_as_good_as_single_ones() -> None:
    there, query = crossings(20, SETTINGS, 5), crossings(1, SETTINGS, 6).at(0)
    of_stack, of_list = ContourIndex(there, SETTINGS), ContourIndex([there.at(k) for k in range(20)], SETTINGS)
    assert of_stack.best(query, 9) == of_list.best(query, 9)


def test_an_index_of_stacked_contours_keeps_two_hundred_bytes_of_each() -> None:
    there = crossings(2000, ContourSettings(layers=5), 12)
    tracemalloc.start()
    try:
        index = ContourIndex(there)
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(index) == 2000
    assert kept < 2000 * 200 + 100_000


def test_of_many_contours_few_are_scored(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = ContourSettings(layers=1)
    there = crossings(3000, settings, 7, hidden=0.2)
    index = ContourIndex(there, settings)
    scored = []

    def counted(contours: WallContour, *rest: object) -> object:
        scored.append(1 if contours.pwcv.ndim == 1 else len(contours.pwcv))
        return spectrum(contours, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(index_module, "spectrum", counted)
    for seed in range(5):
        scored.clear()
        index.best(crossings(1, settings, 100 + seed, hidden=0.4).at(0), 5)
        assert sum(scored) < 300
    scored.clear()
    blind = np.zeros((1, settings.sectors))
    assert index.best(stacked(blind, blind > 0.0, settings).at(0), 5) == []
    assert sum(scored) < 3


def test_an_empty_index_has_nothing_to_offer() -> None:
    query = crossings(1, SETTINGS, 8).at(0)
    for nothing in ([], crossings(3, SETTINGS, 9).at(slice(0, 0))):
        index = ContourIndex(nothing, SETTINGS)
        assert len(index) == 0
        assert index.best(query, 3) == []
        assert index.turned(query, 0.5, at_most=3) == []
        assert_array_equal(index.similarities(query), [])


def test_none_asked_for_none_found() -> None:
    index = ContourIndex(crossings(5, SETTINGS, 10), SETTINGS)
    query = crossings(1, SETTINGS, 11).at(0)
    no_match: list[Match] = []
    assert index.best(query, 0) == no_match
    assert index.best(query, 3, np.zeros(5, np.bool_)) == no_match
