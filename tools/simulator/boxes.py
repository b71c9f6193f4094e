"""Boxes that stand in a mine: parts of vehicles, pallets, posts and conveyors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semmap.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Points (n, 3) on surfaces, map frame, and unit vectors (n, 3) from there into the air."""

    points: Array
    into_air: Array

    def __getitem__(self, kept: NDArray[np.bool_]) -> Samples:
        return Samples(self.points[kept], self.into_air[kept])

    def __add__(self, other: Samples) -> Samples:
        return Samples(
            np.concatenate([self.points, other.points]),
            np.concatenate([self.into_air, other.into_air]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """A box of any attitude.

    p : (3,) its origin in the map frame; R : (3, 3) its axes as columns.
    low, high : (3,) its corners in its own axes [m].
    """

    p: Array
    R: Array
    low: Array
    high: Array

    @property
    def corners(self) -> Array:
        """Its eight corners (8, 3), map frame."""
        ends = np.array([self.low, self.high])
        picked = np.indices((2, 2, 2)).reshape(3, 8).T
        return np.asarray(self.p + ends[picked, np.arange(3)] @ self.R.T)

    @property
    def centre(self) -> Array:
        """Its middle (3,), map frame."""
        return np.asarray(self.p + self.R @ (0.5 * (self.low + self.high)))

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Whether points (n, 3), map frame, are inside: (n,)."""
        inside = np.linalg.norm(points - self.centre, axis=1) < 0.5 * np.linalg.norm(self.high - self.low)
        local = (points[inside] - self.p) @ self.R
        inside[inside] = ((local > self.low) & (local < self.high)).all(axis=1)
        return np.asarray(inside)

    def samples(self, spacing: float, rng: np.random.Generator) -> Samples:
        """Its surface at random, one point for each ``spacing``²."""
        points, normals = [], []
        size = self.high - self.low
        for axis in range(3):
            count = round(2.0 * np.prod(np.delete(size, axis)) / spacing**2)
            far = rng.uniform(size=count) < 0.5
            local = self.low + size * rng.uniform(size=(count, 3))
            local[:, axis] = np.where(far, self.high[axis], self.low[axis])
            points.append(self.p + local @ self.R.T)
            normals.append(np.where(far, 1.0, -1.0)[:, None] * self.R[:, axis])
        return Samples(np.concatenate(points), np.concatenate(normals))
