"""A machine without LiDAR, or in dust, finds its place on the way: from any heading, and none that is wrong."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from localize import Localizer
from localize.earth import Earth
from localize.ins_start import moving_start
from localize.ins_total_station import DIM, InsState
from semmap.geometry import so3_exp, so3_log, yaw_of
from semmap.measurements import PrismFix
from semmap.rig import EarthBlock
from tools.simulator import SensorFaults, SimulationSettings, fly, scenario, simulate_measurements
from tools.simulator.flight import EPOCH_NS
from tools.simulator.roadheader import CONSUMER, roadheader_rig
from tools.simulator.settings import MotionSettings

MOTION = MotionSettings(still_s=8.0, speed=0.6, max_accel=0.4, schedule=((3.0, 1.0), (1.0, 2.0)))


@cache
def drive(seed, outliers=0.0):
    """A coarse IMU that nothing shakes, and a prism; no LiDAR."""
    mine = scenario("roadway-consumer", seed)
    rig = mine.scenario.robot.rig
    rig = rig.without("lidar").model_copy(update={"imu": rig.imu.model_copy(update={"engines": False})})
    settings = SimulationSettings(motion=MOTION, faults=SensorFaults(prism_outlier_rate=outliers))
    it = fly(mine, None, rig, settings=settings, seed=seed)
    return it, tuple(simulate_measurements(it))


def updates(it, measurements):
    localizer = Localizer(it.rig)
    found = [update for m in measurements if (update := localizer.add(m)) is not None]
    return [update for update in found if update.T_map_imu is not None], localizer.finish()


@pytest.mark.parametrize(("seed", "outliers", "from_s"), [(1, 0.0, 0.0), (2, 0.08, 0.0), (3, 0.0, 9.5)])
def test_it_finds_its_place_on_the_way(seed, outliers, from_s):
    it, measurements = drive(seed, outliers)
    known, result = updates(it, [m for m in measurements if m.stamp_ns >= EPOCH_NS + from_s * 1e9])
    anchored = [event for event in result.events if event["kind"] == "anchored"]
    assert [event["by"] for event in anchored] == ["INS and fixes on the way"]
    truth = it.truth()
    true = truth.at(np.array([update.stamp_ns for update in known]))
    if from_s:
        assert (known[0].stamp_ns - EPOCH_NS) * 1e-9 < from_s + 9.0
    else:
        moved = true[0, :3, 3] - truth.at(np.array([measurements[0].stamp_ns]))[0, :3, 3]
        assert np.linalg.norm(moved) < 1.5
    squares = []
    for update, T in zip(known, true, strict=True):
        R = update.T_map_imu[:3, :3]
        off = np.concatenate([so3_log(R.T @ T[:3, :3]), R.T @ (T[:3, 3] - update.T_map_imu[:3, 3])])
        blocks = [slice(0, 3), slice(3, 6)]
        squares.append([off[b] @ np.linalg.solve(update.covariance[b, b], off[b]) for b in blocks])
    assert np.median(squares, axis=0).max() < 9.0
    off = np.linalg.norm(result.realtime.positions - truth.at(result.realtime.stamps_ns)[:, :3, 3], axis=1)
    assert np.sqrt(np.mean(off[len(off) // 2 :] ** 2)) < 0.05


def test_one_that_stands_has_no_heading():
    it, measurements = drive(1)
    known, _ = updates(it, [m for m in measurements if m.stamp_ns < EPOCH_NS + 8e9])
    assert not known


@pytest.mark.parametrize("what", ["mirrored", "frozen clock"])
def test_fixes_of_something_else_give_no_place(what):
    """Fixes whose way no heading explains: mirrored ones turn the other way, a slow clock stretches the drive."""
    it, measurements = drive(1)
    begin_ns = measurements[0].stamp_ns

    def wrong(fix):
        if what == "mirrored":
            return PrismFix(fix.stamp_ns, fix.p_map * [1.0, 1.0, -3.0])
        return PrismFix(begin_ns + round(1.3 * (fix.stamp_ns - begin_ns)), fix.p_map)

    told = [wrong(m) if isinstance(m, PrismFix) else m for m in measurements]
    known, _ = updates(it, sorted(told, key=lambda m: m.stamp_ns))
    true = it.truth().at(np.array([update.stamp_ns for update in known] or [begin_ns]))
    turns = [
        np.degrees(np.abs(so3_log(update.T_map_imu[:3, :3] @ T[:3, :3].T)[2]))
        for update, T in zip(known, true, strict=False)
    ]
    assert max(turns, default=0.0) < 10.0


def test_the_covariance_of_a_start_on_the_way_is_that_of_its_errors():
    """A machine that drives a bend, its heading supposed off by as much as it says."""
    earth, station = Earth.of(EarthBlock(latitude_deg=37.87)), roadheader_rig(CONSUMER).total_station
    lever, heading_std, squares = np.array(station.p_imu_prism), 0.1, []
    for seed in range(60):
        rng = np.random.default_rng([seed, 5])
        R = so3_exp([0.0, 0.0, rng.uniform(-3.0, 3.0)]) @ so3_exp([0.03, -0.05, 0.0])
        a, v, turning = R @ [0.2, 0.05, 0.0], R @ [0.5, 0.0, 0.0], np.array([0.0, 0.0, 0.05])
        fixes = []
        for t in np.linspace(-1.4, 0.0, 8):
            at = 0.5 * t**2 * a + t * v + R @ so3_exp(t * turning) @ lever
            fixes.append(PrismFix(round(1e9 * (t + 2.0)), at + station.point_std * rng.normal(size=3)))
        gyro = turning + CONSUMER.gyro_bias_std * rng.normal(size=3)
        felt = so3_exp(-0.7 * turning) @ R.T @ (a + [0.0, 0.0, earth.gravity])
        accel = felt + CONSUMER.accel_bias_std * rng.normal(size=3)
        heading = yaw_of(R) + heading_std * rng.normal()
        state, P = moving_start(fixes, gyro, accel, heading, heading_std, CONSUMER, station, earth)
        off = InsState(R, np.zeros(3), v, state.gyro_bias, state.accel_bias).boxminus(state)
        squares.append(off[:9] @ np.linalg.solve(P[:9, :9], off[:9]))
    assert P.shape == (DIM, DIM)
    # no surer than it may be; it takes the lean and the speed for a little less known than they are
    assert np.mean(squares) < 12.0
    assert np.mean(squares) > 2.0
