"""Degenerate directions: by the covariance, by the scan, and told once."""

import numpy as np
import pytest

from localize.degeneracy import DegeneracyMonitor, degrees_per_metre, literal_degrees, weakest_of_scan
from localize.odometry import OdometryPose
from localize.settings import DegeneracySettings, KeyframeSettings, LocalizeSettings, ModeSettings, OdometrySettings
from localize.start import StartingOdometry
from semmap.geometry import inverse, so3_exp
from semmap.rig import LidarBlock
from tools.simulator import SimulationSettings, default_rig, fly, scenario, simulate_measurements


def rotated(diagonal, R):
    return R @ np.diag(diagonal) @ R.T


def parallel(a, b):
    """Angle [deg] between two axes."""
    return np.degrees(np.arccos(min(1.0, abs(float(np.dot(a, b))))))


def test_the_way_per_metre_has_the_largest_axis_of_its_covariance(rng):
    R, R_odom_imu = so3_exp(rng.normal(size=3)), so3_exp(rng.normal(size=3))
    link = np.zeros((6, 6))
    link[:3, :3], link[3:, 3:] = 1e-6 * np.eye(3), rotated([0.01, 0.04, 0.0001], R)
    degrees = degrees_per_metre(link, R_odom_imu, 2.0)
    assert degrees.translation.degree == pytest.approx(0.1)
    assert parallel(degrees.translation.direction, R_odom_imu @ R[:, 1]) < 1e-4
    assert degrees.rotation.degree == pytest.approx(5e-4)


def test_the_papers_m_is_the_square_where_nothing_couples():
    """Eq. 15, 16 as printed: eigenvalues are variances squared."""
    degrees = literal_degrees(np.diag([1e-3, 2e-3, 3e-3, 0.1, 0.3, 0.2]))
    assert degrees.translation.degree == pytest.approx(0.09)
    assert degrees.rotation.degree == pytest.approx(9e-6)
    np.testing.assert_allclose(np.abs(degrees.translation.direction), [0.0, 1.0, 0.0])


def planes(normals, points):
    """Information of points (n, 3) on planes with ``normals`` (n, 3), 1 cm each."""
    H = np.hstack([np.cross(points, normals), normals]) / 0.01
    return H.T @ H


def test_a_scan_of_a_tunnel_is_weak_along_it(rng):
    R = so3_exp(rng.normal(size=3))
    angle = rng.uniform(0.0, 2.0 * np.pi, size=500)
    walls = np.column_stack([np.zeros(500), np.cos(angle), np.sin(angle)])
    points = 2.0 * walls + np.outer(rng.uniform(-20, 20, size=500), [1.0, 0.0, 0.0])
    weakest = weakest_of_scan(planes(walls, points), R)
    assert weakest.degree == pytest.approx(1.0) and parallel(weakest.direction, R[:, 0]) < 0.1
    face = np.tile([1.0, 0.0, 0.0], (20, 1))
    seen = planes(walls, points) + planes(face, rng.uniform(-1, 1, size=(20, 3)))
    assert weakest_of_scan(seen, R).degree < 0.01


def test_a_scan_that_says_nothing_is_weak():
    assert weakest_of_scan(np.zeros((6, 6)), np.eye(3)).degree == pytest.approx(1.0)


def short_sighted(beams=16):
    rig = default_rig()
    lidar = rig.lidar.model_dump(exclude_unset=True) | {"max_range": 30.0, "columns": 600, "beams": beams}
    return rig.model_copy(update={"lidar": LidarBlock(**lidar)})


def watched(name, seed, start_s, duration_s, *, beams=16):
    """Events of a flight, the monitor after it, and what turns odom into the map."""
    rig = short_sighted(beams)
    settings = SimulationSettings(start_s=start_s, duration_s=duration_s)
    it = fly(scenario(name, seed=seed), rig=rig, settings=settings, seed=seed)
    odometry = StartingOdometry(rig, OdometrySettings(), KeyframeSettings())
    monitor, events, first = DegeneracyMonitor(DegeneracySettings(), KeyframeSettings()), [], None
    for measurement in simulate_measurements(it):
        for pose in odometry.add(measurement):
            first = first or pose
            events += monitor.watch(pose, ModeSettings())
    truth = it.truth().at(np.array([first.stamp_ns]))[0]
    return events, monitor, (truth @ inverse(first.T_odom_imu))[:3, :3]


@pytest.mark.parametrize(("seed", "beams"), [(1, 16), (2, 16), (3, 32)])
def test_in_a_smooth_drift_the_axis_is_told_once(seed, beams):
    """30 m of range, no end in sight: along the drift the LiDAR sees nothing."""
    events, monitor, R_map_odom = watched("drift", seed, 30.0, 8.0, beams=beams)
    scans = [event for event in events if event["of"] == "scan"]
    assert [event["begun"] for event in scans] == [True]
    assert parallel(R_map_odom @ scans[0]["direction_odom"], [1.0, 0.0, 0.0]) < 5.0
    assert monitor.degenerate and monitor.degree >= 1.0


@pytest.mark.parametrize("seed", [1, 2])
def test_in_rough_roadways_nothing_degenerates(seed):
    events, monitor, _ = watched("demo", seed, 5.0, 10.0)
    assert not events and not monitor.degenerate and monitor.degree < 0.6


def test_what_begins_ends_and_tells_its_worst():
    monitor = DegeneracyMonitor(DegeneracySettings(), KeyframeSettings())
    events = []
    for k, std in enumerate([0.01] * 20 + [0.2] * 5 + [0.01] * 20 + [0.1] * 20 + [0.3] * 20 + [0.01] * 20):
        A = np.diag([1e6, 1e6, 1e6, 1e6, std**-2, 1e6])
        events += monitor.watch(pose_with(A, k * 100_000_000), ModeSettings())
    assert [event["begun"] for event in events] == [True, False]
    assert events[1]["degree"] == pytest.approx(0.3, rel=0.1)
    assert [event["since_s"] for event in events] == pytest.approx([1.0, 5.0])
    np.testing.assert_allclose(events[1]["direction_odom"], [0.0, 1.0, 0.0], atol=1e-6)


def pose_with(A, stamp_ns):
    class At:
        R = np.eye(3)

    return OdometryPose(
        stamp_ns, At(), 1e-6 * np.eye(48), np.zeros((0, 3)), 0, 0, False, np.eye(4), np.zeros((6, 6)), A
    )  # fmt: skip


def test_the_papers_measure_is_a_choice():
    settings = LocalizeSettings.model_validate({"degeneracy": {"measure": "paper", "translation": 0.02}}).degeneracy
    monitor = DegeneracyMonitor(settings, KeyframeSettings())
    pose = pose_with(None, 0)
    pose.covariance[4, 4] = 0.3
    assert not monitor.watch(pose, ModeSettings())
    assert monitor.translation == pytest.approx(0.09) and monitor.degree == pytest.approx(0.09 / 0.02)
