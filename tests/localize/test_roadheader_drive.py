"""A roadheader in sight of the total station: it starts by the earth's rate, and dust that blinds the LiDAR is told."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from localize import Localizer
from semmap.geometry import so3_log
from semmap.measurements import PrismFix
from tools.simulator import SensorFaults, SimulationSettings, fly, scenario, simulate_measurements
from tools.simulator.settings import MotionSettings

MOTION = MotionSettings(still_s=25.0, speed=0.6, max_accel=0.4, schedule=((3.0, 1.0), (1.0, 2.0)))


@cache
def drive(dust, seed=1):
    """The built-in robot with its IMU at 200 Hz and few beams, at rest for 25 s, then forward and back."""
    mine = scenario("roadway", seed)
    rig = mine.scenario.robot.rig
    slower = {
        "imu": rig.imu.model_copy(update={"rate_hz": 200.0}),
        "lidar": rig.lidar.model_copy(update={"columns": 360}),
    }
    settings = SimulationSettings(motion=MOTION, faults=SensorFaults(dust=dust, prism_outlier_rate=0.08))
    it = fly(mine, None, rig.model_copy(update=slower), settings=settings, seed=seed)
    return it, tuple(simulate_measurements(it))


def localized(rig, measurements):
    localizer = Localizer(rig)
    for measurement in measurements:
        localizer.add(measurement)
    return localizer.finish()


def errors(trajectory, truth):
    true = truth.at(trajectory.stamps_ns)
    turn = so3_log(trajectory.poses[:, :3, :3] @ np.swapaxes(true[:, :3, :3], 1, 2))
    return np.linalg.norm(trajectory.positions - true[:, :3, 3], axis=1), np.degrees(np.abs(turn[:, :2]).max(axis=1))


def test_full_dust():
    it, measurements = drive(200.0)
    result = localized(it.rig, measurements)
    off, lean = errors(result.realtime, it.truth())
    assert len(off) > 60
    assert np.sqrt(np.mean(off**2)) < 0.03
    assert np.sqrt(np.mean(lean**2)) < 0.05
    kinds = {event["kind"]: event for event in result.events}
    assert kinds["anchored"]["by"] == "earth rate and fixes"
    assert kinds["dust"]["begun"] and kinds["dust"]["share"] > 0.3
    assert kinds["prism_refused"]["off_m"] > 0.02


def test_every_fix_is_counted_once():
    it, measurements = drive(200.0)
    localizer = Localizer(it.rig)
    forwarded = []
    take = localizer._odometry.add
    localizer._odometry.add = lambda m: (forwarded.append(m) if isinstance(m, PrismFix) else None, take(m))[1]
    waiting = []
    for measurement in measurements:
        localizer.add(measurement)
        if isinstance(measurement, PrismFix) and localizer._sightings.sightings.shared:
            to_filter = bool(forwarded) and forwarded[-1].stamp_ns == measurement.stamp_ns
            to_graph = any(m.stamp_ns == measurement.stamp_ns for m, _ in localizer._sightings.sightings._waiting)
            waiting.append((to_filter, to_graph))
    assert len(waiting) > 20
    assert all(to_filter != to_graph for to_filter, to_graph in waiting)
    assert 0.2 < np.mean([to_filter for to_filter, _ in waiting]) < 0.8


@pytest.mark.slow
@pytest.mark.parametrize("lever", [(0.0, 0.0, 0.3), (-1.5, 0.4, 1.0)])
@pytest.mark.parametrize("prism_hz", [1.0, 10.0])
def test_other_prisms(lever, prism_hz):
    it, _ = drive(0.0)
    station = it.rig.total_station.model_copy(update={"p_imu_prism": lever, "rate_hz": prism_hz})
    it = replace(it, rig=it.rig.model_copy(update={"total_station": station}))
    result = localized(it.rig, simulate_measurements(it))
    off, _ = errors(result.realtime, it.truth())
    assert np.sqrt(np.mean(off**2)) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [100.0, 400.0])
def test_other_imu_rates(rate_hz):
    it, _ = drive(0.0)
    imu = it.rig.imu.model_copy(update={"rate_hz": rate_hz})
    it = replace(it, rig=it.rig.model_copy(update={"imu": imu}))
    result = localized(it.rig, simulate_measurements(it))
    off, lean = errors(result.realtime, it.truth())
    assert np.sqrt(np.mean(off**2)) < 0.03
    assert np.sqrt(np.mean(lean**2)) < 0.1
