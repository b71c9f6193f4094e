"""How soon the order of intersections tells two that look alike apart: what comes next along each roadway."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import pi

import numpy as np

from maps.road_net import Road, roads_of
from semmap.geometry import Array
from semmap.intersections import RoadwayGraph, SemanticMap

NEVER = 8
"""Intersections passed after which two ways that still look alike are taken to do so for good."""

_SAME_BEARING = 0.5
"""Branches of two intersections laid onto each other are the same one within this [rad]."""
_SAME_LENGTH = (3.0, 0.05)
"""Ways are of one length within so many metres and this share of it: what odometry tells apart without any doubt."""
_BEARING_AFTER_M = 5.0

Pair = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Way:
    """One roadway that leaves an intersection, as far as the next one.

    bearing : in which it leaves [rad]. length : [m]. target : row of the intersection it comes to, -1 where it ends.
    back : by which way of the target it comes there, -1 where it ends.
    """

    bearing: float
    length: float
    target: int
    back: int = -1


def ways_of(semantic_map: SemanticMap) -> list[list[Way]]:
    """The roadways that leave each intersection; bends between are passed over."""
    graph = semantic_map.roadways
    row_of_id = {id: row for row, id in enumerate(semantic_map.columns.id.tolist())}
    rows = [row_of_id.get(id, -1) for id in graph.node_intersection.tolist()]
    leaving: dict[int, list[Road]] = {}
    for road in roads_of(graph):
        leaving.setdefault(road.nodes[0], []).append(road)
        leaving.setdefault(road.nodes[1], []).append(road.reversed())
    ways: list[list[Way]] = [[] for _ in row_of_id]
    for node, row in enumerate(rows):
        if row >= 0:
            ways[row] = [_way(road, leaving, rows, graph) for road in leaving.get(node, [])]
    return [[replace(way, back=_back(ways, row, k)) for k, way in enumerate(mine)] for row, mine in enumerate(ways)]


def _back(ways: list[list[Way]], row: int, number: int) -> int:
    """The same way from its other end: of those that lead here the one of its length."""
    way = ways[row][number]
    if way.target < 0:
        return -1
    others = [k for k, other in enumerate(ways[way.target]) if other.target == row and (way.target, k) != (row, number)]
    return min(others, key=lambda k: abs(ways[way.target][k].length - way.length), default=-1)


def _way(road: Road, leaving: Mapping[int, list[Road]], rows: list[int], graph: RoadwayGraph) -> Way:
    first, length, passed = road, road.length, {road.nodes[0]}
    while rows[road.nodes[1]] < 0 and road.nodes[1] not in passed:
        passed.add(road.nodes[1])
        onward = [one for one in leaving[road.nodes[1]] if not _same_road(one.reversed(), road)]
        if len(leaving[road.nodes[1]]) != 2 or len(onward) != 1:
            break
        road = onward[0]
        length += road.length
    return Way(_bearing(first.axis), length, rows[road.nodes[1]])


def _same_road(a: Road, b: Road) -> bool:
    return a.nodes == b.nodes and np.array_equal(a.axis, b.axis)


def _bearing(axis: Array) -> float:
    """In which a roadway leaves its first point, by what is a few metres on."""
    away = np.linalg.norm(axis[:, :2] - axis[0, :2], axis=1)
    there = axis[min(int(np.searchsorted(np.maximum.accumulate(away), _BEARING_AFTER_M)), len(axis) - 1)]
    return float(np.arctan2(there[1] - axis[0, 1], there[0] - axis[0, 0]))


def passed_until_told(ways: list[list[Way]], yaws: Mapping[Pair, float]) -> dict[Pair, int]:
    """How many more intersections a robot passes, at the worst, until it knows at which of two it was.

    yaws : the pairs of rows (lower first) that look alike, and the rotation [rad] that lays the first onto the second.
    The robot never turns back: what it knows of the way it came tells nothing new. 1 where the very next intersection,
    or how far away it is, tells on whichever roadway it leaves; `NEVER` where on one of them everything stays alike, or
    where no roadway leads on.
    """
    journeys = _Journeys(ways, {**yaws, **{(b, a): -yaw for (a, b), yaw in yaws.items()}})
    return {pair: journeys.passed(*pair, -1, -1, NEVER) for pair in yaws}


class _Journeys:
    """Goes on from two places at once, as long as they look alike."""

    def __init__(self, ways: list[list[Way]], yaws: Mapping[Pair, float]) -> None:
        self._ways, self._yaws = ways, yaws
        self._known: dict[tuple[int, int, int, int, int], int] = {}

    def passed(self, a: int, b: int, came_a: int, came_b: int, most: int) -> int:
        """Intersections passed until rows a and b are told apart, having come by two of their ways (-1: by none);
        ``most`` where that takes as many or more."""
        key = (a, b, came_a, came_b, most)
        if key not in self._known:
            self._known[key] = self._count(*key)
        return self._known[key]

    def _count(self, a: int, b: int, came_a: int, came_b: int, most: int) -> int:
        worst, reached = 1, False
        for mine, their in self._mates(a, b, came_a, came_b):
            alike = abs(mine.length - their.length) < max(_SAME_LENGTH[0], _SAME_LENGTH[1] * mine.length)
            if alike and mine.target < 0 and their.target < 0:
                continue  # a robot turns round there and knows no more than before
            reached = True
            if not alike or (mine.target, their.target) not in self._yaws:
                continue
            if most <= 1:
                return most
            worst = max(worst, 1 + self.passed(mine.target, their.target, mine.back, their.back, most - 1))
        return min(worst, most) if reached else most

    def _mates(self, a: int, b: int, came_a: int, came_b: int) -> Iterator[tuple[Way, Way]]:
        """The ways on from a, each with the one of b that lies on it, as the two look alike."""
        yaw = self._yaws[a, b]
        onward = [way for k, way in enumerate(self._ways[b]) if k != came_b]
        for k, mine in enumerate(self._ways[a]):
            their = min(onward, key=lambda way: _turn(way.bearing, mine.bearing + yaw), default=None)
            if k != came_a and their is not None and _turn(their.bearing, mine.bearing + yaw) <= _SAME_BEARING:
                yield mine, their


def _turn(a: float, b: float) -> float:
    return abs((a - b + pi) % (2.0 * pi) - pi)
