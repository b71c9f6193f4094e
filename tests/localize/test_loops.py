"""No map: intersections found on the way close loops, join what a break parted, and never the wrong ones."""

from dataclasses import replace
from functools import cache

import numpy as np

from localize import Localizer, LocalizeSettings
from localize.settings import LoopSettings
from semmap.geometry import inverse, se3_exp
from tools.metrics import associate, best_alignment
from tools.simulator import MotionSettings, SimulationSettings, fly, scenario, simulate_measurements

ROUND = ("0.1", "1.1", "1.2", "0.2", "0.1", "1.1", "2.1")
"""Round one pillar of a mine whose crossings look alike, and a little farther."""
DRIFT = np.array([0.0, 0.0, 0.004, 0.01, -0.015, 0.002])
"""Per keyframe [rad, m]."""


@cache
def flight():
    mine = scenario("grid", seed=3)
    route = np.array([mine.scenario.nodes[name] for name in ROUND])
    motion = MotionSettings(speed=2.5, still_s=1.0)
    it = fly(mine, route, settings=SimulationSettings(motion=motion), seed=3)
    return it, tuple(simulate_measurements(it))


class Drifting(Localizer):
    """Its odometry drifts from keyframe to keyframe, and says how much."""

    drift = np.zeros(6)
    T_moved = np.eye(4)

    def _reached(self, pose):
        # the way since the keyframe as it is, from where the drift has put that
        T_drifted = self.T_moved @ pose.T_odom_imu
        if pose.keyframe and self._track.keyframes:
            T_drifted = T_drifted @ se3_exp(self.drift)
            self.T_moved = T_drifted @ inverse(pose.T_odom_imu)
        state = pose.state.copy()
        state.R, state.p, state.g = T_drifted[:3, :3], T_drifted[:3, 3], self.T_moved[:3, :3] @ state.g
        since = pose.T_keyframe_imu @ (se3_exp(self.drift) if pose.keyframe else np.eye(4))
        covariance = pose.since_keyframe + np.diag(20.0 * self.drift**2 + 1e-8)
        return super()._reached(replace(pose, state=state, T_keyframe_imu=since, since_keyframe=covariance))


@cache
def drifted(close):
    it, measurements = flight()
    localizer = Drifting(it.rig, None, LocalizeSettings(loops=LoopSettings(close=close)))
    localizer.drift = DRIFT
    updates = [update for m in measurements if (update := localizer.add(m)) is not None]
    return localizer.finish(), updates


def errors(trajectory, truth):
    pairs = associate(trajectory, truth)
    return pairs.aligned(best_alignment(pairs)).position_errors()


def again_and_first(result, truth):
    """Where (n, 3) the intersections of all loops really are: as seen again, and as found."""
    first = {event["id"]: event for event in result.events if event["kind"] == "intersection_found"}
    pins = [pin for event in result.events if event["kind"] == "intersection" for pin in event["pins"]]

    def points(stamps, seen):
        T, p = truth.at(np.array(stamps, np.int64)), np.array([one["p_imu"] for one in seen])
        return np.einsum("nij,nj->ni", T[:, :3, :3], p) + T[:, :3, 3]

    return (
        points([pin["stamp_ns"] for pin in pins], pins),
        points([first[pin["id"]]["keyframe_ns"] for pin in pins], [first[pin["id"]] for pin in pins]),
    )


def test_a_loop_takes_metres_of_drift_back():
    it, _ = flight()
    (alone, _), (closed, updates) = drifted(False), drifted(True)
    assert errors(alone.trajectory, it.truth()).max() > 1.0
    assert errors(closed.trajectory, it.truth()).max() < 0.4 * errors(alone.trajectory, it.truth()).max()
    # where it has been before it is to centimetres: the last crossing was passed a round ago
    again, first = again_and_first(closed, it.truth())
    assert len(again) >= 4 and np.linalg.norm(again - first, axis=1).max() < 0.15
    assert closed.summary["pins"] == len(again) and closed.summary["intersections_found"] >= 4
    assert closed.trajectory.frame == closed.realtime.frame == "odom" and not closed.summary["anchored"]
    np.testing.assert_array_equal(closed.odometry.poses, alone.odometry.poses)
    assert all(u.T_map_imu is None and u.covariance is None and u.state == "unknown" for u in updates)
    np.testing.assert_array_equal([u.T_own_imu for u in updates][-50:], closed.realtime.poses[-50:])


def test_every_loop_is_told_with_its_scores():
    closed, _ = drifted(True)
    pinned = [event for event in closed.events if event["kind"] == "intersection" and event["accepted"]]
    assert {event["id"] for event in pinned} == set(closed.summary["intersections_recognised"])
    assert all(event["fit"] > 0.85 and event["reason"] for event in pinned)
    found = [event["id"] for event in closed.events if event["kind"] == "intersection_found"]
    assert found == list(range(len(found)))


def test_loops_of_sound_odometry_do_it_no_harm():
    it, measurements = flight()
    localizer = Localizer(it.rig)
    for measurement in measurements:
        localizer.add(measurement)
    result = localizer.finish()
    again, first = again_and_first(result, it.truth())
    assert len(again) >= 4 and np.linalg.norm(again - first, axis=1).max() < 0.1
    off, alone = errors(result.trajectory, it.truth()), errors(result.odometry, it.truth())
    assert np.sqrt(np.mean(off**2)) < 1.1 * np.sqrt(np.mean(alone**2)) + 0.002


def test_without_loops_it_is_the_odometry():
    alone, updates = drifted(False)
    np.testing.assert_array_equal(alone.trajectory.poses, alone.odometry.poses)
    np.testing.assert_array_equal(alone.realtime.poses, alone.odometry.poses)
    assert all(update.T_own_imu is None for update in updates)
    assert not alone.summary["intersections_seen"]


def test_what_a_break_parted_an_intersection_joins():
    """Carried on by a stretch in a silence: until a known intersection is seen nothing is said of the place."""
    it, measurements = flight()
    begin_ns = measurements[0].stamp_ns
    cut_ns, on_ns = begin_ns + 24_000_000_000, begin_ns + 30_000_000_000
    localizer = Localizer(it.rig)
    updates = [
        update for m in measurements if not cut_ns < m.stamp_ns < on_ns and (update := localizer.add(m)) is not None
    ]
    result = localizer.finish()
    assert result.summary["odometry_breaks"] == 1 and not result.summary["anchored"]
    after = [u.T_own_imu is not None for u in updates if u.stamp_ns > on_ns]
    assert not after[0] and after[-1] and after == sorted(after)
    # the whole second leg is joined on, from its first scan
    assert np.sum(result.trajectory.stamps_ns > on_ns) == len(after) and len(result.odometry) == result.summary["scans"]
    assert errors(result.trajectory, it.truth()).max() < 0.1
