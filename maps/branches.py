"""The branches of an intersection: in which direction each roadway leaves, and how wide it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maps.free_space import FreeSpace
from maps.roadways import Roadway
from semmap.geometry import Array

_STEP_M = 0.4
_LOOK_M = 10.0
_SMOOTH = 4


@dataclass(frozen=True, slots=True)
class Branch:
    """A roadway where it leaves an intersection.

    bearing : direction [rad] in [0, 2π), counter-clockwise from x.
    width : between the walls [m].
    length : of the roadway up to the next node or its end [m].
    """

    bearing: float
    width: float
    length: float


def branch_of(road: Roadway, p: Array, space: FreeSpace, axis_length: float) -> Branch:
    """The branch that ``road`` makes at the invariant point ``p`` (3,).

    The bearing goes from the point to the middle of, and the width is the median over, the ``axis_length``
    of centre line that begins where the roadway has left the intersection: one and a half times as far from the point
    as the walls are.
    """
    walked, line = road.resampled(_STEP_M)
    away = np.linalg.norm((line - p)[:, :2], axis=1)
    first = int(np.argmax(away >= min(1.5 * max(space.clearance_at(p), 1.0), away.max())))
    last = max(int(np.searchsorted(walked, walked[first] + axis_length)), first + 1)
    aim = line[first:last].mean(axis=0) - p
    bearing = float(np.arctan2(aim[1], aim[0]) % (2.0 * np.pi))
    return Branch(bearing, float(np.median(widths(line[first:last], space))), float(walked[-1]))


def widths(line: Array, space: FreeSpace) -> Array:
    """Distance (k,) between the walls left and right of each point of an axis (k, 3) on the floor [m]."""
    k = np.arange(len(line))
    along = line[np.minimum(k + _SMOOTH, len(line) - 1)] - line[np.maximum(k - _SMOOTH, 0)]
    heading = np.arctan2(along[:, 1], along[:, 0])
    left = space.sight(line, heading + np.pi / 2, _LOOK_M).distance
    right = space.sight(line, heading - np.pi / 2, _LOOK_M).distance
    return np.asarray(left + right)
