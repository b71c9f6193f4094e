"""Links of the graph: their sum over a blind drift is the way's error, and elsewhere they stay what the filter says."""

from itertools import pairwise
from types import SimpleNamespace

import gtsam
import numpy as np
import pytest

from localize.graph import PoseGraph, slid
from localize.links import LinkCovariances
from localize.settings import GraphSettings
from localize.state import POSITION
from semmap.geometry import inverse, se3, so3_exp, yaw_rotation

SETTINGS = GraphSettings(link_correlation=1.0, drift_position=1e-4, drift_rotation=1e-4)
R = yaw_rotation(0.7)
FORWARD = R[:, 0]
SPEED_STD, STEP_S = 0.2, 0.5
UP = np.array([0.0, 0.0, 1.0])
LINK = np.diag([1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3]) ** 2


def pose(k, std, *, blind):
    """Keyframe ``k``, 1 m ahead of the last: the place forward is known to ``std`` [m], and the scan tells all, or all
    but the way forward."""
    P = np.zeros((48, 48))
    P[POSITION, POSITION] = R @ np.diag([std, 1e-3, 1e-3]) ** 2 @ R.T
    information = np.diag([1e6, 1e6, 1e6, 0.0 if blind else 1e6, 1e6, 1e6])
    return SimpleNamespace(
        stamp_ns=round(k * STEP_S * 1e9), T_odom_imu=se3(R, k * FORWARD), covariance=P,
        since_keyframe=LINK, scan_information=information, T_keyframe_imu=se3(np.eye(3), [1.0, 0.0, 0.0]),
    )  # fmt: skip


def chain(stds, blind):
    """The links between keyframes."""
    links, made = LinkCovariances(SETTINGS, weak_std=0.05), []
    for k, (std, dark) in enumerate(zip(stds, blind, strict=True)):
        now = pose(k, std, blind=dark)
        made.append(links.of(now))
        assert np.linalg.eigvalsh(made[-1].covariance).min() > 0.0
        links.keyframe(now)
    return made[1:]


def graph_of(links, T_odom, ways):
    """A graph of keyframes at ``T_odom`` (n, 4, 4) by odometry, the first of which is where it is."""
    graph = PoseGraph(SETTINGS)
    graph.add_keyframe(T_odom[0], UP, np.eye(4), LINK)
    graph.anchor(np.eye(4), known=True)
    for T, way, link in zip(T_odom[1:], ways, links, strict=True):
        graph.add_keyframe(T, UP, way, link.covariance, slide=link.slide)
        graph.solve()
    return graph


def total(links):
    return np.sqrt(np.diag(sum(link.covariance for link in links)))


STEADY, WALK = SPEED_STD * STEP_S * np.arange(101), SPEED_STD * STEP_S * np.sqrt(np.arange(101))
RISING = 0.002 * np.arange(101) ** 1.5


@pytest.mark.parametrize("n", [1, 10, 100])
def test_along_a_blind_drift_errors_add_up_and_not_their_squares(n):
    std = total(chain(STEADY[: n + 1], [True] * (n + 1)))
    assert std[3] == pytest.approx(n * SPEED_STD * STEP_S, rel=0.02)
    assert std[4] == pytest.approx(1e-3 * np.sqrt(n), rel=0.02)


def test_where_scans_hold_the_velocity_links_are_independent():
    links = chain(STEADY, [False] * 101)
    assert total(links)[3] == pytest.approx(1e-3 * 10.0, rel=0.02)
    assert all(link.slide is None for link in links)


@pytest.mark.parametrize("stds", [STEADY, WALK, RISING], ids=["steady", "walk", "rising"])
def test_a_drift_in_the_graph_ends_as_far_off_as_the_filter_says(stds):
    """Whether the speed stays off, changes from link to link (a wheel holds it), or comes to be off by more."""
    links = chain(stds[:41], [True] * 41)
    T_odom = [se3(R, k * FORWARD) for k in range(41)]
    graph = graph_of(links, T_odom, [inverse(a) @ b for a, b in pairwise(T_odom)])
    for k in (5, 20, 40):
        assert np.sqrt(graph.covariance(k)[3, 3]) == pytest.approx(stds[k], rel=0.05)


def test_what_ends_a_drift_tells_how_it_went():
    """The speed's error walks along the way; the keyframes between two that are known are as far off as they say, and
    less than if each link erred by itself."""
    rng, n, draws = np.random.default_rng(5), 30, 40
    walk = 0.02
    t = STEP_S * np.arange(n + 1)
    stds = walk * np.sqrt(t**3 / 3.0 + STEP_S * t**2 / 2.0 + 1e-12)
    links, alone = chain(stds, [True] * (n + 1)), []
    squares, errors = [], []
    true = [se3(R, k * FORWARD) for k in range(n + 1)]
    for _ in range(draws):
        speed = np.cumsum(walk * np.sqrt(STEP_S) * rng.normal(size=n))
        ways = [se3(np.eye(3), [1.0 + STEP_S * v, 0.0, 0.0]) for v in speed]
        T_odom = [se3(R, (k + s) * FORWARD) for k, s in enumerate([0.0, *(STEP_S * np.cumsum(speed))])]
        pins = []
        for shared in (True, False):
            used = links if shared else [type(link)(link.covariance) for link in links]
            graph = graph_of(used, T_odom, ways)
            graph.pin_position(n, np.zeros(3), true[n][:3, 3], 1e-6 * np.eye(3))
            graph.solve(steps=3)
            middle = n // 2
            off = (inverse(graph.pose(middle)) @ true[middle])[0, 3]
            pins.append(off)
            if shared:
                squares.append(off**2 / graph.covariance(middle)[3, 3])
        errors.append(pins[0])
        alone.append(pins[1])
    assert 0.5 < np.mean(squares) < 1.6
    assert np.std(errors) < 0.85 * np.std(alone)


def test_the_jacobians_of_a_slid_way(rng):
    T_map_a, T_a_b = (se3(so3_exp(rng.normal(size=3)), rng.normal(size=3)) for _ in range(2))
    T_map_b = T_map_a @ T_a_b @ se3(so3_exp(1e-3 * rng.normal(size=3)), 0.3 * rng.normal(size=3))
    u, seconds = rng.normal(size=3), 0.7
    # at the truth, where the error is what the speed leaves: nothing
    T_map_b[:3, 3] = (T_map_a @ T_a_b)[:3, 3] + seconds * u
    factor = slid(0, 1, 2, T_a_b, seconds, np.eye(6))

    def error(da, db, du):
        values = gtsam.Values()
        values.insert(0, gtsam.Pose3(T_map_a).retract(da))
        values.insert(1, gtsam.Pose3(T_map_b).retract(db))
        values.insert(2, u + du)
        return factor.unwhitenedError(values), factor.linearize(values)

    nothing = [np.zeros(6), np.zeros(6), np.zeros(3)]
    _, linear = error(*nothing)
    H, _ = linear.jacobian()
    numeric = np.empty((6, 15))
    for column in range(15):
        step = np.zeros(15)
        step[column] = 1e-6
        plus, _ = error(step[:6], step[6:12], step[12:])
        minus, _ = error(-step[:6], -step[6:12], -step[12:])
        numeric[:, column] = (plus - minus) / 2e-6
    np.testing.assert_allclose(H, numeric, atol=3e-3)


def test_what_a_drift_was_off_by_ends_with_it():
    two = total(chain([*STEADY[:50], *[0.0] * 5, *STEADY[:50]], [*[True] * 50, *[False] * 5, *[True] * 50]))
    one = total(chain(STEADY[:100], [True] * 100))
    assert two[3] < 0.8 * one[3]
