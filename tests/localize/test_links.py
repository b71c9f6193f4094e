"""Links of the graph: their sum over a blind drift is the way's error, and elsewhere they stay what the filter says."""

from types import SimpleNamespace

import numpy as np
import pytest

from localize.links import LinkCovariances
from localize.settings import GraphSettings
from localize.state import POSITION, VELOCITY
from semmap.geometry import se3, yaw_rotation

SETTINGS = GraphSettings(link_correlation=1.0, drift_position=1e-6, drift_rotation=1e-6)
R = yaw_rotation(0.7)
SPEED_STD, STEP_S = 0.2, 0.5


def pose(k, drifted, *, blind):
    """Keyframe ``k``: the velocity forward is known to 0.2 m/s, the place after ``drifted`` keyframes of that, and the
    scan tells all, or all but the way forward."""
    P = np.zeros((48, 48))
    P[POSITION, POSITION] = R @ np.diag([drifted * SPEED_STD * STEP_S, 1e-3, 1e-3]) ** 2 @ R.T
    P[VELOCITY, VELOCITY] = R @ np.diag([SPEED_STD, 1e-3, 1e-3]) ** 2 @ R.T
    information = np.diag([1e6, 1e6, 1e6, 0.0 if blind else 1e6, 1e6, 1e6])
    link = np.diag([1e-4, 1e-4, 1e-4, SPEED_STD * STEP_S, 1e-3, 1e-3]) ** 2
    return SimpleNamespace(
        stamp_ns=round(k * STEP_S * 1e9), T_odom_imu=se3(R, [1.0 * k, 0.0, 0.0]), covariance=P,
        since_keyframe=link, scan_information=information, T_keyframe_imu=se3(np.eye(3), [1.0, 0.0, 0.0]),
    )  # fmt: skip


def chain(blind):
    links, total, drifted = LinkCovariances(SETTINGS, weak_std=0.05), np.zeros((6, 6)), 0
    for k, dark in enumerate(blind):
        drifted = drifted + 1 if dark and k else 0
        now = pose(k, drifted, blind=dark)
        if k:
            covariance = links.of(now)
            assert np.linalg.eigvalsh(covariance).min() > 0.0
            total += covariance
        links.keyframe(now)
    return np.sqrt(np.diag(total))


@pytest.mark.parametrize("n", [1, 10, 100])
def test_along_a_blind_drift_errors_add_up_and_not_their_squares(n):
    std = chain([True] * (n + 1))
    assert std[3] == pytest.approx(n * SPEED_STD * STEP_S, rel=0.02)
    assert std[4] == pytest.approx(1e-3 * np.sqrt(n), rel=0.02)


def test_where_scans_hold_the_velocity_links_are_independent():
    assert chain([False] * 101)[3] == pytest.approx(10.0 * SPEED_STD * STEP_S, rel=0.02)


def test_what_a_drift_was_off_by_ends_with_it():
    two = chain([*[True] * 50, *[False] * 5, *[True] * 50])
    one = chain([True] * 100)
    assert two[3] < 0.8 * one[3]


def test_along_a_drift_on_which_the_wheel_holds_the_speed_errors_do_not_add_up():
    """The filter knows that they do not: its place is off by the root of the sum of the squares."""
    links, total = LinkCovariances(SETTINGS, weak_std=0.05), 0.0
    for k in range(101):
        now = pose(k, np.sqrt(k), blind=True)
        total += links.of(now)[3, 3] if k else 0.0
        links.keyframe(now)
    assert np.sqrt(total) == pytest.approx(10.0 * SPEED_STD * STEP_S, rel=0.02)
