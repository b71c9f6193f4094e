"""Legs: stretches through which the odometry ran on without a break, each with its own pose graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from localize.graph import PoseGraph
from localize.smoothing import smoothed
from semmap.geometry import Array
from semmap.trajectory import Trajectory


@dataclass(slots=True)
class Leg:
    """One stretch.

    graph : its keyframes. first_keyframe : the number of the first of them in the run.
    keyframes : stamps and poses ``T_odom_imu`` of its keyframes, as the filter had them.
    odometry, unmoved : stamps and poses of its scans, and poses of its keyframes, had nothing ever moved the filter's
    odom: one motion on top of the other.
    pinned : ids of the intersections that pin it. last_pin_ns : stamp of the last keyframe that one pins.
    """

    graph: PoseGraph
    first_keyframe: int
    keyframes: list[tuple[int, Array]] = field(default_factory=list)
    odometry: list[tuple[int, Array]] = field(default_factory=list)
    unmoved: list[Array] = field(default_factory=list)
    pinned: set[int] = field(default_factory=set)
    last_pin_ns: int = 0

    def unmoved_to(self, T_odom_imu: Array, T_keyframe_imu: Array) -> Array:
        """Pose (4, 4) of a scan in an odom that nothing ever moved, by its way from the last keyframe."""
        return self.unmoved[-1] @ T_keyframe_imu if self.unmoved else T_odom_imu

    def split(self, keyframe: int) -> Leg:
        """The leg that begins at a keyframe of this one, by its number in the run; this one ends with its last pin.

        Somewhere between the two the odometry broke unnoticed, so what lies between them belongs to neither.
        """
        index = keyframe - self.first_keyframe
        begin_ns = self.keyframes[index][0]
        rest = Leg(self.graph.split(index), keyframe, self.keyframes[index:], unmoved=self.unmoved[index:])
        rest.odometry = [pose for pose in self.odometry if pose[0] >= begin_ns]
        self.odometry = [pose for pose in self.odometry if pose[0] <= min(self.last_pin_ns, begin_ns - 1)]
        self.keyframes, self.unmoved = self.keyframes[:index], self.unmoved[:index]
        return rest

    def smoothed(self) -> Trajectory:
        """Every scan's pose in the map, between the keyframes' own; empty where the leg never found its place."""
        stamps = self._placed()
        if not stamps:
            return trajectory("map", [])
        poses = self.graph.poses()[: len(stamps)]
        return smoothed(trajectory("odom", self.odometry), np.array(stamps, np.int64), poses)

    def covariances(self) -> list[tuple[int, Array]]:
        """Stamp and covariance (6, 6) of each keyframe in the map, once `smoothed`; none without a place there."""
        return [(stamp, self.graph.covariance(index)) for index, stamp in enumerate(self._placed())]

    def _placed(self) -> list[int]:
        """Stamps of the keyframes that have a place in the map; one behind the last scan was taken back with it."""
        if not self.graph.anchored or not self.odometry:
            return []
        return [stamp for stamp, _ in self.keyframes if stamp <= self.odometry[-1][0]]


def trajectory(frame: str, track: Sequence[tuple[int, Array]]) -> Trajectory:
    """Stamps and poses as a trajectory."""
    stamps = np.array([stamp for stamp, _ in track], np.int64)
    return Trajectory(frame, stamps, np.array([pose for _, pose in track]).reshape(-1, 4, 4))


def joined(trajectories: Sequence[Trajectory], frame: str) -> Trajectory:
    """Trajectories in order of time as one."""
    stamps = np.concatenate([np.zeros(0, np.int64), *(one.stamps_ns for one in trajectories)])
    return Trajectory(frame, stamps, np.concatenate([np.zeros((0, 4, 4)), *(one.poses for one in trajectories)]))
