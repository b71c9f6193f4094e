"""Intersections in a roadway topology: which nodes are one, where they are, and of what kind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maps.branches import Branch, branch_of
from maps.free_space import FreeSpace
from maps.invariant_point import invariant_point
from maps.roadways import Roadway
from maps.settings import TopologySettings
from maps.topology import Topology
from semmap.geometry import Array

_CLOSE_CALL = 1.5
"""Neighbours this many times nearer or farther than the limit might be called the other way by another view."""


@dataclass(frozen=True, slots=True, eq=False)
class Crossing:
    """An intersection found in plan view.

    p : (3,) geometric invariant point on the floor [m].
    kind : ``L, T, Y, X`` or ``multi``.
    branches : by ascending bearing.
    nodes : nodes of the topology it is made of.
    """

    p: Array
    kind: str
    branches: tuple[Branch, ...]
    nodes: frozenset[int]


def find_intersections(topology: Topology, space: FreeSpace, settings: TopologySettings) -> list[Crossing]:
    """Every place where three roadways or more meet, and every sharp corner; halls and yards are left out."""
    return _crossings(topology, space, settings, (1.0,))


def find_alternatives(topology: Topology, space: FreeSpace, settings: TopologySettings) -> list[Crossing]:
    """The same, and wherever it is a close call whether neighbours are one intersection or two, both readings.

    A view that shows a little less than the map may call it the other way.
    """
    return _crossings(topology, space, settings, (1.0, 1.0 / _CLOSE_CALL, _CLOSE_CALL))


def _crossings(
    topology: Topology, space: FreeSpace, settings: TopologySettings, factors: tuple[float, ...]
) -> list[Crossing]:
    leaving = topology.leaving()
    hubs = _hubs(topology, leaving, space, settings)
    readings = [_merged(topology, hubs, space, settings.merge * factor) for factor in factors]
    groups = dict.fromkeys(group for reading in readings for group in reading)
    crossings = [_crossing(group, leaving, hubs, space, settings) for group in groups]
    return [crossing for crossing in crossings if crossing is not None]


def _hubs(
    topology: Topology, leaving: dict[int, list[Roadway]], space: FreeSpace, settings: TopologySettings
) -> dict[int, Array]:
    """Nodes where three roadways or more meet, and corners, each with its invariant point (2,)."""
    meeting = [node for node in topology.nodes if len(leaving[node]) >= 3 or node in topology.corners]
    hubs = {node: invariant_point(topology.nodes[node], space.clearance, space.grid) for node in meeting}
    return {node: p for node, p in hubs.items() if space.clearance_at(p) <= settings.max_half_width}


def _merged(topology: Topology, hubs: dict[int, Array], space: FreeSpace, ratio: float) -> list[frozenset[int]]:
    """Hubs grouped where the roadway that joins them is too short to be one."""
    group = {node: node for node in hubs}
    for road in topology.roadways:
        a, b = road.nodes
        if a in hubs and b in hubs and _are_one(hubs[a], hubs[b], road, space, ratio):
            old, new = group[a], group[b]
            group = {node: new if label == old else label for node, label in group.items()}
    return [frozenset(n for n in group if group[n] == label) for label in sorted(set(group.values()))]


def _are_one(a: Array, b: Array, road: Roadway, space: FreeSpace, ratio: float) -> bool:
    reach = ratio * (space.clearance_at(a) + space.clearance_at(b))
    return bool(np.linalg.norm(a - b) < reach and road.length < 2.0 * reach)


def _crossing(
    group: frozenset[int],
    leaving: dict[int, list[Roadway]],
    hubs: dict[int, Array],
    space: FreeSpace,
    settings: TopologySettings,
) -> Crossing | None:
    roads = [road for node in sorted(group) for road in leaving[node] if not _inside(road, group)]
    if len(roads) < 2:
        return None
    p = np.mean([hubs[node] for node in sorted(group)], axis=0)
    branches = sorted((branch_of(road, p, space, settings.axis_length) for road in roads), key=lambda b: b.bearing)
    kind = kind_of(np.array([branch.bearing for branch in branches]))
    return Crossing(np.append(p, space.ground.at(p[None])), kind, tuple(branches), group)


def _inside(road: Roadway, group: frozenset[int]) -> bool:
    """Whether a roadway runs within an intersection: between its nodes, and no longer than around a pillar."""
    return set(road.nodes) <= group and road.length < 20.0


def kind_of(bearings: Array) -> str:
    """``L, T, Y, X`` or ``multi`` from the branch bearings (b,) [rad]."""
    if len(bearings) >= 4:
        return "X" if len(bearings) == 4 else "multi"
    if len(bearings) == 2:
        return "L"
    between = (bearings - np.roll(bearings, 1) + np.pi) % (2.0 * np.pi) - np.pi
    turn = np.sort(np.abs(between))
    return "T" if turn[-1] > np.radians(150.0) and turn[0] > np.radians(45.0) else "Y"
