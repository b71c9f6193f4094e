"""Scan Context as Kim and Kim define it."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from descriptors.scan_context import (
    ScanContextIndex,
    ScanContextSettings,
    context_distance,
    ring_key,
    scan_context,
)
from semmap.geometry import Array, yaw_rotation

SETTINGS = ScanContextSettings(rings=10, sectors=36, max_range=20.0)


def cloud(seed: int) -> Array:
    rng = np.random.default_rng(seed)
    walls = rng.uniform([2.0, 0.0, -1.3], [19.0, 2 * np.pi, 2.0], (400, 3))
    return np.column_stack([walls[:, 0] * np.cos(walls[:, 1]), walls[:, 0] * np.sin(walls[:, 1]), walls[:, 2]])


def distance_one_by_one(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """The definition, shift by shift and column by column."""
    out = []
    for shift in range(a.shape[1]):
        turned = np.roll(a, shift, axis=1)
        cosines = [
            1.0 - float(u @ v) / float(np.linalg.norm(u) * np.linalg.norm(v))
            for u, v in zip(turned.T.astype(float), b.T.astype(float), strict=True)
            if u.any() and v.any()
        ]
        out.append(np.mean(cosines) if cosines else 1.0)
    return float(min(out))


def test_a_bin_holds_the_greatest_height() -> None:
    points = np.array([[5.0, 0.5, -1.0], [5.0, 0.6, 0.7], [0.0, -9.0, 0.2], [50.0, 0.0, 1.0]])
    context = scan_context(points, SETTINGS)
    assert_allclose(context[2, 0], 0.7 + SETTINGS.sensor_height)
    assert_allclose(context[4, 27], 0.2 + SETTINGS.sensor_height)
    assert np.count_nonzero(context) == 2


def test_a_turn_is_a_shift_of_the_columns() -> None:
    points = cloud(0)
    context = scan_context(points, SETTINGS)
    for sectors in (1, 9, 35):
        R = yaw_rotation(2.0 * np.pi * sectors / SETTINGS.sectors)
        turned = scan_context(points @ R.T, SETTINGS)
        assert (np.isclose(turned, np.roll(context, sectors, axis=1))).mean() > 0.99
        distance, yaw = context_distance(context, turned)
        assert distance < 0.01
        assert_allclose(np.exp(1j * yaw), np.exp(2j * np.pi * sectors / SETTINGS.sectors), atol=1e-9)
        assert_allclose(ring_key(turned), ring_key(context), atol=0.03)


def test_the_distance_is_the_definition() -> None:
    contexts = [scan_context(cloud(seed)[: 40 * (seed + 1)], SETTINGS) for seed in range(4)]
    for a in contexts:
        for b in contexts:
            assert_allclose(context_distance(a, b)[0], distance_one_by_one(a, b), atol=1e-6)


def test_empty_contexts_are_as_far_as_can_be() -> None:
    empty = scan_context(np.zeros((0, 3)), SETTINGS)
    assert_array_equal(empty, 0.0)
    assert context_distance(empty, scan_context(cloud(0), SETTINGS))[0] == 1.0


def test_the_index_finds_a_turned_scan_again() -> None:
    index = ScanContextIndex([scan_context(cloud(seed), SETTINGS) for seed in range(20)], SETTINGS)
    query = scan_context(cloud(13) @ yaw_rotation(2.0 * np.pi * 5 / 36).T, SETTINGS)
    best = index.best(query, 3)
    assert best[0].row == 13
    assert best[0].distance <= best[1].distance <= best[2].distance
    assert_allclose(best[0].yaw, -2.0 * np.pi * 5 / 36, atol=1e-9)
    assert ScanContextIndex([], SETTINGS).best(query, 3) == []
