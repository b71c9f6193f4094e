"""When the odometry has broken off, and when it only looks so."""

from types import SimpleNamespace

import numpy as np
import pytest

from localize.breaks import BreakWatch
from localize.frames import going_on
from localize.graph import PoseGraph
from localize.legs import Leg, joined
from localize.settings import BreakSettings, GraphSettings
from semmap.geometry import inverse, se3, se3_exp, yaw_of, yaw_rotation


def watch(shares, *, keyframes=10, points=1000, dust=0.0):
    """Which of some scans, by the share of their points that meets the map, are a break."""
    breaks = BreakWatch(BreakSettings())
    scans = [SimpleNamespace(matched=round(share * points), considered=points, dust=dust) for share in shares]
    return [breaks.leaves_map(scan, keyframes) for scan in scans]


def test_a_scan_of_another_place_is_a_break_with_the_next():
    assert watch([0.9, 0.9, 0.1, 0.4]) == [False, False, False, True]


@pytest.mark.parametrize("shares", [[0.9] * 6, [0.9, 0.1, 0.9, 0.9], [0.5] * 6, [0.9, 0.6, 0.45, 0.42, 0.41]])
def test_new_rock_and_a_cloud_of_dust_are_none(shares):
    assert not any(watch(shares))


def test_without_a_map_or_points_there_is_nothing_to_break_with():
    assert not any(watch([0.1] * 5, keyframes=2)) and not any(watch([0.1] * 5, points=40))


def test_in_dust_scans_do_not_tell_whether_the_robot_was_carried_off():
    assert not any(watch([0.9, 0.9, 0.1, 0.1, 0.1], dust=0.5))


def test_a_silence_of_the_imu_is_told_once():
    breaks = BreakWatch(BreakSettings(gap_s=1.0))
    assert [breaks.silence_s(round(t * 1e9)) for t in (0.0, 0.9, 5.0, 5.1, 4.0)] == [
        0.0,
        0.0,
        pytest.approx(4.1),
        0.0,
        0.0,
    ]


def test_odom_goes_on_upright_where_it_ended():
    last, begin = (
        se3(yaw_rotation(1.0), [5.0, 6.0, 7.0]) @ se3_exp([0.1, -0.05, 0, 0, 0, 0]),
        se3_exp([0.02, 0, 0, 1, 0, 0]),
    )
    T = going_on(last, begin)
    np.testing.assert_allclose((T @ begin)[:3, 3], last[:3, 3], atol=1e-12)
    np.testing.assert_allclose(T[2, :3], [0.0, 0.0, 1.0], atol=1e-12)
    assert yaw_of((T @ begin)[:3, :3]) == pytest.approx(yaw_of(last[:3, :3]), abs=2e-3)


def leg(n, first=0):
    graph = PoseGraph(GraphSettings())
    poses = [se3(np.eye(3), [float(k), 0.0, 0.0]) for k in range(n)]
    one = Leg(graph, first)
    for k, T in enumerate(poses):
        graph.add_keyframe(T, np.array([0.0, 0.0, 1.0]), inverse(poses[max(0, k - 1)]) @ T, 1e-4 * np.eye(6))
        one.keyframes.append((10 * k, T))
        one.odometry += [(10 * k, T), (10 * k + 5, T @ se3_exp([0, 0, 0, 0.5, 0, 0]))]
    return one


def test_a_split_leg_ends_with_its_last_pin():
    whole = leg(10, first=100)
    whole.last_pin_ns = 30
    rest = whole.split(106)
    assert [stamp for stamp, _ in rest.keyframes] == [60, 70, 80, 90] and rest.first_keyframe == 106
    assert whole.odometry[-1][0] == 30 and rest.odometry[0][0] == 60
    assert len(rest.graph) == 4


def test_only_legs_with_a_place_have_poses_in_the_map():
    known, unknown = leg(5), leg(5)
    T = se3(yaw_rotation(0.5), [3.0, 2.0, 1.0])
    known.graph.anchor(T)
    known.graph.pin_intersection(2, 1, np.eye(4), T @ known.keyframes[2][1], 1e-6 * np.eye(6))
    track = joined([known.smoothed(), unknown.smoothed()], "map")
    assert len(track) == 10
    np.testing.assert_allclose(track.poses[4], T @ known.keyframes[2][1], atol=1e-3)
