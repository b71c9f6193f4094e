"""The clock offset between total station and robot: found to the millisecond, hours apart, or refused."""

from __future__ import annotations

import numpy as np
import pytest

from localize.clock_offset import ClockOffset, estimate_clock_offset
from semmap.errors import MeasurementError
from semmap.geometry import se3, so3_exp, transform, yaw_rotation
from semmap.measurements import PrismFix
from semmap.trajectory import Trajectory

LEVER = np.array([0.1, 0.8, 0.4])


def drive(rng, seconds: float = 90.0) -> Trajectory:
    """Starts, stops and bends at random, 10 poses a second in odom."""
    t = np.arange(0.0, seconds, 0.1)
    knots = np.arange(0.0, seconds + 6.0, 3.0)
    speed = np.interp(t, knots, np.abs(rng.normal(0.4, 0.4, len(knots))) * (rng.random(len(knots)) > 0.3))
    yaw = np.cumsum(0.1 * np.interp(t, knots, 0.15 * rng.normal(size=len(knots))))
    p = np.cumsum(0.1 * speed[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw), 0.02 * yaw]), axis=0)
    poses = se3(np.array([yaw_rotation(float(y)) for y in yaw]), p)
    return Trajectory("odom", _ns(1_700_000_000, t), poses)


def _ns(epoch_s: int, t: np.ndarray) -> np.ndarray:
    return epoch_s * 1_000_000_000 + np.round(t * 1e9).astype(np.int64)


def fixes_of(trajectory: Trajectory, rng, *, offset_s: float, part=(10.0, 80.0), std=0.002) -> list[PrismFix]:
    """Fixes five times a second on a clock that is behind by ``offset_s``, in a map turned against odom."""
    stamps = trajectory.stamps_ns[0] + np.round(np.arange(*part, 0.2) * 1e9).astype(np.int64)
    T = se3(so3_exp([0.0, 0.0, 2.0]), [500.0, -300.0, 20.0])
    poses = trajectory.at(stamps)
    prism = transform(T, poses[:, :3, 3] + poses[:, :3, :3] @ LEVER) + std * rng.normal(size=(len(stamps), 3))
    return [PrismFix(int(s) - round(offset_s * 1e9), p) for s, p in zip(stamps, prism, strict=True)]


@pytest.mark.parametrize(("seed", "offset_s"), [(0, 0.0), (1, 0.137), (2, -7205.321), (3, 28_800.05)])
def test_the_offset_is_found(seed, offset_s) -> None:
    rng = np.random.default_rng(seed)
    trajectory = drive(rng)
    found = estimate_clock_offset(trajectory, fixes_of(trajectory, rng, offset_s=offset_s), LEVER, point_std=0.002)
    assert abs(found.offset_s - offset_s) < 0.01
    assert found.std_s < 0.005
    assert found.residual_m < 0.006


def test_errors_are_what_it_says_of_itself() -> None:
    scaled = []
    for seed in range(12):
        rng = np.random.default_rng([seed, 7])
        trajectory = drive(rng)
        fixes = fixes_of(trajectory, rng, offset_s=0.2, std=0.01)
        found = estimate_clock_offset(trajectory, fixes, LEVER, point_std=0.01)
        scaled.append((found.offset_s - 0.2) / found.std_s)
    assert 0.4 < np.mean(np.square(scaled)) < 2.2


def test_outliers_and_a_gap_do_no_harm() -> None:
    rng = np.random.default_rng(4)
    trajectory = drive(rng)
    fixes = fixes_of(trajectory, rng, offset_s=0.25)
    fixes = [f for k, f in enumerate(fixes) if not 100 < k < 150]
    fixes[40] = PrismFix(fixes[40].stamp_ns, fixes[40].p_map + [0.4, 0.0, 0.0])
    found = estimate_clock_offset(trajectory, fixes, LEVER, point_std=0.002)
    assert abs(found.offset_s - 0.25) < 0.01


def even(trajectory: Trajectory, *, speed: float) -> Trajectory:
    t = (trajectory.stamps_ns - trajectory.stamps_ns[0]) * 1e-9
    p = np.column_stack([speed * t, 0.0 * t, 0.0 * t])
    return Trajectory("odom", trajectory.stamps_ns, se3(np.tile(np.eye(3), (len(t), 1, 1)), p))


@pytest.mark.parametrize("speed", [0.0, 0.5])
def test_an_even_motion_is_refused(speed) -> None:
    rng = np.random.default_rng(5)
    trajectory = even(drive(rng), speed=speed)
    with pytest.raises(MeasurementError, match="clock offset"):
        estimate_clock_offset(trajectory, fixes_of(trajectory, rng, offset_s=0.1), LEVER, point_std=0.002)


def test_too_few_fixes_are_refused() -> None:
    rng = np.random.default_rng(6)
    trajectory = drive(rng)
    with pytest.raises(MeasurementError, match="4 fixes"):
        estimate_clock_offset(trajectory, fixes_of(trajectory, rng, offset_s=0.0)[:4], LEVER, point_std=0.002)


def test_another_drives_fixes_are_refused() -> None:
    rng = np.random.default_rng(8)
    trajectory, other = drive(rng), drive(rng)
    with pytest.raises(MeasurementError):
        estimate_clock_offset(trajectory, fixes_of(other, rng, offset_s=0.0), LEVER, point_std=0.002)


def test_a_fix_is_brought_onto_the_robots_clock() -> None:
    moved = ClockOffset(-0.5, 0.001, 0.002).applied(PrismFix(2_000_000_000, np.zeros(3)))
    assert moved.stamp_ns == 1_500_000_000
