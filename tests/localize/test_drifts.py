"""Behind a smooth drift, without a wheel: odometry slid by metres and comes to the next crossing in one jump."""

from functools import cache

import numpy as np
import pytest

from localize import Localizer
from localize.settings import KeyframeSettings, OdometrySettings
from localize.start import StartingOdometry
from semmap.geometry import inverse
from tools.bench.drift_mines import drift_rig, drifts
from tools.bench.mines import map_of
from tools.simulator import SimulationSettings, dig, fly, simulate_measurements

pytestmark = pytest.mark.slow


@cache
def flight():
    it = fly(dig(drifts(1, crossings=2)), rig=drift_rig().without("wheel"), settings=SimulationSettings(), seed=1)
    return it, tuple(simulate_measurements(it))


def test_ways_between_keyframes_are_off_by_what_they_say_though_the_pose_jumps():
    it, measurements = flight()
    odometry = StartingOdometry(it.rig, OdometrySettings(), KeyframeSettings())
    poses = [pose for m in measurements for pose in odometry.add(m)]
    keyframes = [pose for pose in poses if pose.keyframe]
    true = it.truth().at(np.array([pose.stamp_ns for pose in keyframes]))
    squared, jumps = [], []
    for before, pose, T_before, T in zip(keyframes, keyframes[1:], true, true[1:], strict=False):
        way, covariance = pose.T_keyframe_imu, pose.since_keyframe[3:, 3:]
        # the error of the position in the axes that the covariance is in
        off = T[:3, :3].T @ T_before[:3, :3] @ way[:3, 3] - (T[:3, :3].T @ (T[:3, 3] - T_before[:3, 3]))
        squared.append(off @ np.linalg.solve(covariance, off) / 3.0)
        jumps.append(np.linalg.norm((inverse(before.T_odom_imu) @ pose.T_odom_imu)[:3, 3] - way[:3, 3]))
    assert max(jumps) > 3.0
    assert 0.2 < np.mean(squared) < 3.0


def test_crossings_are_recognised_behind_it_and_pins_are_right():
    it, measurements = flight()
    localizer = Localizer(it.rig, map_of(it.mine, 1))
    for m in measurements:
        localizer.add(m)
    result, truth = localizer.finish(), it.truth()
    pins = [pin for event in result.events if event["kind"] == "intersection" for pin in event["pins"]]
    assert {pin["id"] for pin in pins} == {0, 1}
    off = [pin["p_map"] - truth.at(np.array([pin["stamp_ns"]]))[0, :3, 3] for pin in pins]
    assert np.linalg.norm(off, axis=1).max() < 0.1
