"""The pose graph on simulated keyframes: exact without noise, honest about its errors with it."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import chi2

from localize.graph import PoseGraph
from localize.settings import GraphSettings
from localize.smoothing import smoothed
from semmap.geometry import inverse, se3, se3_exp, se3_log, so3_exp, transform, yaw_rotation
from semmap.trajectory import Trajectory

LINK = np.diag(np.repeat([0.002, 0.02], 3) ** 2)
PIN = np.diag(np.repeat([0.003, 0.03], 3) ** 2)


def drive(n=40):
    """True keyframe poses in the map: a winding drive with some slope."""
    poses = [se3(yaw_rotation(0.4), [100.0, -50.0, 3.0])]
    for k in range(n - 1):
        poses.append(poses[-1] @ se3_exp([0.01, -0.02, 0.1 * np.sin(k / 5), 1.0, 0.0, 0.02]))
    return np.array(poses)


def odometry(truth, rng=None):
    """Dead-reckoned poses in odom with link noise."""
    poses = [np.eye(4)]
    for a, b in pairwise(truth):
        noise = np.zeros(6) if rng is None else rng.multivariate_normal(np.zeros(6), LINK)
        poses.append(poses[-1] @ inverse(a) @ b @ se3_exp(noise))
    return np.array(poses)


def graph_of(track, settings=None):
    graph = PoseGraph(settings or GraphSettings())
    up_odom = drive(1)[0, :3, :3].T @ [0.0, 0.0, 1.0]
    for before, T in zip([track[0], *track[:-1]], track, strict=True):
        graph.add_keyframe(T, up_odom, inverse(before) @ T, LINK)
    return graph


def pin(graph, index, T_map_imu, covariance):
    """Pin a keyframe by an intersection of its own, some metres ahead."""
    graph.pin_intersection(index, index, T_map_imu @ se3_exp([0, 0, 0, 4.0, 1.0, -1.0]), T_map_imu, covariance)


def test_no_map_frame_before_it_is_anchored():
    graph = graph_of(odometry(drive(5)))
    assert not graph.anchored and len(graph) == 5


def test_one_exact_pin_places_the_whole_track():
    truth = drive()
    graph = graph_of(odometry(truth))
    graph.anchor(truth[0] @ se3_exp([0.02, -0.01, 0.1, 0.5, -0.5, 0.3]))  # a poor first guess
    pin(graph, 20, truth[20], PIN)
    graph.solve(steps=4)
    # the vague prior on a guess 0.8 m and 6 degrees off pulls by less than a millimetre
    np.testing.assert_allclose(graph.poses(), truth, atol=1e-3)


def test_keyframes_after_the_anchor_continue_the_track():
    truth = drive()
    track = odometry(truth)
    graph = graph_of(track[:10])
    graph.anchor(truth[0])
    pin(graph, 3, truth[3], PIN)
    graph.solve()
    for before, T in pairwise(track[9:]):
        graph.add_keyframe(T, np.array([0.0, 0.0, 1.0]), inverse(before) @ T, LINK)
    graph.solve()
    np.testing.assert_allclose(graph.poses(), truth, atol=1e-5)


def test_positions_with_lever_arm_place_the_track():
    truth, lever = drive(), np.array([0.3, -0.2, 0.5])
    graph = graph_of(odometry(truth))
    graph.anchor(truth[0] @ se3_exp([0, 0, 0.05, 0.5, 0.5, 0.0]))
    for k in range(0, 40, 3):
        graph.pin_position(k, lever, transform(truth[k], lever[None])[0], 1e-4 * np.eye(3))
    graph.solve(steps=6)
    np.testing.assert_allclose(graph.poses()[:, :3, 3], truth[:, :3, 3], atol=1e-4)


def test_ranges_to_anchors_place_the_track():
    truth, lever = drive(), np.array([0.0, 0.1, 0.4])
    anchors = {7: np.array([105.0, -45.0, 5.0]), 9: np.array([120.0, -60.0, 2.0]), 11: np.array([130.0, -30.0, 6.0]),
               12: np.array([112.0, -20.0, 0.0])}  # fmt: skip
    graph = graph_of(odometry(truth))
    graph.anchor(truth[0] @ se3_exp([0, 0, 0.05, 0.5, 0.5, 0.0]))
    for k in range(40):
        for anchor, p in anchors.items():
            distance = np.linalg.norm(transform(truth[k], lever[None])[0] - p)
            graph.pin_range(k, lever, anchor, p, distance, 0.05)
    graph.solve(steps=8)
    np.testing.assert_allclose(graph.poses()[:, :3, 3], truth[:, :3, 3], atol=2e-2)


def test_one_range_alone_leaves_the_guess_where_it_was():
    """Nearly everything is open, and yet there is a solution."""
    truth = drive(5)
    graph = graph_of(odometry(truth))
    graph.anchor(truth[0])
    anchor = truth[2, :3, 3] + [0.0, 3.0, 0.0]
    graph.pin_range(2, np.zeros(3), 7, anchor, 3.0, 0.05)
    graph.solve()
    np.testing.assert_allclose(graph.poses(), truth, atol=1e-3)
    assert np.sqrt(graph.covariance(4)[3:, 3:].max()) > 1.0


def test_one_wrong_pin_among_right_ones_is_held_down():
    truth = drive()
    graph = graph_of(odometry(truth))
    graph.anchor(truth[0])
    for k in (2, 10, 30, 38):
        pin(graph, k, truth[k], PIN)
    pin(graph, 20, truth[20] @ se3_exp([0, 0, 0.1, 3.0, 0, 0]), PIN)
    graph.solve(steps=8)
    assert np.abs(graph.poses()[:, :3, 3] - truth[:, :3, 3]).max() < 0.15


def test_errors_agree_with_the_reported_covariance():
    """Normalised error squared of the last keyframe over seeds lies in its 95 % bounds."""
    truth, seeds = drive(30), 60
    squared = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        graph = graph_of(odometry(truth, rng))
        graph.anchor(truth[0])
        for k in (4, 12):
            pin(graph, k, truth[k] @ se3_exp(rng.multivariate_normal(np.zeros(6), PIN)), PIN)
        graph.solve(steps=4)
        error = se3_log(inverse(graph.pose(29)) @ truth[29])
        squared.append(error @ np.linalg.solve(graph.covariance(29), error))
    low, high = chi2.ppf([0.025, 0.975], 6 * seeds) / seeds
    # the robust loss trims the tails of the pins a little, hence the wider lower side
    assert 0.9 * low < np.mean(squared) < 1.1 * high


def test_fixes_along_the_first_metre_do_not_tilt_a_track_whose_vertical_is_known():
    """Odometry that dips by 8 cm where the fixes stay level: the links take it, for the vertical is known better."""
    truth = np.array([se3(np.eye(3), [x, 0.0, 1.5]) for x in (0.0, 0.6, 1.2)])
    graph, dip = PoseGraph(GraphSettings()), [0.0, -0.04, -0.08]
    dipped = [T @ se3(np.eye(3), [0.0, 0.0, z]) for T, z in zip(truth, dip, strict=True)]
    for before, T in zip([dipped[0], *dipped[:-1]], dipped, strict=True):
        graph.add_keyframe(T, np.array([0.0, 0.0, 1.0]), inverse(before) @ T, LINK, up_std=0.003)
    graph.anchor(np.eye(4))
    for index, T in enumerate(truth):
        graph.pin_position(index, np.array([0.1, 0.8, 0.4]), T[:3, 3] + [0.1, 0.8, 0.4], 0.002**2 * np.eye(3))
    graph.solve(steps=10)
    tilt = [np.arccos(graph.pose(k)[2, 2]) for k in range(3)]
    assert max(tilt) < 0.01
    assert all(np.sqrt(graph.covariance(k)[1, 1]) < 0.0035 for k in range(3))


def test_smoothing_carries_corrections_to_every_scan():
    truth = drive(30)
    drifted = odometry(truth, np.random.default_rng(1))
    stamps = np.arange(30, dtype=np.int64) * 100_000_000
    keyframes = np.arange(0, 30, 5)
    result = smoothed(Trajectory("odom", stamps, drifted), stamps[keyframes], truth[keyframes])
    assert result.frame == "map"
    np.testing.assert_allclose(result.poses[keyframes], truth[keyframes], atol=1e-9)
    between = np.setdiff1d(np.arange(26), keyframes)
    assert np.linalg.norm(result.positions[between] - truth[between, :3, 3], axis=1).max() < 0.12


@pytest.mark.parametrize("n", [1, 2])
def test_smoothing_of_very_short_tracks(n):
    T = se3(so3_exp([0, 0, 0.2]), [1.0, 2.0, 3.0])
    stamps = np.arange(n, dtype=np.int64) * 100_000_000
    poses = np.array([np.eye(4)] * n)
    result = smoothed(Trajectory("odom", stamps, poses), stamps[:1], T[None])
    np.testing.assert_allclose(result.poses, np.array([T] * n), atol=1e-12)


def test_an_intersections_survey_errs_once_however_often_it_is_seen():
    truth, settings = drive(), GraphSettings()
    graph = graph_of(odometry(truth))
    graph.anchor(truth[0])
    T_map_intersection = truth[20] @ se3_exp([0, 0, 0, 4.0, 1.0, -1.0])
    for index in range(12, 29):
        graph.pin_intersection(index, 5, T_map_intersection, truth[index], 1e-8 * np.eye(6))
    graph.solve()
    np.testing.assert_allclose(graph.poses(), truth, atol=1e-4)
    std = np.sqrt(np.diag(graph.covariance(20))[3:])
    assert (std > 0.99 * settings.survey_position).all() and (std < 2.0 * settings.survey_position).all()


def test_surveyed_intersections_that_are_off_are_averaged_with_honest_covariance():
    """Each intersection of the map lies a little off for all that see it: errors agree with the covariance."""
    truth, seeds, s = drive(40), 60, GraphSettings()
    survey = np.diag(np.repeat([s.survey_rotation, s.survey_position], 3) ** 2)
    squared = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        graph = graph_of(odometry(truth, rng))
        graph.anchor(truth[0])
        for number, seen_from in ((1, range(3, 15, 3)), (2, range(24, 36, 3))):
            true = truth[seen_from[2]] @ se3_exp([0, 0, 0, 3.0, 1.0, -1.0])
            stored = true @ se3_exp(rng.multivariate_normal(np.zeros(6), survey))
            for index in seen_from:
                T_intersection_imu = inverse(true) @ truth[index] @ se3_exp(rng.multivariate_normal(np.zeros(6), PIN))
                graph.pin_intersection(index, number, stored, stored @ T_intersection_imu, PIN)
        graph.solve(steps=4)
        error = se3_log(inverse(graph.pose(18)) @ truth[18])
        squared.append(error @ np.linalg.solve(graph.covariance(18), error))
    low, high = chi2.ppf([0.025, 0.975], 6 * seeds) / seeds
    assert 0.85 * low < np.mean(squared) < 1.1 * high


def test_in_the_papers_mode_positions_of_intersections_place_the_track():
    truth = drive()
    graph = graph_of(odometry(truth), GraphSettings(intersections="points"))
    graph.anchor(truth[0] @ se3_exp([0, 0, 0.02, 0.3, 0.3, 0.0]))
    for index in range(2, 40, 5):
        pin(graph, index, truth[index] @ se3_exp([0, 0, 0, 0, 0, 0]), PIN)
    graph.solve(steps=6)
    np.testing.assert_allclose(graph.poses()[:, :3, 3], truth[:, :3, 3], atol=2e-3)


def test_a_graph_split_in_two_keeps_its_first_part_and_begins_the_second_without_a_place():
    truth = drive()
    graph = graph_of(odometry(truth))
    graph.anchor(truth[0])
    pin(graph, 5, truth[5], PIN)
    graph.solve()
    rest = graph.split(25)
    assert not rest.anchored and len(rest) == 15
    rest.anchor(truth[0] @ se3_exp([0, 0, 0.1, 1.0, 0, 0]))
    pin(rest, 10, truth[35], PIN)
    rest.solve(steps=4)
    np.testing.assert_allclose(rest.poses(), truth[25:], atol=2e-3)
    np.testing.assert_allclose(graph.poses()[:25], truth[:25], atol=1e-3)


def closed_loop(rng, *, sides=4, along=12):
    """True keyframes twice round a square: the second time round every keyframe is where it was before."""
    step, turn = se3_exp([0, 0, 0, 1.0, 0, 0]), se3_exp([0, 0, 2.0 * np.pi / sides, 1.0, 0, 0])
    poses = [se3(yaw_rotation(0.3), [2.0, 1.0, 0.5])]
    for k in range(1, 2 * sides * along):
        poses.append(poses[-1] @ (turn if k % along == 0 else step))
    return np.array(poses), odometry(np.array(poses), rng)


def upright_graph(truth, drifted, rng):
    """The filter knows the vertical as well as the settings say, however its heading drifts."""
    graph = PoseGraph(GraphSettings())
    for before, T, true in zip([drifted[0], *drifted[:-1]], drifted, truth, strict=True):
        leaning = so3_exp([*rng.normal(scale=GraphSettings().vertical_std, size=2), 0.0])
        up_odom = T[:3, :3] @ true[:3, :3].T @ leaning @ [0.0, 0.0, 1.0]
        graph.add_keyframe(T, up_odom, inverse(before) @ T, LINK)
    return graph


def loop_graph(truth, drifted, rng, *, at=3, noise=1e-10):
    """The graph in its own frame, with an intersection first seen by keyframe ``at`` and again one round later."""
    graph = upright_graph(truth, drifted, rng)
    graph.anchor(truth[0], known=True)
    graph.solve()
    T = truth[at] @ se3_exp([0, 0, 0, 3.0, 1.0, -1.0])
    graph.add_intersection(1, at, inverse(truth[at]) @ T, noise * np.eye(6))
    graph.solve()
    again = at + len(truth) // 2
    seen = inverse(T) @ truth[again] @ se3_exp(rng.multivariate_normal(np.zeros(6), PIN))
    graph.pin_intersection(again, 1, graph.intersection(1), graph.intersection(1) @ seen, PIN)
    graph.solve(steps=5)
    return graph, again


def test_an_intersection_seen_again_closes_the_loop():
    off, off_alone = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        truth, drifted = closed_loop(rng)
        graph, again = loop_graph(truth, drifted, rng)
        alone = truth[0] @ inverse(drifted[0]) @ drifted
        off.append(np.linalg.norm(graph.poses()[:, :3, 3] - truth[:, :3, 3], axis=1))
        off_alone.append(np.linalg.norm(alone[:, :3, 3] - truth[:, :3, 3], axis=1))
    assert np.mean([one[again] for one in off]) < 0.3 * np.mean([one[again] for one in off_alone])
    assert np.mean(off) < 0.7 * np.mean(off_alone)


def test_its_own_place_is_known_exactly_in_its_own_frame_and_the_rest_by_the_way():
    rng = np.random.default_rng(4)
    truth, drifted = closed_loop(rng)
    graph = upright_graph(truth, drifted, rng)
    graph.anchor(truth[0], known=True)
    graph.solve()
    assert np.sqrt(np.diag(graph.covariance(0)))[2:].max() < 2e-4
    # what gravity holds apart, that is the covariance of the way
    way, marginal = graph.way_covariance(0, 60), graph.covariance(60)
    held = np.linalg.eigvalsh(way - marginal)
    assert held.min() > -1e-3 * np.trace(way) and np.trace(marginal) > 0.3 * np.trace(way)


def test_the_ways_covariance_agrees_with_chains_of_noisy_links():
    truth, seeds = drive(), 200
    graph = graph_of(odometry(truth))
    squared = []
    for seed in range(seeds):
        noisy = odometry(truth, np.random.default_rng(seed))
        error = se3_log(inverse(inverse(noisy[10]) @ noisy[35]) @ inverse(truth[10]) @ truth[35])
        squared.append(error @ np.linalg.solve(graph.way_covariance(10, 35), error))
    low, high = chi2.ppf([0.025, 0.975], 6 * seeds) / seeds
    assert low < np.mean(squared) < high


def test_closed_loops_agree_with_their_covariance():
    squared = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        truth, drifted = closed_loop(rng)
        graph, again = loop_graph(truth, drifted, rng)
        error = se3_log(inverse(graph.pose(again)) @ truth[again])
        squared.append(error @ np.linalg.solve(graph.covariance(again), error))
    low, high = chi2.ppf([0.025, 0.975], 6 * 40) / 40
    assert 0.85 * low < np.mean(squared) < 1.15 * high
