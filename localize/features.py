"""LOAM's features of a scan: points on edges and points on planes (paper 004, its odometry; 002 section II.C)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from semmap.geometry import Array

_HALF_WINDOW = 5
_SEGMENTS = 6
"""Parts of a ring that each give their own edges, so that they come from all around."""
_EDGES_PER_SEGMENT = 4
_SHARP, _FLAT = 0.02, 0.005
"""Curvature from which a point may be an edge, and up to which it is of a plane."""
_JUMP = 0.1
"""Where neighbours' ranges differ by more than this share, one hides the other, and the edge is not the rock's."""


class Features(NamedTuple):
    """Point numbers of a scan: edges (e,), and planar (p,)."""

    edges: NDArray[np.int64]
    planar: NDArray[np.int64]


def curvature_features(points: Array, ring: NDArray[np.integer], offsets_ns: NDArray[np.int64]) -> Features:
    """Edges and planar points of a spinning LiDAR's scan, by the curvature of its rings (LOAM).

    ``c = |Σ (p_j - p_i)| / (n |p_i|)`` over the five neighbours on either side in the ring.

    points : (n, 3) deskewed, in the lidar frame [m]. ring : (n,). offsets_ns : (n,), tells the order within a ring.
    """
    order = np.lexsort((offsets_ns, ring))
    p, ring = points[order], ring[order]
    if len(p) <= 2 * _HALF_WINDOW:
        return Features(np.zeros(0, np.int64), np.arange(len(points)))
    ranges = np.linalg.norm(p, axis=1)
    curvature, whole = _curvature(p, ranges, ring)
    open_to_doubt = _beside_jump(ranges)
    edge = _sharpest(np.where(whole & ~open_to_doubt & (curvature > _SHARP), curvature, 0.0), ring)
    return Features(np.sort(order[edge]), np.sort(order[~edge & (curvature < _FLAT)]))


def _curvature(p: Array, ranges: Array, ring: NDArray[np.integer]) -> tuple[Array, NDArray[np.bool_]]:
    """Curvature (n,) of points in ring order, 0 where the window leaves the ring; and where it does not."""
    k, n = _HALF_WINDOW, len(p)
    summed = np.concatenate([np.zeros((1, 3)), np.cumsum(p, axis=0)])
    middle = np.arange(k, n - k)
    around = summed[middle + k + 1] - summed[middle - k] - (2 * k + 1) * p[middle]
    curvature, whole = np.zeros(n), np.zeros(n, dtype=bool)
    curvature[middle] = np.linalg.norm(around, axis=1) / (2 * k * np.maximum(ranges[middle], 1e-6))
    whole[middle] = ring[middle - k] == ring[middle + k]
    return np.where(whole, curvature, 0.0), whole


def _beside_jump(ranges: Array) -> NDArray[np.bool_]:
    """Points within half a window of a jump in range."""
    jump = np.abs(np.diff(ranges)) > _JUMP * np.minimum(ranges[1:], ranges[:-1])
    window = np.ones(2 * _HALF_WINDOW, dtype=np.int64)
    near = np.convolve(np.concatenate([[False], jump, [False]]).astype(np.int64), window, mode="same")
    return np.asarray(near[: len(ranges)] > 0)


def _sharpest(curvature: Array, ring: NDArray[np.integer]) -> NDArray[np.bool_]:
    """The few points of greatest curvature in each segment of each ring: (n,) bool."""
    starts = np.searchsorted(ring, ring, side="left")
    counts = np.searchsorted(ring, ring, side="right") - starts
    segment = (np.arange(len(ring)) - starts) * _SEGMENTS // np.maximum(counts, 1)
    group = ring.astype(np.int64) * _SEGMENTS + segment
    order = np.lexsort((-curvature, group))
    rank = np.arange(len(ring)) - np.searchsorted(group[order], group[order], side="left")
    chosen = np.zeros(len(ring), dtype=bool)
    chosen[order[rank < _EDGES_PER_SEGMENT]] = True
    return chosen & (curvature > 0.0)
