"""Prism fixes in the filter: Jacobian, gate, a filter that was wrong, a machine that stands, the earth's rate."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from localize.earth import Earth
from localize.filter import ErrorStateFilter
from localize.prism import PrismFusion, PrismPosition, Standstill, TurnOnBias, without_earth_rate
from localize.settings import PrismSettings
from localize.state import GYRO_BIAS, ODOM, POSITION, ROTATION, VELOCITY
from semmap.geometry import so3_exp
from semmap.measurements import PrismFix
from semmap.rig import EarthBlock, ImuBlock, TotalStationBlock

STATION = TotalStationBlock(position=(0.0, 0.0, 1.5), point_std=0.002, p_imu_prism=(0.1, 0.8, 0.4))
LEVER = np.array(STATION.p_imu_prism)


def filter_of(state, std=0.05) -> ErrorStateFilter:
    P = np.zeros((state.dim, state.dim))
    for columns in (ROTATION, POSITION, VELOCITY, ODOM)[: 3 if state.T_map_odom is None else 4]:
        P[columns, columns] = std**2 * np.eye(columns.stop - columns.start)
    return ErrorStateFilter(state, P, 0, ImuBlock(topic="/imu"))


def prism_of(state):
    return state.T_map_odom[:3, :3] @ (state.p + state.R @ LEVER) + state.T_map_odom[:3, 3]


def test_jacobian(located, rng, check_jacobian):
    model = PrismPosition(rng.normal(size=3), LEVER, 0.002)
    check_jacobian(model.residual, model.jacobian(located), located, np.r_[ROTATION, POSITION, ODOM])


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
