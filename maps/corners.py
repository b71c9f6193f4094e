"""Sharp corners of single roadways: intersections of kind L, and the slighter bends of the roadway graph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maps.roadways import Roadway
from maps.settings import TopologySettings
from semmap.geometry import Array

_STEP_M = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Corner:
    """A sharp corner of a roadway.

    p : (3,) where the axes of its two legs meet [m].
    at : length of the roadway's axis up to where it is nearest to the corner [m].
    turn : angle between the legs [rad], 0 for straight on.
    """

    p: Array
    at: float
    turn: float


def corner_of(road: Roadway, turn_deg: float, settings: TopologySettings) -> Corner | None:
    """The sharpest corner of a roadway that turns by ``turn_deg`` and more; None where it has none.

    The turn is that between two legs, each at least as long as a branch axis and one and a half times as long as the
    roadway is wide, that lie on either side of the bend and off the ends.
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
    sharpest = int(np.argmax(turns))
    if turns[sharpest] < np.radians(turn_deg):
        return None
    middle = int(at[sharpest])
    meeting = _meeting(plan[middle - far : middle - near + 1], plan[middle + near : middle + far + 1])
    if np.linalg.norm(meeting - plan[middle]) > 2.0 * bend:
        meeting = plan[middle]
    nearest = middle - far + int(np.argmin(np.linalg.norm(plan[middle - far : middle + far + 1] - meeting, axis=1)))
    inward = _unit(plan[middle + far] - plan[middle + near]) - _unit(plan[middle - near] - plan[middle - far])
    outer = plan[nearest] - half_width * _cut_short(turns[sharpest]) * _unit(inward)
    return Corner(np.append(outer, line[nearest, 2]), float(walked[nearest]), float(turns[sharpest]))


def _cut_short(turn: float) -> float:
    """How far inside of where the axes of the legs meet a medial axis takes a corner, in half widths of the legs.

    The circle that touches both outer walls and the inner edge has its centre there. Counted from it, the corner stays
    where it is in views that show one wall of a leg, where the lines that fit the legs swing; and on the floor.
    """
    half = np.cos(0.5 * turn)
    return float(min((1.0 / max(half, 0.1) - 1.0) / (1.0 + half), 1.0))


def _unit(v: Array) -> Array:
    return np.asarray(v / max(float(np.linalg.norm(v)), 1e-9))


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
