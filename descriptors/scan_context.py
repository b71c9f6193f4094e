"""Scan Context (Kim and Kim, IROS 2018), the baseline beside the wall contours.

A scan becomes a matrix of rings by sectors around the sensor; each bin holds the greatest height of its points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat, PositiveFloat

from semmap.geometry import Array
from semmap.settings import Settings


class ScanContextSettings(Settings):
    """The paper's defaults.

    rings, sectors : bins by distance and by direction.
    max_range : outer radius of the last ring [m].
    sensor_height : added to heights above the sensor so that the floor is near 0 and empty bins stay lowest [m].
    candidates : contexts with the nearest ring keys that are compared in full.
    """

    rings: int = Field(default=20, ge=1)
    sectors: int = Field(default=60, ge=4)
    max_range: PositiveFloat = 80.0
    sensor_height: FiniteFloat = 2.0
    candidates: int = Field(default=10, ge=1)


@dataclass(frozen=True, slots=True)
class ContextMatch:
    """A context of the index that may be the one asked for.

    row : which context of the index. distance : 0 (equal) to 1.
    yaw : rotation about z [rad] that takes the directions of the query to those of the match.
    """

    row: int
    distance: float
    yaw: float


def scan_context(points: Array, settings: ScanContextSettings | None = None) -> NDArray[np.float32]:
    """Scan Context (rings, sectors) of points (n, 3) relative to the sensor, gravity-aligned [m]."""
    settings = settings or ScanContextSettings()
    away = np.hypot(points[:, 0], points[:, 1])
    turn = np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi)
    ring = np.floor(away / settings.max_range * settings.rings).astype(np.int64)
    sector = np.floor(turn * settings.sectors).astype(np.int64) % settings.sectors
    inside = ring < settings.rings
    height = np.maximum(points[:, 2] + settings.sensor_height, 0.0)
    context = np.zeros((settings.rings, settings.sectors), dtype=np.float32)
    np.maximum.at(context, (ring[inside], sector[inside]), height[inside].astype(np.float32))
    return context


def ring_key(context: NDArray[np.float32]) -> Array:
    """Share (rings,) of the bins of each ring that are not empty; the same for every yaw."""
    return np.asarray((context > 0.0).mean(axis=1))


def context_distance(a: NDArray[np.float32], b: NDArray[np.float32]) -> tuple[float, float]:
    """Least mean cosine distance of the columns over all sector shifts, and the yaw that takes a to b [rad].

    Columns that are empty in either take no part, as in the authors' code.
    """
    (unit_a, full_a), (unit_b, full_b) = _columns(a), _columns(b)
    cosine = _correlated(unit_a, unit_b)
    both = _correlated(full_a[None], full_b[None]).round()
    mean = np.where(both > 0.0, cosine / np.maximum(both, 1.0), 0.0)
    best = int(np.argmax(mean))
    yaw = best * 2.0 * np.pi / a.shape[1]
    return float(np.clip(1.0 - mean[best], 0.0, 1.0)), float((yaw + np.pi) % (2.0 * np.pi) - np.pi)


def _columns(context: NDArray[np.float32]) -> tuple[Array, Array]:
    """Columns scaled to unit length, and 1 for each that is not empty."""
    length = np.linalg.norm(context, axis=0)
    return context / np.where(length > 0.0, length, 1.0), (length > 0.0).astype(np.float64)


def _correlated(a: Array, b: Array) -> Array:
    """Sum (sectors,) over rings and sectors of a turned by 0, 1, 2 … sectors, times b."""
    return np.asarray(np.fft.ifft((np.conj(np.fft.fft(a)) * np.fft.fft(b)).sum(axis=0)).real)


class ScanContextIndex:
    """Contexts of a map, searched by ring key first and in full after, as in the paper."""

    def __init__(self, contexts: Sequence[NDArray[np.float32]], settings: ScanContextSettings | None = None) -> None:
        self._settings = settings or ScanContextSettings()
        self._contexts = tuple(contexts)
        self._keys = np.array([ring_key(context) for context in contexts]).reshape(-1, self._settings.rings)

    def best(self, query: NDArray[np.float32], k: int) -> list[ContextMatch]:
        """The ``k`` contexts nearest to the query, nearest first."""
        if not self._contexts:
            return []
        off = np.linalg.norm(self._keys - ring_key(query), axis=1)
        rows = np.argsort(off, kind="stable")[: max(k, self._settings.candidates)]
        matches = [ContextMatch(int(row), *context_distance(query, self._contexts[row])) for row in rows]
        return sorted(matches, key=lambda match: match.distance)[:k]
