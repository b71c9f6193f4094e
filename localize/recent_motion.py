"""How a point of the robot moved lately, for what was measured a moment ago, or at a time that is not known exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localize.filter import InertialTrack
from localize.state import NavState
from semmap.geometry import Array

HELD_NS = 1_500_000_000
"""So far back it reaches."""


@dataclass(frozen=True, slots=True)
class PointPath:
    """A point of the body at times (n,) around now [s]: ``p + R l + v dt``, with l (n, 3) between them along a line.

    So p, R and v of the state move the path as a whole; what else the imu felt is in l.
    """

    seconds: Array
    levers: Array

    @classmethod
    def fixed(cls, lever: Array) -> PointPath:
        """Straight on at the present speed."""
        return cls(np.array([-1.0, 0.0]), np.stack([lever, lever]))

    def at(self, dt: float) -> tuple[Array, Array]:
        """Lever arm (3,) a time before or after now [s], and how fast it changes (3,); beyond its ends it goes on."""
        i = int(np.clip(np.searchsorted(self.seconds, dt) - 1, 0, len(self.seconds) - 2))
        slope = (self.levers[i + 1] - self.levers[i]) / (self.seconds[i + 1] - self.seconds[i])
        return self.levers[i] + (dt - self.seconds[i]) * slope, slope


class RecentMotion:
    """The last tracks of the filter, without the steps of what it learnt between them."""

    def __init__(self) -> None:
        self._stamps = np.empty(0, np.int64)
        self._R, self._p, self._v = np.empty((0, 3, 3)), np.empty((0, 3)), np.empty((0, 3))

    @property
    def since_ns(self) -> int | None:
        """How far back it reaches, None where it is empty."""
        return int(self._stamps[0]) if len(self._stamps) else None

    def add(self, track: InertialTrack) -> None:
        """A track that begins where the last one ended, but for what the filter learnt there."""
        stamps: NDArray[np.int64] = track.zero_ns + np.round(track.t * 1e9).astype(np.int64)
        new = np.diff(stamps, prepend=stamps[0] - 1) > 0
        if len(self._stamps):
            self._move_end(track.R[0], track.p[0], track.v[0])
        kept = (self._stamps >= stamps[-1] - HELD_NS) & (self._stamps < stamps[0])
        self._stamps = np.concatenate([self._stamps[kept], stamps[new]])
        self._R = np.concatenate([self._R[kept], track.R[new]])
        self._p = np.concatenate([self._p[kept], track.p[new]])
        self._v = np.concatenate([self._v[kept], track.v[new]])

    def _move_end(self, R: Array, p: Array, v: Array) -> None:
        """All of it to where its end is now known to be, with the speed that is known now."""
        turned = R @ self._R[-1].T
        faster = v - turned @ self._v[-1]
        seconds = (self._stamps - self._stamps[-1])[:, None] * 1e-9
        self._p = p + (self._p - self._p[-1]) @ turned.T + faster * seconds
        self._R, self._v = turned @ self._R, self._v @ turned.T + faster

    def path(self, lever: Array, state: NavState) -> PointPath:
        """Of a point (3,) of the body; the track's end is now, where the filter's state is."""
        if len(self._stamps) < 2:
            return PointPath.fixed(lever)
        seconds = (self._stamps - self._stamps[-1]) * 1e-9
        last = self._R[-1]
        moved = self._p - self._p[-1] - np.outer(seconds, self._v[-1]) + self._R @ lever
        return PointPath(seconds, moved @ last)

    def faster_by(self, stamp_ns: int) -> Array:
        """How much faster (3,) the imu is now than then, in odom [m/s]."""
        if not len(self._stamps):
            return np.zeros(3)
        then = int(np.clip(np.searchsorted(self._stamps, stamp_ns), 0, len(self._stamps) - 1))
        return np.asarray(self._v[-1] - self._v[then])
