"""How far a trajectory is from the truth: absolute, aligned and relative errors, and the papers' figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from semmap.errors import TrajectoryError
from semmap.geometry import Array, inverse, rotation_angle, se3
from semmap.trajectory import Trajectory

MIN_GAP_S = 0.5
"""Gaps in a trajectory up to this long are always interpolated over."""

SEGMENT_LENGTHS_M = (5.0, 10.0, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0)


@dataclass(frozen=True, slots=True)
class Pairs:
    """Estimated and true poses at the same stamps.

    stamps_ns : (n,); estimate, truth : (n, 4, 4), each ``T_frame_imu`` in its own frame.
    """

    stamps_ns: NDArray[np.int64]
    estimate: Array
    truth: Array

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def aligned(self, T_truth_estimate: Array) -> Pairs:
        """The same pairs with the estimate brought into the truth's frame."""
        return Pairs(self.stamps_ns, T_truth_estimate @ self.estimate, self.truth)

    def position_errors(self) -> Array:
        """Distances (n,) [m] between estimated and true position."""
        return np.asarray(np.linalg.norm(self.estimate[:, :3, 3] - self.truth[:, :3, 3], axis=1))

    def rotation_errors_deg(self) -> Array:
        """Angles (n,) [deg] between estimated and true attitude."""
        R = np.swapaxes(self.truth[:, :3, :3], -1, -2) @ self.estimate[:, :3, :3]
        return np.degrees(rotation_angle(R))

    def distance_flown(self) -> Array:
        """True distance (n,) [m] from the first pair, along the track."""
        steps = np.linalg.norm(np.diff(self.truth[:, :3, 3], axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)]) if len(self) else np.zeros(0)


def gap_limit_ns(stamps_ns: NDArray[np.int64]) -> float:
    """Longest gap [ns] to interpolate over: half a second, or three usual steps of a slower trajectory."""
    usual = float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0.0
    return max(MIN_GAP_S * 1e9, 3.0 * usual)


def associate(estimate: Trajectory, truth: Trajectory) -> Pairs:
    """Truth interpolated at the estimate's stamps; stamps outside the truth or in a gap of it are left out.

    Raises `TrajectoryError` where nothing is left although both have poses.
    """
    stamps = estimate.stamps_ns
    covered = stamps_covered(stamps, truth.stamps_ns)
    if len(estimate) and not covered.any():
        raise TrajectoryError(
            "does not overlap with the truth in time",
            mend="give the truth of the same recording, stamps in seconds",
        )
    if not covered.any():
        return Pairs(stamps[:0], estimate.poses[:0], truth.poses[:0])
    return Pairs(stamps[covered], estimate.poses[covered], truth.at(stamps[covered]))


def stamps_covered(query: NDArray[np.int64], known: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of ``query`` (m,) lie on one of ``known`` (n,) or between two with no gap between them."""
    if not len(known):
        return np.zeros(len(query), dtype=bool)
    after = np.searchsorted(known, query, side="left")
    inside = after < len(known)
    right = known[np.minimum(after, len(known) - 1)]
    left = known[np.maximum(after - 1, 0)]
    exact = inside & (right == query)
    return np.asarray(exact | (inside & (after > 0) & (right - left <= gap_limit_ns(known))))


def alignment(source: Array, target: Array) -> Array:
    """Rigid transform (4, 4) that takes ``source`` (n, 3) onto ``target`` (n, 3): Umeyama without scale."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    U[:, -1] *= np.sign(np.linalg.det(U @ Vt))  # a rotation, not a mirror image
    R = U @ Vt
    return se3(R, target.mean(axis=0) - R @ source.mean(axis=0))


@dataclass(frozen=True, slots=True)
class Statistics:
    """Max, root mean square, mean, median and 95th percentile of some errors; units are the errors'."""

    max: float
    rmse: float
    mean: float
    median: float
    p95: float

    @classmethod
    def of(cls, errors: Array) -> Statistics:
        """Statistics of ``errors`` (n,), n > 0."""
        return cls(
            max=float(errors.max()),
            rmse=float(np.sqrt(np.mean(errors**2))),
            mean=float(errors.mean()),
            median=float(np.median(errors)),
            p95=float(np.percentile(errors, 95)),
        )

    def as_dict(self) -> dict[str, float]:
        """The five numbers by name."""
        return asdict(self)


def relative_errors(
    pairs: Pairs, lengths_m: Sequence[float] = SEGMENT_LENGTHS_M, *, starts: int = 1000
) -> list[dict[str, float]]:
    """Drift over segments of fixed true length, KITTI's way.

    For each length: the mean over start poses of the translation error at the segment's end in percent of the
    length, and of the rotation error [deg/100 m]. Lengths the flight does not reach are left out.
    """
    flown = pairs.distance_flown()
    rows = []
    for length in lengths_m:
        start, end = _segments(flown, length, starts)
        if not len(start):
            continue
        step_truth = inverse(pairs.truth[start]) @ pairs.truth[end]
        step_estimate = inverse(pairs.estimate[start]) @ pairs.estimate[end]
        error = inverse(step_truth) @ step_estimate
        rows.append(
            {
                "length_m": length,
                "segments": len(start),
                "translation_percent": float(np.linalg.norm(error[:, :3, 3], axis=1).mean() / length * 100.0),
                "rotation_deg_per_100m": float(np.degrees(rotation_angle(error[:, :3, :3])).mean() / length * 100.0),
            }
        )
    return rows


def _segments(flown: Array, length: float, starts: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last index of segments of ``length``, from at most ``starts`` evenly spaced poses."""
    start = np.arange(0, len(flown), max(1, len(flown) // starts))
    end = np.searchsorted(flown, flown[start] + length)
    reached = end < len(flown)
    return start[reached], end[reached]


def rep(pairs: Pairs, *, parts: int = 5, min_flown_m: float = 1.0) -> list[float | None]:
    """REP-1 to REP-5 of paper 004 Table I [percent], in our reading.

    The paper does not define them: REP-k is the mean, over the first 20 k % of the distance flown, of the
    position error divided by the distance flown so far. Poses before ``min_flown_m`` are left out, for there
    the quotient says nothing; None for a part without any, and an empty list for a flight shorter than that.
    """
    flown, errors = pairs.distance_flown(), pairs.position_errors()
    if not len(flown) or flown[-1] <= min_flown_m:
        return []
    quotient = np.divide(errors, flown, out=np.zeros_like(errors), where=flown > min_flown_m)
    values: list[float | None] = []
    for k in range(1, parts + 1):
        use = (flown > min_flown_m) & (flown <= flown[-1] * k / parts)
        values.append(float(quotient[use].mean() * 100.0) if use.any() else None)
    return values


def start_alignment(pairs: Pairs) -> Array:
    """The transform (4, 4) that puts the first estimated pose onto the true one: drift from a known start."""
    return np.asarray(pairs.truth[0] @ inverse(pairs.estimate[0]))


def best_alignment(pairs: Pairs) -> Array:
    """The transform (4, 4) that brings the estimated positions closest to the true ones."""
    return alignment(pairs.estimate[:, :3, 3], pairs.truth[:, :3, 3])


def point_errors(estimate: Trajectory, stamps_ns: NDArray[np.int64], points: Array) -> Array:
    """Distances (n,) [m] of check points (n, 3) from the estimate at their stamps; NaN where it has none."""
    errors = np.full(len(points), np.nan)
    covered = stamps_covered(stamps_ns, estimate.stamps_ns)
    if covered.any():
        here = estimate.at(stamps_ns[covered])[:, :3, 3]
        errors[covered] = np.linalg.norm(here - points[covered], axis=1)
    return errors
