"""No map: intersections found on the way close loops, join what a break parted, and never the wrong ones."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from localize import Localizer, LocalizeSettings
from localize.settings import LoopSettings
from semmap.geometry import inverse, se3_exp
from tools.metrics import Pairs, associate, best_alignment
from tools.simulator import MotionSettings, SimulationSettings, fly, scenario, simulate_measurements

ROUND = ("0.1", "1.1", "1.2", "0.2", "0.1", "1.1", "2.1")
"""Round one pillar of a mine whose crossings look alike, and a little farther."""
SLIDE = np.array([0.0, 0.0, 0.03, 1.2, 0.3, 0.0])
"""[rad, m] that the odometry slides by from one keyframe to the next, at two of them, between crossings."""
SLIDES = (27, 45)


@cache
def flight():
    mine = scenario("grid", seed=3)
    route = np.array([mine.scenario.nodes[name] for name in ROUND])
    motion = MotionSettings(speed=2.5, still_s=1.0)
    it = fly(mine, route, settings=SimulationSettings(motion=motion), seed=3)
    return it, tuple(simulate_measurements(it))


class Sliding(Localizer):
    """Its odometry slides between two keyframes now and then, and says how far it may have."""

    T_moved = np.eye(4)

    def _reached(self, pose):
        slide, covariance = np.eye(4), pose.since_keyframe
        if pose.keyframe and len(self._track.keyframes) in SLIDES:
            slide, covariance = se3_exp(SLIDE), covariance + np.diag(SLIDE**2 + 1e-6)
        # from here on everything lies where the slide has put it
        T_slid = self.T_moved @ pose.T_odom_imu @ slide
        self.T_moved = T_slid @ inverse(pose.T_odom_imu)
        state = pose.state.copy()
        state.R, state.p, state.g = T_slid[:3, :3], T_slid[:3, 3], self.T_moved[:3, :3] @ state.g
        since = pose.T_keyframe_imu @ slide
        return super()._reached(replace(pose, state=state, T_keyframe_imu=since, since_keyframe=covariance))


@cache
def slid(close):
    it, measurements = flight()
    localizer = Sliding(it.rig, None, LocalizeSettings(loops=LoopSettings(close=close)))
    updates = [update for m in measurements if (update := localizer.add(m)) is not None]
    return localizer.finish(), updates


def errors(trajectory, truth, first_s=0.0):
    """After the best fit of the first seconds, or of all."""
    pairs = associate(trajectory, truth)
    if not first_s:
        return pairs.aligned(best_alignment(pairs)).position_errors()
    early = pairs.stamps_ns < pairs.stamps_ns[0] + round(first_s * 1e9)
    begun = Pairs(pairs.stamps_ns[early], pairs.estimate[early], pairs.truth[early])
    return pairs.aligned(best_alignment(begun)).position_errors()


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


def test_a_loop_takes_metres_back_that_odometry_slid():
    it, _ = flight()
    (alone, _), (closed, updates) = slid(False), slid(True)
    # before it slid, and again where it has been before; in between nobody knows which slide was how long
    off, off_alone = (errors(one.trajectory, it.truth(), 15.0) for one in (closed, alone))
    assert off_alone[-150:].min() > 0.5 and off[:150].max() < 0.1 and off[-150:].max() < 0.1
    assert np.median(off[200:300]) < 0.5 * np.median(off_alone[200:300])
    again, first = again_and_first(closed, it.truth())
    assert len(again) >= 4 and np.linalg.norm(again - first, axis=1).max() < 0.1
    assert closed.summary["pins"] == len(again) and closed.summary["intersections_found"] >= 4
    assert closed.trajectory.frame == closed.realtime.frame == "odom" and not closed.summary["anchored"]
    np.testing.assert_array_equal(closed.odometry.poses, alone.odometry.poses)
    assert all(u.T_map_imu is None and u.covariance is None and u.state == "unknown" for u in updates)
    np.testing.assert_array_equal([u.T_own_imu for u in updates][-50:], closed.realtime.poses[-50:])


def test_every_loop_is_told_with_its_scores():
    closed, _ = slid(True)
    pinned = [event for event in closed.events if event["kind"] == "intersection" and event["accepted"]]
    assert {event["id"] for event in pinned} == set(closed.summary["intersections_recognised"])
    assert all(event["fit"] > 0.85 and event["reason"] for event in pinned)
    found = [event["id"] for event in closed.events if event["kind"] == "intersection_found"]
    assert found == list(range(len(found)))


def test_without_loops_it_is_the_odometry():
    alone, updates = slid(False)
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
    joined, seen = (np.sum(one.stamps_ns > on_ns) for one in (result.trajectory, result.odometry))
    assert joined == seen > len(after)
    again, first = again_and_first(result, it.truth())
    assert len(again) >= 4 and np.linalg.norm(again - first, axis=1).max() < 0.1
    assert errors(result.trajectory, it.truth()).max() < 0.1


@pytest.mark.slow
def test_two_runs_give_the_same_bytes():
    first, _ = slid(True)
    second, _ = slid.__wrapped__(True)
    np.testing.assert_array_equal(first.trajectory.poses, second.trajectory.poses)
    np.testing.assert_array_equal(first.realtime.poses, second.realtime.poses)
    assert first.events == second.events
