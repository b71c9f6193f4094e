"""The branches of an intersection: in which direction each roadway leaves, and how wide it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maps.free_space import FreeSpace
from maps.roadways import Roadway
from semmap.geometry import Array

_STEP_M = 0.4
_LOOK_M = 10.0


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
    """The branch that ``road`` makes at the invariant point ``p`` (2,).

    The bearing goes from the point to the middle of, and the width is the median over, the ``axis_length``
    of centre line that begins where the roadway has left the intersection: one and a half times as far from the point
    as the walls are.
    """
    walked, line = road.resampled(_STEP_M)
    away = np.linalg.norm(line - p, axis=1)
    start = 1.5 * max(space.clearance_at(p), 1.0)
    piece = (away >= min(start, away.max())) & (away <= start + axis_length)
    piece = piece if piece.any() else away >= away.max()
    aim = line[piece].mean(axis=0) - p
    bearing = float(np.arctan2(aim[1], aim[0]) % (2.0 * np.pi))
    return Branch(bearing, _width(line, piece, space), float(walked[-1]))


def _width(line: Array, piece: NDArray[np.bool_], space: FreeSpace) -> float:
    """Median distance between the walls left and right of the axis [m]."""
    smooth = 4
    ahead, behind = np.roll(line, -smooth, axis=0), np.roll(line, smooth, axis=0)
    ahead[-smooth:], behind[:smooth] = line[-1], line[0]
    heading = np.arctan2(*(ahead - behind)[piece].T[::-1])
    left = space.sight(line[piece], heading + np.pi / 2, _LOOK_M).distance
    right = space.sight(line[piece], heading - np.pi / 2, _LOOK_M).distance
    return float(np.median(left + right))
