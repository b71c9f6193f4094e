"""What is between the total station's clock and the robot's, from how the prism moved by each of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import correlate

from semmap.errors import MeasurementError
from semmap.geometry import Array, yaw_rotation
from semmap.measurements import PrismFix
from semmap.trajectory import Trajectory

_STEP_S = 0.1
"""Grid on which speeds are compared."""
_GAP_S = 2.0
"""Fixes further apart than this say nothing of the speed between them."""
_MIN_OVERLAP = 0.5
"""Least share of the shorter one's time in which both must be seen."""
_APART_S = 3.0
_RIVAL = 2.0
"""Another offset, this far off, must fit the speeds worse by this factor in the mean square."""
_OUTLIERS = 4.0
_MAX_STD_S = 0.05


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """``offset_s`` is to be added to the instrument's stamps (the rig's ``total_station.time_offset_s``).

    std_s : its standard deviation [s]. residual_m : root mean square distance of the fixes from the moved track [m].
    """

    offset_s: float
    std_s: float
    residual_m: float

    def applied(self, fix: PrismFix) -> PrismFix:
        """The fix on the robot's clock."""
        return PrismFix(fix.stamp_ns + round(self.offset_s * 1e9), fix.p_map)


def estimate_clock_offset(
    trajectory: Trajectory, fixes: Sequence[PrismFix], p_imu_prism: Array, *, point_std: float
) -> ClockOffset:
    """The offset at which a robot's track, moved as a whole, meets the fixes best.

    First the speeds of the prism are compared at all offsets at which the two overlap, hours if need be: speed is the
    same in every frame. Then the offset is refined with heading and place of the track free.

    Parameters
    ----------
    trajectory : of the imu, in any frame with z up (odometry), on the robot's clock.
    fixes : in order of time, on the instrument's clock. p_imu_prism : (3,) lever arm [m]. point_std : of a fix [m].

    Raises
    ------
    MeasurementError
        Where there are too few fixes, or the motion is too even or too repetitive to tell.
    """
    stamps = np.array([fix.stamp_ns for fix in fixes], np.int64)
    points = np.array([fix.p_map for fix in fixes]).reshape(-1, 3)
    if len(fixes) < 10 or len(trajectory) < 10:
        what = f"{len(fixes)} fixes and {len(trajectory)} poses do not tell the clock offset"
        raise MeasurementError(what, field="fixes", mend="track the prism for a while in motion")
    prism: Array = trajectory.positions + trajectory.poses[:, :3, :3] @ np.asarray(p_imu_prism)
    zero_ns, origin_ns = int(trajectory.stamps_ns[0]), int(stamps[0])
    track_t, fix_t = (_seconds(at, zero) for at, zero in ((trajectory.stamps_ns, zero_ns), (stamps, origin_ns)))
    coarse = _coarse(_speeds(track_t, prism, np.inf), _speeds(fix_t, points, _GAP_S))
    offset_s, std_s, residual_m = _refined(coarse, track_t, prism, fix_t, points, point_std)
    if std_s > _MAX_STD_S:
        what = f"motion is too even to tell the clock offset (std {std_s:.2g} s)"
        raise MeasurementError(what, field="fixes", mend="stop and start a few times while the prism is tracked")
    return ClockOffset((zero_ns - origin_ns) * 1e-9 + offset_s, std_s, residual_m)


def _seconds(stamps_ns: NDArray[np.int64], zero_ns: int) -> Array:
    return np.asarray((stamps_ns - zero_ns) * 1e-9, dtype=np.float64)


def _speeds(t: Array, p: Array, gap_s: float) -> tuple[Array, NDArray[np.bool_]]:
    """Speeds on a grid from the first time on, and where they are known."""
    grid = np.arange(0.0, t[-1] + _STEP_S, _STEP_S)
    at = np.column_stack([np.interp(grid, t, p[:, axis]) for axis in range(3)])
    # over two steps: the noise of a fix, halved, and no shift in time
    speed = np.zeros(len(grid))
    speed[1:-1] = np.linalg.norm(at[2:] - at[:-2], axis=1) / (2.0 * _STEP_S)
    after = np.clip(np.searchsorted(t, grid), 1, len(t) - 1)
    known = t[after] - t[after - 1] < gap_s
    known[[0, -1]] = False
    return speed, known


def _coarse(track: tuple[Array, NDArray[np.bool_]], fixes: tuple[Array, NDArray[np.bool_]]) -> float:
    """Seconds on the track's time axis at which the fixes begin, to a step of the grid."""
    (a, in_a), (b, in_b) = track, fixes
    ones_a, ones_b = in_a.astype(float), in_b.astype(float)

    def sums(x: Array, y: Array) -> Array:
        return np.asarray(correlate(x, y, mode="full", method="fft"))

    overlap = sums(ones_a, ones_b)
    square = sums(ones_a * a**2, ones_b) - 2.0 * sums(ones_a * a, ones_b * b) + sums(ones_a, ones_b * b**2)
    enough = overlap > _MIN_OVERLAP * min(ones_a.sum(), ones_b.sum())
    if not enough.any():
        raise MeasurementError("fixes and track do not overlap", field="fixes", mend="give the file of this recording")
    mean = np.where(enough, square / np.maximum(overlap, 1.0), np.inf)
    best = int(np.argmin(mean))
    lags = (np.arange(len(mean)) - (len(b) - 1)) * _STEP_S
    rivals = mean[np.abs(lags - lags[best]) > _APART_S]
    if rivals.min(initial=np.inf) < _RIVAL * mean[best]:
        what = "motion repeats itself or hardly changes: two clock offsets fit alike"
        raise MeasurementError(what, field="fixes", mend="stop and start a few times while the prism is tracked")
    return float(lags[best])


def _refined(
    coarse: float, track_t: Array, prism: Array, fix_t: Array, points: Array, point_std: float
) -> tuple[float, float, float]:
    """Offset, its standard deviation [s], and the residual [m], by least squares with heading and place free."""
    inside = (fix_t + coarse > track_t[0] + 1.0) & (fix_t + coarse < track_t[-1] - 1.0)
    t, p = fix_t[inside], points[inside]
    if len(t) < 10:
        raise MeasurementError("fixes and track hardly overlap", field="fixes", mend="give the file of this recording")

    def residuals(offset: float) -> Array:
        at = np.column_stack([np.interp(t + offset, track_t, prism[:, axis]) for axis in range(3)])
        a, b = at - at.mean(axis=0), p - p.mean(axis=0)
        turn = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a[:, :2] * b[:, :2]))
        return np.asarray(b - a @ yaw_rotation(float(turn)).T)

    for _ in range(2):
        best = minimize_scalar(
            lambda x: float(np.sum(residuals(x) ** 2)), bounds=(coarse - 0.5, coarse + 0.5), method="bounded",
            options={"xatol": 1e-6},
        )  # fmt: skip
        off = np.linalg.norm(residuals(best.x), axis=1)
        good = off <= _OUTLIERS * max(float(np.median(off)), point_std)
        t, p = t[good], p[good]
    rest, step = float(np.sum(residuals(best.x) ** 2)), 0.02
    bend = (np.sum(residuals(best.x + step) ** 2) + np.sum(residuals(best.x - step) ** 2) - 2.0 * rest) / step**2
    variance = max(point_std**2, rest / (3 * len(t) - 5))
    std = float(np.sqrt(2.0 * variance / bend)) if bend > 0.0 else np.inf
    return float(best.x), std, float(np.sqrt(rest / len(t)))
