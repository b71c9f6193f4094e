"""Where a tag is, from distances to anchors alone: the position solver of an anchor set."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semmap.geometry import Array

_STEPS = 15
_HUBER = 1.5
_STOP_M = 1e-4
_VAGUE_M = 100.0
"""What ranges leave open, such as where on a circle about anchors in line, is as wide as this."""
_SPEED = 1.0
"""How fast a tag may move, per axis [m/s]."""
_AS_WELL = 9.0
"""A second place that fits worse by less than this, in squared sigmas, fits as well."""


@dataclass(frozen=True, slots=True)
class TagFix:
    """A tag's place.

    p_map : (3,) [m]; covariance : (3, 3) [m²].
    residuals : (n,) of the ranges, measured less computed [m].
    mirror : (3,) a second place that fits as well, or None; ``covariance`` is wide enough for it.
    """

    p_map: Array
    covariance: Array
    residuals: Array
    mirror: Array | None = None


@dataclass(frozen=True, slots=True)
class Ranges:
    """Distances (n,) to anchors (n, 3), each read ``ages_s`` (n,) ago with ``std`` (n,) [m].

    Anchors are asked one after another: over the time that takes, or a little more, a tag moves at one speed.
    """

    anchors: Array
    distances: Array
    std: Array
    ages_s: Array


@dataclass(frozen=True, slots=True)
class _Problem:
    """Least squares over place and velocity (6,)."""

    ranges: Ranges
    mean: Array
    information: Array

    def cost(self, x: Array) -> float:
        """Squared sigmas, outliers as Huber counts them."""
        e = np.abs(self.residuals(x)) / self.ranges.std
        off = x - self.mean
        huber = np.where(e < _HUBER, e * e, 2.0 * _HUBER * e - _HUBER**2)
        return float(np.sum(huber) + off @ self.information @ off)

    def normal(self, x: Array) -> tuple[Array, Array]:
        """Normal matrix (6, 6) and right side (6,), outliers weighed down as Huber does."""
        away = self._away(x)
        direction = away / np.maximum(np.linalg.norm(away, axis=1), 1e-6)[:, None]
        e = self.residuals(x) / self.ranges.std
        weight = np.sqrt(np.minimum(1.0, _HUBER / np.maximum(np.abs(e), 1e-12)))
        H = np.hstack([direction, -self.ranges.ages_s[:, None] * direction]) * (weight / self.ranges.std)[:, None]
        return H.T @ H + self.information, H.T @ (weight * e) - self.information @ (x - self.mean)

    def residuals(self, x: Array) -> Array:
        """Measured less computed (n,) [m]."""
        return np.asarray(self.ranges.distances - np.linalg.norm(self._away(x), axis=1))

    def _away(self, x: Array) -> Array:
        return np.asarray(x[:3] - self.ranges.ages_s[:, None] * x[3:] - self.ranges.anchors)

    def descend(self, x: Array) -> Array:
        """Levenberg's and Marquardt's steps from ``x`` down to where the ranges fit."""
        damping, cost = 1e-3, self.cost(x)
        for _ in range(_STEPS):
            A, b = self.normal(x)
            step = np.linalg.solve(A + damping * np.diag(np.diag(A)), b)
            lower = self.cost(x + step)
            if lower < cost:
                x, cost, damping = x + step, lower, 0.1 * damping
            else:
                damping *= 10.0
            if np.linalg.norm(step) < _STOP_M:
                break
        return x


def find_tag(ranges: Ranges, *, prior: TagFix | None = None) -> TagFix | None:
    """Where the tag is now: robust least squares of ranges that are a moment old at the most.

    Anchors in one plane, or nearly, have a mirror image of the tag behind it. Where ``prior`` does not tell which of
    the two it is, the answer says so. None with fewer than three anchors and no prior.
    """
    three = len(np.unique(ranges.anchors, axis=0)) >= 3
    if not three and prior is None:
        return None
    mean, information = np.zeros(6), np.diag(np.repeat([_VAGUE_M**-2, _SPEED**-2], 3))
    mean[:3] = ranges.anchors.mean(axis=0) if prior is None else prior.p_map
    if prior is not None:
        information[:3, :3] = np.linalg.inv(prior.covariance)
    problem = _Problem(ranges, mean, information)
    starts = ([] if prior is None else [prior.p_map]) + (_both_sides(ranges) if three else [])
    found = sorted((problem.descend(np.concatenate([p, np.zeros(3)])) for p in starts), key=problem.cost)
    return _fix(problem, found[0], found[1:])


def _fix(problem: _Problem, x: Array, others: list[Array]) -> TagFix:
    covariance = np.asarray(np.linalg.inv(problem.normal(x)[0])[:3, :3], dtype=np.float64)
    residuals = problem.residuals(x)
    for other in others:
        apart = other[:3] - x[:3]
        beyond = apart @ np.linalg.solve(covariance, apart) > _AS_WELL
        if beyond and problem.cost(other) - problem.cost(x) < _AS_WELL:
            return TagFix(x[:3], np.asarray(covariance + np.outer(apart, apart)), residuals, other[:3])
    return TagFix(x[:3], covariance, residuals)


def _both_sides(ranges: Ranges) -> list[Array]:
    """Two places in front of and behind the plane nearest to the anchors, where squared ranges put the tag."""
    centre = ranges.anchors.mean(axis=0)
    axes = np.linalg.svd(ranges.anchors - centre)[2]
    inside = (ranges.anchors - centre) @ axes[:2].T
    square = np.sum((ranges.anchors - centre) ** 2, axis=1) - ranges.distances**2
    uv = np.linalg.lstsq(2.0 * inside, square - square.mean(), rcond=1e-3)[0]
    height2 = np.mean(ranges.distances**2 - np.sum((inside - uv) ** 2, axis=1))
    height = np.sqrt(max(float(height2), 0.01))
    return [centre + uv @ axes[:2] + sign * height * axes[2] for sign in (1.0, -1.0)]
