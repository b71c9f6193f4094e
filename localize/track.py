"""Where the robot is and was: the legs, each with its graph, and the newest keyframe's place in the map."""

from __future__ import annotations

import numpy as np

from localize.graph import PoseGraph
from localize.hypotheses import carried
from localize.journal import Journal
from localize.keyframes import Keyframe
from localize.legs import Leg
from localize.links import Link
from localize.matcher import Expected
from localize.odometry import OdometryPose
from localize.settings import GraphSettings
from semmap.geometry import Array, inverse, rotation_between, se3

_UP = np.array([0.0, 0.0, 1.0])


class Track:
    """Keyframes of all legs; the last leg is the present one. Numbers are relative to the map's round origin.

    Attributes
    ----------
    at : the newest keyframe in the map, None while that is not known. newest : the newest keyframe.
    dirty : whether the graph knows more than ``at``.
    """

    def __init__(self, settings: GraphSettings, journal: Journal, *, range_bias_std: float = 0.0) -> None:
        self.settings, self.journal, self.range_bias_std = settings, journal, range_bias_std
        self.legs: list[Leg] = []
        self.at: Expected | None = None
        self.newest: Keyframe | None = None
        self.dirty = False

    @property
    def leg(self) -> Leg:
        """The present one."""
        return self.legs[-1]

    @property
    def graph(self) -> PoseGraph:
        """The present leg's."""
        return self.leg.graph

    @property
    def keyframes(self) -> list[tuple[int, Array]]:
        """Stamps and poses in odom of the present leg's."""
        return self.leg.keyframes

    def begin_leg(self, first_keyframe: int) -> None:
        """The odometry begins anew, with this number of keyframe, wherever the robot is."""
        self.at = None
        self.legs.append(Leg(PoseGraph(self.settings, range_bias_std=self.range_bias_std), first_keyframe))

    def add_keyframe(self, keyframe: Keyframe, pose: OdometryPose, link: Link) -> None:
        """The newest keyframe, and how far off the way to it is."""
        self.newest = keyframe
        self.graph.add_keyframe(
            keyframe.T_odom_imu, keyframe.up_odom, pose.T_keyframe_imu, link.covariance, pose.up_std, link.slide
        )
        self.keyframes.append((keyframe.stamp_ns, pose.T_odom_imu))
        self.leg.unmoved.append(keyframe.T_odom_imu)
        self.journal.counts["keyframes"] += 1
        if self.at is not None:
            self.at = carried(self.at, *self.graph.link(len(self.graph) - 1))
            self.dirty = True

    def expected(self, index: int) -> Expected | None:
        """Where a keyframe of the leg is taken to be."""
        if self.at is None or index == len(self.graph) - 1:
            return self.at
        return Expected(self.graph.pose(index), self.graph.covariance(index))

    def stay(self) -> None:
        """Without a map, odom is the frame, made level: the leg's place is where it is."""
        assert self.newest is not None
        self.graph.anchor(se3(rotation_between(self.newest.up_odom, _UP), np.zeros(3)), known=True)
        self.solve()

    def anchor(self, T_map_odom: Array, stamp_ns: int, by: str) -> None:
        """Give the leg its first place in the map; pins must follow before `solve`."""
        self.graph.anchor(T_map_odom)
        self.journal.event(stamp_ns, "anchored", by=by)

    def solve(self) -> None:
        """Bring ``at`` up to what the graph knows."""
        self.graph.solve()
        last = len(self.graph) - 1
        self.at = Expected(self.graph.pose(last), self.graph.covariance(last))
        self.dirty = False

    def leave(self, keyframe: int) -> Leg:
        """The robot was elsewhere from this number of keyframe on: a new leg begins with it; returns the old one."""
        before = self.leg
        self.legs.append(before.split(keyframe))
        self.at = None
        return before

    def T_map_odom(self) -> Array:
        """Where odom (4, 4) lies in the map, once that is known."""
        assert self.at is not None
        return self.at.T_map_imu @ inverse(self.keyframes[-1][1])

    @property
    def unmoved(self) -> Array:
        """Pose (4, 4) of the newest scan in an odom that nothing ever moved."""
        return self.leg.odometry[-1][1]
