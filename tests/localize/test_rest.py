"""A robot that stands still is known by scans that repeat themselves."""

import numpy as np
import pytest

from localize.odometry import OdometryPose
from localize.rest import MOVED_M, still_seconds
from localize.settings import KeyframeSettings, OdometrySettings
from localize.start import StartingOdometry
from semmap.geometry import inverse
from semmap.measurements import Scan
from tools.simulator import SensorFaults, SimulationSettings, default_rig, fly, scenario, simulate_measurements
from tools.simulator.settings import MotionSettings


def flown(name, seed, *, seconds, speed=2.0, start=0.0, still=2.0, **faults):
    return fly(
        scenario(name, seed=seed),
        rig=default_rig().without("wheel"),
        settings=SimulationSettings(
            duration_s=seconds, start_s=start, motion=MotionSettings(speed=speed, still_s=still),
            faults=SensorFaults(**faults),
        ),
        seed=seed,
    )  # fmt: skip


def scans_of(flight):
    return [m for m in simulate_measurements(flight) if isinstance(m, Scan)]


@pytest.mark.parametrize(("name", "seed"), [("random", 15), ("demo", 1), ("grid", 2)])
def test_a_robot_at_rest_stands_still_as_long_as_it_does(name, seed):
    scans = scans_of(flown(name, seed, seconds=4.0, still=1.5))
    assert 1.2 <= still_seconds(scans) <= 2.1  # it sets off with 0.5 m/s²
    assert still_seconds(scans[:10]) == pytest.approx(0.9)


@pytest.mark.parametrize(("name", "seed"), [("random", 1), ("demo", 2), ("ramp", 1)])
@pytest.mark.parametrize("speed", [0.3, 2.0])
def test_a_robot_in_motion_does_not_stand_still(name, seed, speed):
    assert still_seconds(scans_of(flown(name, seed, seconds=2.0, speed=speed, start=12.0 / speed))) == 0.0


def test_noise_and_lost_returns_are_no_motion():
    scans = scans_of(flown("random", 3, seconds=2.0, still=3.0, noise=3.0, lidar_dropout=0.3))
    assert still_seconds(scans) == pytest.approx(1.9)


def test_scans_that_hold_next_to_nothing_tell_nothing():
    empty = Scan(0, np.empty((0, 3), np.float32), np.empty(0, np.int64))
    later = Scan(10**8, np.empty((0, 3), np.float32), np.empty(0, np.int64))
    assert still_seconds([empty, later]) == 0.0 and still_seconds([]) == 0.0


@pytest.mark.parametrize("seed", [3, 12, 15])
def test_moving_off_from_a_place_that_shows_little_of_its_floor(seed):
    """The first map knows little of the height; what the robot sees as it moves off must not carry it up or down."""
    flight = flown("random", seed, seconds=6.0)
    odometry = StartingOdometry(flight.rig, OdometrySettings(), KeyframeSettings())
    poses: list[OdometryPose] = [pose for m in simulate_measurements(flight) for pose in odometry.add(m)]
    stamps = np.array([pose.stamp_ns for pose in poses])
    true = flight.motion(flight.times(stamps)).poses()
    first = flight.motion(flight.times(flight.stamps(200.0)[:1])).poses()[0]
    error = (odometry.T_odom_start @ inverse(first) @ true)[:, :3, 3] - [pose.state.p for pose in poses]
    sigma = np.array([np.sqrt(np.diag(pose.covariance)[3:6]) for pose in poses])
    assert np.abs(error).max() < 0.08
    assert (np.abs(error[10:]) / sigma[10:]).max() < 4.0
    assert np.linalg.norm(poses[0].state.v) < 3.0 * MOVED_M
