"""What the bench of look-alike crossings counts, and what it carries off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from localize import Update
from semmap.geometry import Array, se3
from semmap.measurements import ImuSample, Scan
from semmap.trajectory import Trajectory
from tools.bench.lookalikes import carried_off, twins, wrong_poses
from tools.bench.odometry_cache import Recorded, RecordedWriter

STEP_NS = 100_000_000


@pytest.mark.parametrize("seed", [1, 2])
def test_twins_are_crossings_of_one_plan(seed: int) -> None:
    mine = twins(seed)
    crossings = [node for node in mine.nodes if node[-1] not in "xy"]
    ways = {node: sum(node in (road.start, road.end) for road in mine.roadways) for node in crossings}
    assert len(crossings) == 12 and set(ways.values()) == {4}
    assert len({(road.width, road.height, road.roughness) for road in mine.roadways}) == 1


def update(x: float, std: float) -> Update:
    covariance: Array = np.diag([1e-6, 1e-6, 1e-6, std**2, 1e-4, 1e-4])
    return Update(0, np.eye(4), se3(np.eye(3), [x, 0.0, 0.0]), covariance, "tracking")


def test_a_pose_is_wrong_if_it_is_far_off_and_does_not_say_so() -> None:
    truth = Trajectory("map", np.array([0, STEP_NS]), np.tile(np.eye(4), (2, 1, 1)))
    assert wrong_poses([update(0.2, 0.01), update(5.0, 3.0)], truth) == 0
    assert wrong_poses([update(0.4, 0.05), update(5.0, 1.0)], truth) == 2


def recording(path: Path, scans: int) -> Recorded:
    """Scans of one beam of four columns; the first range of each is its number in metres; ten IMU samples a scan."""
    directions = np.tile(np.array([1.0, 0.0, 0.0], np.float32), (1, 4, 1))
    offsets_ns = np.arange(4) * (STEP_NS // 4)
    with RecordedWriter(path, directions, offsets_ns, {"rig": {}, "T_imu_lidar": np.eye(4)[:3].tolist()}) as out:
        for k in range(scans):
            out.write(k * STEP_NS, np.zeros(4, int), offsets_ns, np.full(4, 1.0 + k))
        stamps = np.arange(10 * scans + 1) * (STEP_NS // 10)
        still = np.zeros((len(stamps), 3))
        out.finish((stamps, still, still), (stamps[:2], np.tile(np.eye(4), (2, 1, 1))))
    return Recorded.open(path)


@pytest.mark.parametrize("gap_ns", [0, 20 * STEP_NS])
def test_a_robot_that_is_carried_off_goes_on_elsewhere(tmp_path: Path, gap_ns: int) -> None:
    flight = recording(tmp_path / "one", 40)
    joined = list(carried_off(flight, 10, 25, 15 * STEP_NS - gap_ns))
    scans = [m for m in joined if isinstance(m, Scan)]
    seen = [round(float(scan.points[0, 0])) - 1 for scan in scans]
    assert seen[:9] == list(range(9)) and seen[-1] == 39 and not set(range(10, 25)) & set(seen)
    imu_ns = np.diff([m.stamp_ns for m in joined if isinstance(m, ImuSample)])
    assert (imu_ns > 0).all() and sorted(imu_ns)[-2] == STEP_NS // 10
    assert imu_ns.max() == STEP_NS // 10 + gap_ns
