"""Sharp corners of single roadways: intersections of kind L, and the slighter bends of the roadway graph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maps.roadways import Roadway
from maps.settings import TopologySettings
from semmap.geometry import Array

_STEP_M = 0.5
_SHARP = 3.5
"""The middle line of a corner follows a curve of at most so many half widths; a wider one has no point of its own."""


@dataclass(frozen=True, slots=True, eq=False)
class Corner:
    """A sharp corner of a roadway.

    p : (3,) point of the axis nearest to where the two legs meet [m].
    at : length of the axis up to there [m].
    turn : angle between the legs [rad], 0 for straight on.
    """

    p: Array
    at: float
    turn: float


def corner_of(road: Roadway, turn_deg: float, settings: TopologySettings) -> Corner | None:
    """The corner of a roadway that turns most, if by ``turn_deg`` or more; None where it has none.

    The turn is that between two legs, each at least as long as a branch axis and one and a half times as long as the
    roadway is wide, that lie on either side of the bend and off the ends. The curve between them is tight: a wide one,
    as of a spiral decline, is none.
    """
    half_width = float(np.median(road.clearance))
    bend, leg = 1.5 * half_width, max(settings.axis_length, 3.0 * half_width)
    walked, line = road.resampled(_STEP_M)
    near, far = round(bend / _STEP_M), round((bend + leg) / _STEP_M)
    start = far + round(1.5 * road.clearance[0] / _STEP_M)
    end = len(line) - far - round(1.5 * road.clearance[-1] / _STEP_M)
    if start >= end or half_width > settings.max_half_width:
        return None
    at, plan = np.arange(start, end), line[:, :2]
    turns = _angle(plan[at - near] - plan[at - far], plan[at + far] - plan[at + near])
    while turns.max() >= np.radians(turn_deg):
        most = int(np.argmax(turns))
        middle = int(at[most])
        p = _meeting(plan[middle - far : middle - near + 1], plan[middle + near : middle + far + 1])
        off = np.linalg.norm(plan[middle - far : middle + far + 1] - p, axis=1)
        if off.min() <= _SHARP * half_width * (1.0 / np.cos(0.5 * turns[most]) - 1.0):
            nearest = middle - far + int(np.argmin(off))
            return Corner(line[nearest], float(walked[nearest]), float(turns[most]))
        turns[max(most - far, 0) : most + far] = 0.0
    return None


def _angle(a: Array, b: Array) -> Array:
    """Angles (n,) [rad], 0 to π, between vectors (n, 2)."""
    cross, dot = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], np.einsum("nk,nk->n", a, b)
    return np.asarray(np.abs(np.arctan2(cross, dot)))


def _meeting(before: Array, after: Array) -> Array:
    """Meeting point (2,) of the lines through two sets of points (n, 2)."""
    normals, offsets = [], []
    for leg in (before, after):
        centre = leg.mean(axis=0)
        normals.append(np.linalg.svd(leg - centre, full_matrices=False)[2][1])
        offsets.append(normals[-1] @ centre)
    return np.asarray(np.linalg.solve(np.array(normals), np.array(offsets)))
