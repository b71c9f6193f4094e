"""The speed of a robot that is already under way when its recording begins."""

import numpy as np
import pytest

from localize.first_motion import first_velocity
from semmap.geometry import se3, so3_exp
from semmap.measurements import Scan
from tools.simulator import SimulationSettings, default_rig, fly, scenario, simulate_measurements

RIG = default_rig().without("wheel")


def under_way(seed, start_s=12.0, seconds=0.8):
    flight = fly(
        scenario("random", seed=seed),
        rig=RIG,
        settings=SimulationSettings(duration_s=seconds, start_s=start_s),
        seed=seed,
    )
    scans = [m for m in simulate_measurements(flight) if isinstance(m, Scan)]
    motion = flight.motion(flight.times(np.array([scans[1].end_ns])))
    return scans, (motion.velocity @ motion.poses()[0, :3, :3])[0]


@pytest.mark.parametrize("seed", [1, 14, 15, 17])
def test_velocity_between_scans_is_the_true_one(seed):
    scans, true = under_way(seed)
    np.testing.assert_allclose(first_velocity(scans, RIG.lidar.T_imu_lidar), true, atol=0.1)


def test_velocity_is_that_of_the_imu_however_the_lidar_is_mounted():
    scans, true = under_way(17)
    T_lidar_turned = se3(so3_exp([0.2, -0.4, 2.0]), np.array([0.3, -0.2, 0.1]))
    turned = [
        Scan(s.stamp_ns, (s.points - T_lidar_turned[:3, 3]) @ T_lidar_turned[:3, :3], s.offsets_ns) for s in scans
    ]
    found = first_velocity(turned, RIG.lidar.T_imu_lidar @ T_lidar_turned)
    np.testing.assert_allclose(found, true, atol=0.1)


def test_too_few_scans_or_points_tell_nothing():
    scans, _ = under_way(1)
    assert first_velocity(scans[:1], RIG.lidar.T_imu_lidar) is None
    empty = [Scan(s.stamp_ns, s.points[:10], s.offsets_ns[:10]) for s in scans]
    assert first_velocity(empty, RIG.lidar.T_imu_lidar) is None
