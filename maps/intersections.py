"""Intersections in a roadway topology: which nodes are one, where they are, and of what kind."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from maps.branches import Branch, branch_of
from maps.free_space import FreeSpace
from maps.invariant_point import invariant_point, on_floor
from maps.pruning import standing
from maps.roadways import Roadway
from maps.settings import TopologySettings
from maps.sureness import CLOSE_CALL, clear_cut
from maps.topology import Topology
from semmap.geometry import Array

_AROUND_PILLAR_M = 20.0
"""A roadway between the nodes of one intersection that is shorter than this runs within it."""


@dataclass(frozen=True, slots=True, eq=False)
class Crossing:
    """An intersection found on the floor.

    p : (3,) geometric invariant point on the floor [m].
    kind : ``L, T, Y, X`` or ``multi``.
    branches : by ascending bearing.
    nodes : nodes of the topology it is made of.
    sureness : how clear-cut the closest of the decisions is that made it what it is: 1 where none is a close call, 0.5
        where one might as well have gone the other way. They are: each dead end counted or left out as a branch,
        each neighbour merged or kept apart, the turn of a corner, and that it is no hall.
    """

    p: Array
    kind: str
    branches: tuple[Branch, ...]
    nodes: frozenset[int]
    sureness: float


@dataclass(frozen=True, slots=True, eq=False)
class _Hub:
    """A node that may be an intersection: its invariant point (3,) and the distance from there to the walls [m]."""

    p: Array
    clearance: float


@dataclass(frozen=True, slots=True, eq=False)
class _Link:
    """A roadway between two hubs, and how far apart it leaves them, in sums of their distances to the walls."""

    hubs: tuple[int, int]
    apart: float


def find_intersections(topology: Topology, space: FreeSpace, settings: TopologySettings) -> list[Crossing]:
    """Every place where three roadways or more meet, and every sharp corner; halls and yards are left out."""
    return _Finder(topology, space, settings).crossings((1.0,))


def find_alternatives(topology: Topology, space: FreeSpace, settings: TopologySettings) -> list[Crossing]:
    """The same, and wherever it is a close call whether neighbours are one intersection or two, both readings.

    A view that shows a little less than the map may call it the other way.
    """
    return _Finder(topology, space, settings).crossings((1.0, 1.0 / CLOSE_CALL, CLOSE_CALL))


class _Finder:
    """Looks for the intersections of one topology."""

    def __init__(self, topology: Topology, space: FreeSpace, settings: TopologySettings) -> None:
        self.topology, self.space, self.settings = topology, space, settings
        self.leaving = topology.leaving()
        self.hubs = self._hubs()
        self.links = [_link(road, self.hubs) for road in topology.roadways if self.hubs.keys() >= set(road.nodes)]
        self.links_at: dict[int, list[_Link]] = {node: [] for node in self.hubs}
        for link in self.links:
            for node in set(link.hubs):
                self.links_at[node].append(link)
        self.niches = cKDTree(np.array([niche.mouth for niche in topology.niches]).reshape(-1, 3))

    def _hubs(self) -> dict[int, _Hub]:
        """Nodes where three roadways or more meet, and corners, but for those in halls."""
        nodes = self.topology.nodes
        meeting = [node for node in nodes if len(self.leaving[node]) >= 3 or node in self.topology.corners]
        points = {node: invariant_point(nodes[node], self.space) for node in meeting}
        hubs = {node: _Hub(p, self.space.clearance_at(p)) for node, p in points.items()}
        return {node: hub for node, hub in hubs.items() if hub.clearance <= self.settings.max_half_width}

    def crossings(self, factors: tuple[float, ...]) -> list[Crossing]:
        """The crossings where neighbours are one within these factors of the usual distance, each of them once."""
        readings = [grouped(self.hubs, self.links, self.settings.merge * factor) for factor in factors]
        groups = dict.fromkeys(group for reading in readings for group in reading)
        crossings = (self._crossing(group) for group in groups)
        return [crossing for crossing in crossings if crossing is not None]

    def _crossing(self, group: frozenset[int]) -> Crossing | None:
        roads = [road for node in sorted(group) for road in self.leaving[node] if not runs_within(road, group)]
        if len(roads) < 2:
            return None
        p = self._middle(group)
        branches = sorted((branch_of(road, p, self.space, self.settings.axis_length) for road in roads), key=_bearing)
        bearings = np.array([branch.bearing for branch in branches])
        if len(roads) == 2 and _turn(bearings) < np.radians(self.settings.corner_deg) and not self._is_corner(group):
            return None
        closest = min(map(clear_cut, self._decisions(group, roads, p)), default=1.0)
        return Crossing(p, kind_of(bearings), tuple(branches), group, 0.5 + 0.5 * closest)

    def _is_corner(self, group: frozenset[int]) -> bool:
        return not group.isdisjoint(self.topology.corners)

    def _middle(self, group: frozenset[int]) -> Array:
        """Mean of the invariant points; that of them nearest to it where it is not on the floor."""
        points = np.array([self.hubs[node].p for node in sorted(group)])
        middle: Array = points.mean(axis=0)
        if len(group) > 1 and self.space.find(middle)[0] < 0:
            middle = points[np.argmin(np.linalg.norm(points - middle, axis=1))]
        return on_floor(middle, self.space)

    def _decisions(self, group: frozenset[int], roads: list[Roadway], p: Array) -> Iterator[float]:
        """How many times their limit the figures are that made the group this crossing."""
        clearance = max(self.hubs[node].clearance for node in group)
        yield clearance / self.settings.max_half_width
        for node in group:
            yield from (link.apart / self.settings.merge for link in self.links_at[node] if len(set(link.hubs)) == 2)
        for node in group & self.topology.corners.keys():
            yield self.topology.corners[node].turn / np.radians(self.settings.corner_deg)
        for road in roads:
            if len(self.leaving[road.nodes[1]]) == 1:
                yield standing(road, self.topology.open_ends, self.settings)
        for near in self.niches.query_ball_point(p, 1.5 * clearance):
            yield self.topology.niches[near].standing


def grouped(hubs: Mapping[int, object], links: list[_Link], limit: float) -> list[frozenset[int]]:
    """Hubs in groups, by their lowest number: two are in one where a link leaves them less than ``limit`` apart."""
    lead = {node: node for node in hubs}

    def leader(node: int) -> int:
        while lead[node] != node:
            lead[node] = lead[lead[node]]
            node = lead[node]
        return node

    for link in links:
        if link.apart < limit:
            low, high = sorted(map(leader, link.hubs))
            lead[high] = low
    groups: dict[int, set[int]] = {}
    for node in sorted(hubs):
        groups.setdefault(leader(node), set()).add(node)
    return [frozenset(group) for group in groups.values()]


def _link(road: Roadway, hubs: Mapping[int, _Hub]) -> _Link:
    """A roadway counts as short if the hubs are close, and it takes no long way round between them."""
    one, other = hubs[road.nodes[0]], hubs[road.nodes[1]]
    reach = max(one.clearance + other.clearance, 1e-6)
    return _Link(road.nodes, max(float(np.linalg.norm((one.p - other.p)[:2])), 0.5 * road.length) / reach)


def runs_within(road: Roadway, group: frozenset[int]) -> bool:
    return set(road.nodes) <= group and road.length < _AROUND_PILLAR_M


def _bearing(branch: Branch) -> float:
    return branch.bearing


def _turn(bearings: Array) -> float:
    """Angle [rad] by which a way turns that comes and goes along two bearings."""
    return float(np.pi - np.abs((bearings[1] - bearings[0] + np.pi) % (2.0 * np.pi) - np.pi))


def kind_of(bearings: Array) -> str:
    """``L, T, Y, X`` or ``multi`` from the branch bearings (b,) [rad]."""
    if len(bearings) >= 4:
        return "X" if len(bearings) == 4 else "multi"
    if len(bearings) == 2:
        return "L"
    between = (bearings - np.roll(bearings, 1) + np.pi) % (2.0 * np.pi) - np.pi
    turn = np.sort(np.abs(between))
    return "T" if turn[-1] > np.radians(150.0) and turn[0] > np.radians(45.0) else "Y"
