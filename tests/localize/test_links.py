"""Links of the graph: their sum over a blind drift is the way's error, and elsewhere they stay what the filter says."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from localize.links import LinkCovariances
from localize.settings import GraphSettings
from localize.state import VELOCITY
from semmap.geometry import se3, yaw_rotation

SETTINGS = GraphSettings(link_correlation=1.0, drift_position=1e-6, drift_rotation=1e-6)
R = yaw_rotation(0.7)
SPEED_STD, STEP_S = 0.2, 0.5


def pose(k, *, blind):
    """Keyframe ``k``: the velocity forward is known to 0.2 m/s, and the scan tells all, or all but the way forward."""
    P = np.zeros((48, 48))
    P[VELOCITY, VELOCITY] = R @ np.diag([SPEED_STD, 1e-3, 1e-3]) ** 2 @ R.T
    information = np.diag([1e6, 1e6, 1e6, 0.0 if blind else 1e6, 1e6, 1e6])
    link = np.diag([1e-4, 1e-4, 1e-4, SPEED_STD * STEP_S, 1e-3, 1e-3]) ** 2
    return SimpleNamespace(
        stamp_ns=round(k * STEP_S * 1e9), T_odom_imu=se3(R, [1.0 * k, 0.0, 0.0]), covariance=P,
        since_keyframe=link, scan_information=information, T_keyframe_imu=se3(np.eye(3), [1.0, 0.0, 0.0]),
    )  # fmt: skip


def sure(k):
    """Keyframe ``k``, of which the filter says that it knows the velocity to a millimetre a second, and the way."""
    now = pose(k, blind=False)
    now.covariance[VELOCITY, VELOCITY] = 1e-6 * np.eye(3)
    now.since_keyframe[3, 3] = 1e-6
    return now


def chain(blind):
    links, total = LinkCovariances(SETTINGS, weak_std=0.05), np.zeros((6, 6))
    for k, dark in enumerate(blind):
        now = pose(k, blind=dark)
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


def test_behind_a_drift_the_velocity_is_believed_after_some_metres_only():
    """However sure the filter is at once: the first scans lie in the local map as the velocity's error put them."""
    links = LinkCovariances(SETTINGS, weak_std=0.05)
    for k in range(20):
        links.keyframe(pose(k, blind=True))
    stds, settling = [], []
    for k in range(20, 40):
        now = sure(k)
        stds.append(np.sqrt(links.of(now)[3, 3]))
        settling.append(links.settling_m(now))
        links.keyframe(now)
    assert stds[0] == pytest.approx(SPEED_STD * STEP_S, rel=0.05)
    assert all(later < before for before, later in pairwise(settling) if before)
    assert stds[3] < 0.5 * stds[0] and stds[-1] < 0.002


def test_where_no_drift_was_the_filter_is_taken_at_its_word():
    links = LinkCovariances(SETTINGS, weak_std=0.05)
    for k in range(10):
        links.keyframe(sure(k))
    assert links.settling_m(sure(10)) == 0.0
