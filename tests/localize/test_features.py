"""LOAM's features on scans whose edges are known."""

import numpy as np
import pytest

from localize.features import curvature_features


def room_scan(rng, *, noise=0.005, rings=8, columns=720):
    """A square room of 8 m seen from its middle by level-ish rings: (points, ring, offsets)."""
    azimuth = np.tile(2 * np.pi * np.arange(columns) / columns, rings)
    ring = np.repeat(np.arange(rings), columns)
    elevation = np.radians(-7.0 + 2.0 * ring)
    reach = 4.0 / np.maximum(np.abs(np.cos(azimuth)), np.abs(np.sin(azimuth))) + noise * rng.normal(size=len(ring))
    points = np.column_stack([reach * np.cos(azimuth), reach * np.sin(azimuth), reach * np.tan(elevation)])
    return points, ring, (azimuth * 1e7).astype(np.int64)


def test_edges_are_the_corners_of_a_room(rng):
    points, ring, offsets = room_scan(rng)
    found = curvature_features(points, ring, offsets)
    corner = np.array([[x, y] for x in (-4, 4) for y in (-4, 4)])
    away = np.linalg.norm(points[found.edges, None, :2] - corner, axis=-1).min(axis=1)
    assert len(found.edges) >= 4 * 8 and np.quantile(away, 0.9) < 0.3
    assert len(found.planar) > 0.8 * len(points)
    assert not set(found.edges) & set(found.planar)


def test_order_of_the_points_does_not_matter(rng):
    points, ring, offsets = room_scan(rng)
    shuffled = rng.permutation(len(points))
    straight = curvature_features(points, ring, offsets)
    other = curvature_features(points[shuffled], ring[shuffled], offsets[shuffled])
    np.testing.assert_array_equal(np.sort(shuffled[other.edges]), straight.edges)


def test_a_step_in_range_is_no_edge(rng):
    """A box before the wall hides part of it: where its outline cuts the wall there is nothing to hold on to."""
    points, ring, offsets = room_scan(rng)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    hidden = np.abs(azimuth - 0.1) < 0.12
    points[hidden] *= 0.5
    found = curvature_features(points, ring, offsets)
    beside = np.abs(np.abs(azimuth[found.edges] - 0.1) - 0.12) < 0.02
    assert not beside.any()


@pytest.mark.parametrize("n", [0, 3])
def test_tiny_scans(rng, n):
    found = curvature_features(rng.normal(size=(n, 3)), np.zeros(n, int), np.arange(n))
    assert len(found.edges) == 0
