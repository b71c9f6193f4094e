"""The roadheader in its roadway: it reverses, its IMU feels the earth, its fixes go wrong as told, dust blinds it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from localize.earth import Earth
from tools.simulator import SensorFaults, SimulationSettings, fly, scenario
from tools.simulator.dust import dusty
from tools.simulator.flight import EPOCH_NS
from tools.simulator.roadheader import CONSUMER, EARTH
from tools.simulator.total_station import prism_fixes

MINE = scenario("roadway-consumer", 2)


def flight(**faults):
    return fly(MINE, seed=2, settings=SimulationSettings(faults=SensorFaults(**faults)))


def test_it_goes_forward_and_back_in_reverse():
    motion = flight().motion
    t = np.arange(30.0, motion.duration_s, 0.1)
    state = motion(t)
    ahead = np.einsum("ni,ni->n", state.R_map_imu[:, :, 0], state.velocity)
    start = motion(np.array([0.0])).position[0]
    assert ahead.max() > 0.25
    assert ahead.min() < -0.25
    # sideways it shakes a little and goes nowhere
    assert np.abs(np.einsum("ni,ni->n", state.R_map_imu[:, :, 1], state.velocity)).max() < 0.05
    assert_allclose(state.position[-1], start, atol=0.02)
    assert np.abs(state.position[:, 0] - start[0] - 4.7).min() < 0.02
    yaw = np.degrees(np.arctan2(state.R_map_imu[:, 1, 0], state.R_map_imu[:, 0, 0]))
    assert 20.0 < yaw.max() < 30.0
    assert motion.length == pytest.approx(2 * 4.7 + 2 * 7.2, abs=0.1)


def test_the_schedule_rests():
    motion = flight().motion
    t = np.arange(0.0, motion.duration_s, 0.05)
    path = motion(t).velocity.copy()
    still = np.linalg.norm(path, axis=1) < 0.02
    begins = np.flatnonzero(np.diff(still.astype(int)) == 1)
    assert len(begins) == 9


@pytest.mark.parametrize("t", [3.0, 40.0, 88.0])
def test_the_imu_feels_the_earth(t):
    earth = Earth.of(EARTH)
    state = flight().motion(np.array([t]))
    rate, force = state.felt(earth)
    assert_allclose(rate - state.angular_velocity, (state.R_map_imu[0].T @ earth.rate)[None], atol=1e-7)
    still = Earth.of(None)
    assert_allclose(state.felt(still)[1], state.specific_force(), atol=1e-12)
    coriolis = force - state.felt(still)[1] - state.R_map_imu[0].T @ [0.0, 0.0, earth.gravity - still.gravity]
    assert np.abs(coriolis).max() < 2.1 * np.linalg.norm(earth.rate) * np.linalg.norm(state.velocity) + 1e-6


def test_fixes_hidden_wrong_and_on_another_clock():
    sound = {fix.stamp_ns: fix.p_map for fix in prism_fixes(flight())}
    hidden = {fix.stamp_ns for fix in prism_fixes(flight(prism_hidden_s=(50.0, 80.0)))}
    gone = np.array(sorted(set(sound) - hidden)) - EPOCH_NS
    assert gone.min() >= 50e9 and gone.max() < 80e9
    late = {fix.stamp_ns: fix.p_map for fix in prism_fixes(flight(prism_clock_s=1.5))}
    assert sorted(late) == [stamp + 1_500_000_000 for stamp in sorted(sound)]
    wrong = [np.linalg.norm(fix.p_map - sound[fix.stamp_ns]) for fix in prism_fixes(flight(prism_outlier_rate=0.2))]
    assert 0.1 < np.mean(np.array(wrong) > 0.02) < 0.3


def test_dust_of_paper_002_blinds_and_thin_dust_does_not():
    rng = np.random.default_rng(3)
    ranges, kept = np.full(14400, 4.0, np.float32), np.ones(14400, bool)
    share = {}
    for dust in (0.0, 25.0, 200.0):
        seen, back = dusty(ranges, kept, dust, 900, rng)
        share[dust] = np.mean(back & (seen == 4.0))
    assert share[0.0] == 1.0
    assert 0.5 < share[25.0] < 0.9
    assert share[200.0] < 0.2


def test_the_consumer_imu_is_another_robot():
    assert MINE.scenario.robot.rig.imu == CONSUMER
