"""Prism fixes in the filter: Jacobian, gate, a filter that was wrong, a machine that stands, the earth's rate."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from localize.earth import Earth
from localize.filter import ErrorStateFilter, InertialTrack
from localize.prism import COLUMNS, Clock, PrismFusion, PrismPosition, Standstill, TurnOnBias, without_earth_rate
from localize.recent_motion import PointPath, RecentMotion
from localize.settings import PrismSettings
from localize.state import CLOCK, GYRO_BIAS, ODOM, POSITION, ROTATION, VELOCITY
from semmap.geometry import so3_exp
from semmap.measurements import PrismFix
from semmap.rig import EarthBlock, ImuBlock, TotalStationBlock

STATION = TotalStationBlock(position=(0.0, 0.0, 1.5), point_std=0.002, p_imu_prism=(0.1, 0.8, 0.4))
LEVER = np.array(STATION.p_imu_prism)


def filter_of(state, std=0.05) -> ErrorStateFilter:
    """With a clock that is right, and known to be."""
    state.clock_offset = 0.0
    P = np.zeros((state.dim, state.dim))
    for columns in (ROTATION, POSITION, VELOCITY, ODOM)[: 3 if state.T_map_odom is None else 4]:
        P[columns, columns] = std**2 * np.eye(columns.stop - columns.start)
    return ErrorStateFilter(state, P, 0, ImuBlock(topic="/imu"))


def prism_of(state):
    """Where it is now."""
    return state.T_map_odom[:3, :3] @ (state.p + state.R @ LEVER) + state.T_map_odom[:3, 3]


def test_jacobian(located, rng, check_jacobian):
    model = PrismPosition(rng.normal(size=3), PointPath.fixed(LEVER), 0.002)
    check_jacobian(model.residual, model.jacobian(located), located, COLUMNS)


def test_jacobian_of_a_fix_of_another_time(located, rng, check_jacobian):
    """Late, by a clock that is off, of a prism that swings."""
    path = PointPath(np.linspace(-1.0, 0.0, 11), LEVER + 0.1 * rng.normal(size=(11, 3)))
    for clock_offset in (-0.234, 0.123):
        located.clock_offset = clock_offset
        model = PrismPosition(rng.normal(size=3), path, 0.002, since_s=-0.31)
        check_jacobian(model.residual, model.jacobian(located), located, COLUMNS)


def test_a_fix_puts_the_prism_where_it_is(located):
    filter = filter_of(located)
    fix = prism_of(located) + [0.05, -0.03, 0.02]
    outcome = PrismFusion(STATION, PrismSettings()).take(PrismFix(0, fix), filter)
    assert outcome is not None and outcome.used
    assert_allclose(prism_of(filter.state), fix, atol=3e-4)


def test_an_outlier_is_refused(located):
    filter = filter_of(located, std=0.003)
    outcome = PrismFusion(STATION, PrismSettings()).take(PrismFix(0, prism_of(located) + [0.5, 0.0, 0.0]), filter)
    assert outcome is not None and not outcome.used
    assert outcome.off_m == pytest.approx(0.5)
    assert_allclose(filter.state.p, located.p)
    assert_allclose(filter.P[:6, :6], 0.003**2 * np.eye(6))


def test_a_filter_that_is_wrong_gives_way_to_fixes_that_agree(located, rng):
    filter, fusion = filter_of(located, std=0.003), PrismFusion(STATION, PrismSettings())
    true = prism_of(located) + [0.3, -0.2, 0.0]
    used = [
        fusion.take(PrismFix(k, true + 0.002 * rng.normal(size=3)), filter).used
        for k in range(PrismSettings().contradicting)
    ]
    assert used == [False] * (len(used) - 1) + [True]
    assert fusion.doubts == 1
    assert np.linalg.norm(prism_of(filter.state) - true) < 0.01


def test_outliers_that_disagree_never_win(located, rng):
    filter, fusion = filter_of(located, std=0.003), PrismFusion(STATION, PrismSettings())
    for k in range(50):
        wrong = prism_of(located) + rng.uniform(0.2, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
        assert not fusion.take(PrismFix(k, wrong), filter).used
    assert fusion.doubts == 0


@pytest.mark.parametrize("speed", [0.0, 0.1])
def test_before_the_place_is_known_fixes_tell_whether_it_stands(state, rng, speed):
    filter, fusion = filter_of(state, std=1.0), PrismFusion(STATION, PrismSettings())
    for k in range(20):
        p = np.array([speed * 0.2 * k, 0.0, 0.0]) + 0.002 * rng.normal(size=3)
        assert fusion.take(PrismFix(k * 200_000_000, p), filter) is None
    sure = np.linalg.norm(filter.state.v) < 0.01
    assert sure == (speed == 0.0)


def test_a_machine_that_sets_off_is_not_held_by_fixes_of_a_clock_that_is_off(state):
    """By their stamps they are of now, and are of 0.3 s ago, when it stood."""
    state.v, end_ns = np.array([0.2, 0.0, 0.0]), 2_000_000_000
    filter, fusion, recent = filter_of(state, std=1.0), PrismFusion(STATION, PrismSettings()), RecentMotion()
    filter.stamp_ns, t = end_ns, np.linspace(0.0, 1.0, 101)
    v = np.maximum(0.0, t - 0.8)[:, None] * [1.0, 0.0, 0.0]
    p = np.cumsum(0.01 * v, axis=0)
    recent.add(InertialTrack(end_ns - 1_000_000_000, t, np.tile(state.R, (101, 1, 1)), p, v, v, v))
    for k in range(11):
        fusion.take(PrismFix(end_ns - (10 - k) * 100_000_000, np.zeros(3)), filter, recent)
    assert_allclose(filter.state.v, v[-1], atol=0.01)
    assert filter.P[VELOCITY, VELOCITY].max() < 0.01**2


def test_standstill_and_turn_on_bias(state):
    filter = filter_of(state)
    filter.P[GYRO_BIAS, GYRO_BIAS] = np.eye(3)
    filter.update(Standstill(1e-4))
    filter.update(TurnOnBias(1e-6))
    assert np.linalg.norm(filter.state.v) < 1e-3
    assert np.linalg.norm(filter.state.gyro_bias) < 1e-5


def test_the_earths_rate_leaves_the_bias_when_north_is_known(located):
    earth = Earth.of(EarthBlock(latitude_deg=40.0, grid_bearing_deg=25.0))
    located.T_map_odom[:3, :3] = so3_exp([0.0, 0.0, 1.0])
    horizontal = earth.rate * [1.0, 1.0, 0.0]
    own = np.array([1e-7, -2e-7, 3e-7])
    located.gyro_bias = own + located.R.T @ located.T_map_odom[:3, :3].T @ horizontal
    filter = filter_of(located)
    filter.P[GYRO_BIAS, GYRO_BIAS] = 1e-14 * np.eye(3)
    without_earth_rate(filter, earth, 1e-3, 0.01)
    assert_allclose(filter.state.gyro_bias, own, atol=1e-12)


def test_rate_in_odom_is_the_vertical_part_until_the_map_is_known(located):
    earth = Earth.of(EarthBlock(latitude_deg=40.0))
    up = np.array([0.0, 0.0, 1.0])
    assert_allclose(earth.rate_in_odom(up, None), earth.rate[2] * up)
    known = earth.rate_in_odom(up, located.T_map_odom)
    assert_allclose(located.T_map_odom[:3, :3] @ known, earth.rate, atol=1e-18)


G = np.array([0.0, 0.0, -9.81])


def bend(t):
    """A machine that speeds up along a bend: attitude, place, velocity, rate and specific force at times (n,)."""
    zero, radius, angle, turning = 0.0 * t, 4.0, 0.05 * t**2, 0.1 * t
    R = so3_exp(np.column_stack([zero, zero, angle]))
    p = radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle), zero])
    ahead, aside = np.column_stack([np.cos(angle), np.sin(angle), zero]), R[:, :, 1]
    a = radius * (0.1 * ahead + turning[:, None] ** 2 * aside)
    return (
        R,
        p,
        radius * turning[:, None] * ahead,
        turning[:, None] * [0.0, 0.0, 1.0],
        np.einsum("nji,nj->ni", R, a - G),
    )


def driven(state, rng, *, offset_s, clock_std, late_s=0.0, seconds=3.0, place_std=0.05):
    """A filter round the bend, with fixes that come ``late_s`` late, with stamps that are ``offset_s`` short.

    It knows all but its place and the clock.
    """
    t = np.linspace(0.5, 0.5 + seconds, round(200 * seconds) + 1)
    stamps, (R, p, v, gyro, accel) = np.round(t * 1e9).astype(np.int64), bend(t)
    state.T_map_odom, state.odom_centre = np.eye(4), np.zeros(3)
    state.R, state.p, state.v, state.g = R[0], p[0] + place_std * rng.normal(size=3), v[0], G
    state.gyro_bias, state.accel_bias = np.zeros(3), np.zeros(3)
    filter = filter_of(state, 1e-4)
    filter.stamp_ns, filter.P[POSITION, POSITION] = int(stamps[0]), place_std**2 * np.eye(3)
    filter.P[CLOCK, CLOCK] = clock_std**2
    fusion = PrismFusion(STATION.model_copy(update={"time_offset_std": clock_std}), PrismSettings())
    recent = RecentMotion()
    for k in range(0, len(t) - 20, 20):
        part = slice(k, k + 21)
        recent.add(filter.predict(stamps[part], gyro[part], accel[part]))
        when = t[k + 20] - late_s
        if when < t[0]:
            continue
        R_then, p_then, *_ = bend(np.array([when]))
        fix = p_then[0] + R_then[0] @ LEVER + STATION.point_std * rng.normal(size=3)
        fusion.take(PrismFix(round((when - offset_s) * 1e9), fix), filter, recent)
    error = filter.state.p - p[-1]
    return filter, Clock.of(filter), error @ np.linalg.solve(filter.P[POSITION, POSITION], error) / 3.0, error


@pytest.mark.parametrize("offset_s", [-0.3, -0.1, 0.0, 0.1, 0.3])
def test_a_clock_that_is_off_is_found_on_the_way(state, rng, offset_s):
    _, clock, distance2, error = driven(state, rng, offset_s=offset_s, clock_std=0.1, late_s=0.1)
    assert abs(clock.offset_s - offset_s) < 3.5 * clock.std_s < 0.035
    assert distance2 < 4.0 and np.linalg.norm(error) < 0.01


def test_a_fix_that_comes_late_is_of_its_own_time(state, rng):
    _, _, distance2, error = driven(state, rng, offset_s=0.0, clock_std=0.0, late_s=0.3)
    assert distance2 < 4.0 and np.linalg.norm(error) < 0.01


def test_a_clock_taken_at_its_word_is_not_estimated(state, rng):
    filter, clock, *_ = driven(state, rng, offset_s=0.0, clock_std=0.0)
    assert clock == Clock() and not filter.P[CLOCK].any()


@pytest.mark.parametrize("along", [True, False])
def test_fixes_that_are_off_along_the_way_cast_doubt_on_the_clock(located, along):
    filter, fusion = filter_of(located, std=0.003), PrismFusion(STATION, PrismSettings())
    way = located.T_map_odom[:3, :3] @ located.v / np.linalg.norm(located.v)
    off = 0.6 * (way if along else np.cross(way, [0.6, 0.0, 0.8]))
    for k in range(PrismSettings().contradicting):
        fusion.take(PrismFix(k, prism_of(located) + off), filter)
    assert fusion.doubts == 1
    assert bool(filter.P[CLOCK].any()) == along


def test_the_recent_path_goes_along_with_what_was_learnt(state, rng):
    """A step of the pose between two tracks is none of the motion, and neither is one of the speed."""
    t = np.linspace(0.0, 1.0, 201)
    stamps, (_, p, v, gyro, accel) = np.round(t * 1e9).astype(np.int64), bend(t)
    state.R, state.p, state.v, state.g = np.eye(3), p[0], v[0] + [0.3, 0.0, 0.0], G
    state.gyro_bias, state.accel_bias = np.zeros(3), np.zeros(3)
    filter, recent = filter_of(state), RecentMotion()
    recent.add(filter.predict(stamps[:101], gyro[:101], accel[:101]))
    turned = so3_exp([0.0, 0.0, 0.5])
    R, p, v, *_ = bend(t[100:101])
    filter.state.R, filter.state.p, filter.state.v = turned @ R[0], turned @ p[0] + [1.0, 2.0, 3.0], turned @ v[0]
    recent.add(filter.predict(stamps[100:], gyro[100:], accel[100:]))
    now, path = filter.state, recent.path(LEVER, filter.state)
    for ago_s in (0.0, 0.2, 0.7):
        R, p, v, *_ = bend(t[-1:] - ago_s)
        true = turned @ (p[0] + R[0] @ LEVER) + [1.0, 2.0, 3.0]
        assert_allclose(now.p + now.R @ path.at(-ago_s)[0] - now.v * ago_s, true, atol=2e-4)
        assert_allclose(now.v - recent.faster_by(int(stamps[-1] - ago_s * 1e9)), turned @ v[0], atol=2e-3)
