"""The wheel in a tunnel where the LiDAR does not see along: slip, scale, reverse, and the IMU alone."""

import numpy as np
import pytest
from tunnel_drive import drive

from localize.slip import Cusum

SLOW = 0.3


def along(steps):
    """Times [s] and errors (n,) of distance [m] of a drive, with its last step."""
    steps = list(steps)
    return np.array([s.t for s in steps]), np.array([s.off_m for s in steps]), steps[-1]


def grown(t, off, begin, end):
    """How much the error grew between two times [m]."""
    return abs(off[np.searchsorted(t, end)] - off[np.searchsorted(t, begin)])


@pytest.mark.parametrize("seed", range(3))
def test_a_fifth_of_slip_for_ten_seconds_is_told_and_survived(seed):
    """0.06 m/s too much: 0.6 m if it were believed."""
    t, off, end = along(
        drive(seed, 50.0, speed=lambda t: SLOW, slip=lambda t: 0.2 * (30 <= t < 40), seen=lambda t: t < 20)
    )
    begins = [c.stamp_ns * 1e-9 for c in end.wheel.changes if c.slipping]
    ends = [c.stamp_ns * 1e-9 for c in end.wheel.changes if not c.slipping]
    assert 30.0 <= begins[0] < 31.0 and 40.0 <= ends[0] < 42.0
    assert grown(t, off, 29.5, 43.0) < 0.2
    assert not end.wheel.slipping


@pytest.mark.parametrize(("slip", "kind"), [(3.0, "spins"), (-1.0, "is locked"), (-0.3, "slides")])
def test_a_wheel_that(slip, kind):
    t, off, end = along(
        drive(1, 26.0, speed=lambda t: 0.5, slip=lambda t: slip * (20 <= t < 23), seen=lambda t: t < 15)
    )
    assert len(end.wheel.changes) == 2 and not end.wheel.slipping
    assert grown(t, off, 19.5, 25.5) < 0.15
    assert np.sign(end.wheel.changes[0].excess) == np.sign(slip)


@pytest.mark.parametrize("seed", range(2))
def test_no_slip_is_seen_where_there_is_none(seed):
    """With starts, stops and reverse driving."""
    t, off, end = along(drive(seed, 40.0, speed=lambda t: 0.8 * np.sin(0.3 * t), slip=lambda t: 0.0))
    assert not [c for c in end.wheel.changes if c.slipping]
    assert abs(off[-1]) < 4.0 * end.along_std and end.along_std < 0.3
    assert end.gripped_s == pytest.approx(t[-1])


def test_a_slip_that_does_not_end_becomes_the_scale():
    _, _, end = along(drive(2, 45.0, speed=lambda t: SLOW, slip=lambda t: 0.15 * (t > 10), seen=lambda t: True))
    assert not end.wheel.slipping
    assert end.scale == pytest.approx(1.0 / 1.15, abs=0.02)


@pytest.mark.parametrize("scale", [0.985, 1.01])
def test_the_scale_is_learnt_where_the_velocity_is_held_and_serves_in_the_tunnel(scale):
    t, off, end = along(drive(3, 50.0, speed=lambda t: 1.0, slip=lambda t: 0.0, scale=scale, seen=lambda t: t < 30))
    assert end.scale == pytest.approx(scale, abs=0.004)
    assert end.scale_std < 0.003
    assert grown(t, off, 30.0, 49.0) < 0.01 * 19.0


def test_the_scale_stays_unknown_at_rest():
    _, _, end = along(drive(0, 20.0, speed=lambda t: 0.0, slip=lambda t: 0.0, scale=1.02, seen=lambda t: True))
    assert end.scale_std == pytest.approx(0.01, rel=0.1)


def test_errors_along_the_tunnel_agree_with_their_covariance():
    squared = []
    for seed in range(5):
        _, off, end = along(
            drive(seed + 10, 20.0, speed=lambda t: 0.6, slip=lambda t: 0.0, scale=1.0 + 0.004 * (seed - 2.5))
        )
        squared.append((off[-1] / end.along_std) ** 2)
    assert 0.1 < np.mean(squared) < 2.6


def test_sums_of_chance_stay_low_and_shifts_are_told():
    rng = np.random.default_rng(4)
    quiet = Cusum()
    assert not any(quiet.add(z) for z in rng.normal(size=3000))
    for sign in (1.0, -1.0):
        shifted = Cusum()
        assert any(shifted.add(sign * 3.0 + z) for z in rng.normal(size=5))


@pytest.mark.parametrize("seed", [1, 3])
def test_short_slips_where_the_imu_alone_holds_the_speed_do_not_become_the_scale(seed):
    """Their end may pass unseen, and what is learnt then is the IMU's drift: over a kilometre it was 250 m."""

    def slip(t):
        return 0.16 * (t > 25.0 and (t - 25.0) % 20.0 < 0.7)

    _, off, end = along(drive(seed, 100.0, speed=lambda t: SLOW, slip=slip, seen=lambda t: t < 20))
    assert any(change.slipping for change in end.wheel.changes) and not end.wheel.slipping
    assert end.scale == pytest.approx(1.0, abs=0.02)
    assert np.abs(off).max() < 2.0  # a fifth of the way of half a minute


@pytest.mark.parametrize(("seed", "begin", "lasts", "excess"), [(0, 50.8, 1.3, 0.56), (7, 27.8, 0.45, 0.14)])
def test_the_end_of_a_short_slip_is_seen_though_the_speed_could_follow_the_wheel(seed, begin, lasts, excess):
    """A scale that is free and a speed that the IMU holds loosely share a step back, and neither looks like one."""

    def slip(t):
        return excess * (begin <= t < begin + lasts)

    *_, end = drive(seed, begin + 8.0, speed=lambda t: SLOW, slip=slip, seen=lambda t: t < 20)
    told = [change.stamp_ns * 1e-9 for change in end.wheel.changes]
    assert told and len(told) % 2 == 0
    assert told[-1] < begin + lasts + 2.0
