"""What rules contours out must never rule out a match: bounds against scores, kernels against plain numpy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray
from random_contours import crossings, joined, oddities, rolled

from descriptors._numba_bounds import best_scores, least_costs, pattern_table
from descriptors.bounds import Agreement, Bounds
from descriptors.codes import BINS, LEVEL_NONE, LEVEL_UNSEEN, OPEN, UNSEEN, Codes
from descriptors.settings import ContourSettings
from descriptors.similarity import kernel_power, scores_by_yaw, spectrum
from semmap.geometry import Array
from semmap.intersections import WallContour

SHAPES = [
    ContourSettings(layers=1),
    ContourSettings(layers=1, sectors=8, tolerance=0.2),
    ContourSettings(layers=1, sectors=45, tolerance=2.0),
    ContourSettings(layers=1, sectors=73, radius=30.0, tolerance=0.5),
    ContourSettings(layers=1, sectors=66, radius=5.0, tolerance=20.0),
]
"""Sectors that patterns and pairs of yaws divide and do not; agreement that is keen and that is dull."""


def bounds_of(
    query: WallContour, contours: WallContour, settings: ContourSettings, yaws: NDArray[np.bool_]
) -> tuple[Array, ...]:
    """Bounds from patterns, from sectors and from overlaps (n,) each, and the best scores (n,)."""
    rows = np.arange(len(contours.pwcv))
    bounds = Bounds(Codes.of(contours, settings), Agreement(settings), query, settings, yaws)
    scores, _ = scores_by_yaw(spectrum(query, settings), spectrum(contours, settings))
    return bounds.by_pattern(rows), bounds.by_sector(rows), bounds.by_overlap(rows), scores[:, yaws].max(axis=1)


@pytest.mark.parametrize("settings", SHAPES, ids=lambda one: f"{one.sectors} sectors")
def test_no_score_is_above_its_bounds(settings: ContourSettings) -> None:
    rng = np.random.default_rng(settings.sectors)
    likely = crossings(60, settings, 1, hidden=0.6)
    contours = joined(likely, oddities(140, settings, 2))
    queries = joined(crossings(12, settings, 3, hidden=0.7), oddities(28, settings, 4))
    views = [queries.at(k) for k in range(40)] + [rolled(contours.at(k), k) for k in range(0, 200, 8)]
    for k, query in enumerate(views):
        yaws = rng.uniform(size=settings.sectors) < 0.1 if k % 3 else np.ones(settings.sectors, np.bool_)
        yaws[k % settings.sectors] = True
        *bounds, score = bounds_of(query, contours, settings, yaws)
        for bound in bounds:
            assert (bound >= score).all()


def test_bounds_are_near_the_scores_of_crossings() -> None:
    settings = SHAPES[0]
    contours, query = crossings(200, settings, 5, hidden=0.4), crossings(1, settings, 6, hidden=0.6).at(0)
    by_pattern, by_sector, by_overlap, score = bounds_of(query, contours, settings, np.ones(120, np.bool_))
    assert np.median(by_pattern - score) < 0.25
    assert np.median(by_sector - score) < 0.2
    assert np.median(by_overlap - score) < 0.02
    assert (by_overlap < by_sector + 1e-4).all()


@pytest.mark.parametrize("settings", SHAPES, ids=lambda one: f"{one.tolerance} of {one.radius} m")
def test_agreement_is_not_above_its_bound(settings: ContourSettings) -> None:
    gap = np.linspace(0.0, 1.0, 200_001)
    power = kernel_power(settings)
    kernel = np.sum([p * np.cos(np.pi * wave * gap) for wave, p in enumerate(power)], axis=0)
    most = Agreement(settings).at_most(gap)
    assert (most >= np.maximum.accumulate(kernel[::-1])[::-1] - 1e-12).all()
    assert (most <= 1.0).all() and (np.diff(most) <= 0.0).all()
    assert np.abs(most - kernel).max() < 0.05


def test_codes_say_in_which_range_a_wall_is() -> None:
    settings = ContourSettings(layers=1, sectors=26, radius=9.0)
    contours = joined(crossings(5000, settings, 7, hidden=0.5), oddities(500, settings, 8))
    codes = Codes.of(contours, settings)
    assert_array_equal(codes.sectors == UNSEEN, ~contours.pwcv_observed)
    assert_array_equal(codes.seen, contours.pwcv_observed.sum(axis=1))
    opened = (contours.pwcv == 0.0) | (contours.pwcv >= settings.radius)
    assert_array_equal(codes.sectors == OPEN, contours.pwcv_observed & opened)
    at_wall = contours.pwcv_observed & ~opened
    wall = contours.pwcv[at_wall] / settings.radius
    assert (wall >= codes.sectors[at_wall] / BINS - 1e-6).all()
    assert (wall <= (codes.sectors[at_wall] + 1) / BINS + 1e-6).all()
    level = codes.vocabulary[codes.patterns].reshape(5500, 28)
    assert (level[:, 26:] == LEVEL_NONE).all()
    assert_array_equal(level[:, :26] == LEVEL_UNSEEN, codes.sectors == UNSEEN)
    assert (wall >= codes.level_from[level[:, :26][at_wall]] - 1e-6).all()
    assert (wall <= codes.level_to[level[:, :26][at_wall]] + 1e-6).all()
    assert len(np.unique(codes.vocabulary, axis=0)) == len(codes.vocabulary)


def sums_by_yaw(
    table: NDArray[np.uint16], codes: NDArray[np.uint16], step: int, barrier: NDArray[np.uint16]
) -> NDArray[np.int64]:
    """What `least_costs` adds up (n, yaws), code by code."""
    groups = codes.shape[1]
    total = np.tile(barrier.astype(np.int64), (len(codes), 1))
    for g in range(groups):
        start = step * (groups - 1 - g)
        total += table[codes[:, g], start : start + len(barrier)]
    return total


@pytest.mark.parametrize(("groups", "step"), [(3, 1), (8, 2), (30, 2), (31, 1)])
def test_least_costs_are_those_added_up_one_by_one(groups: int, step: int) -> None:
    rng = np.random.default_rng(groups)
    codes = rng.integers(0, 50, (40, groups)).astype(np.uint16)
    barrier = rng.choice([0, 30_000], 64).astype(np.uint16)
    table = rng.integers(0, 256, (50, 64 + step * (groups - 1))).astype(np.uint8)
    rows, costs = rng.permutation(40)[:25], np.empty(25, np.uint16)
    least_costs(table.ravel(), table.shape[1], codes, rows, step, barrier, costs)
    assert_array_equal(costs, sums_by_yaw(table, codes, step, barrier)[rows].min(axis=1))


def test_best_scores_are_those_of_the_formula_at_each_yaw() -> None:
    rng = np.random.default_rng(3)
    sectors, unit = 20, np.float32(20 / 30_000)
    codes = rng.integers(0, 9, (30, sectors)).astype(np.uint8)
    seen = (rng.uniform(size=sectors) < 0.7).astype(np.uint16)[(sectors - 1 - np.arange(sectors - 1 + 64)) % sectors]
    table = rng.integers(0, 1500, (9, len(seen))).astype(np.uint16) * seen
    table[8] = 375 * seen  # a quarter of a sector
    barrier = np.where(np.arange(64) < sectors, 0, 30_000).astype(np.uint16)
    scores = np.empty(30, np.float32)
    best_scores(table.ravel(), len(seen), codes, np.arange(30), barrier, 8, seen, unit, np.float32(0.25), scores)
    for row, code in enumerate(codes):
        expected = []
        for turn in range(sectors):
            there = np.array([seen[sectors - 1 - s + turn] for s in range(sectors)])
            both = int((there * (code != 8)).sum())
            cost = sum(int(table[c, sectors - 1 - s + turn]) for s, c in enumerate(code) if c != 8) * unit
            either = int(there.sum()) + int((code != 8).sum()) - both
            expected.append((1.0 - cost / both) * (both / either) ** 0.25)
        np.testing.assert_allclose(scores[row], max(expected), atol=1e-4)


def test_a_pattern_costs_its_four_sectors_at_the_cheaper_yaw() -> None:
    rng = np.random.default_rng(4)
    first, second = rng.integers(0, 128, (2, 16, 11)).astype(np.uint8)
    patterns = rng.integers(0, 16, (20, 2)).astype(np.uint8)
    table = np.empty((20, 10), np.uint8)
    pattern_table(first, second, patterns, table)
    for one, (a, b) in zip(table, patterns, strict=True):
        sums = [pair[a, 1:].astype(int) + pair[b, :-1] for pair in (first, second)]
        assert_array_equal(one, np.minimum(*sums))
