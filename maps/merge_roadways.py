"""The roadways of two surveys as one graph: what both show once, what only one shows too, and dead ends that go on.

All of it is decided by where the axes run, not by how either survey happened to divide its roadways.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from maps.road_net import Road, RoadIndex, RoadNet, roads_of
from semmap.geometry import Array
from semmap.intersections import RoadwayGraph

_SAME_END_M = 3.0
"""Ends of roadways nearer than this are one; a stretch shorter than this is not new."""
_GAPS = 0.1
"""A long roadway is known even if this share of it is not on known ones."""
_BESIDE_M = 1.0
"""A roadway that is on a known one for no longer than this only comes near it."""
_CUT_M = 1.0
"""Roadways are cut no nearer than this to their ends."""
_TOGETHER_M = 10.0
"""Roadways that run together for longer than this before they part do not part at the intersection they came from."""
_ENDS = ("dead_end", "open_end")


@dataclass(frozen=True, slots=True, eq=False)
class MergedRoadways:
    """What came of the roadways of two surveys.

    graph : of both. added : length of the roadways that only B shows [m].
    passed : ids of A's intersections that B's roadways run through without showing them.
    meetings : (k, 3) where roadways meet and neither survey shows an intersection [m].
    """

    graph: RoadwayGraph
    added: float
    passed: tuple[int, ...]
    meetings: Array


def merge_roadways(
    a: RoadwayGraph,
    b: RoadwayGraph,
    ids: Mapping[int, int],
    positions: Mapping[int, Array],
    *,
    shift: Array,
    applied: Array,
    min_branch: float,
) -> MergedRoadways:
    """Add what B's roadways show to A's.

    Parameters
    ----------
    ids : id in the merged map of each of B's intersections.
    positions : where the intersections of the merged map are, by their ids there.
    shift : (3,) what takes B's coordinates to A's, for comparison [m].
    applied : (3,) the part of it that B's coordinates are to be moved by [m].
    min_branch : shorter dead ends that are left over where a roadway is cut are dropped [m].
    """
    overlay = _Overlay(a, b, shift, applied, min_branch)
    overlay.place_intersections(ids, positions)
    overlay.match_ends()
    overlay.add_roads()
    overlay.join_ends()
    return overlay.result()


class _Overlay:
    """B's roadways laid over A's; ``net`` is A's graph on its way to the merged one.

    B's nodes are matched to nodes of the net, or are loose: they get a node only if a roadway that is new ends there.
    """

    def __init__(self, a: RoadwayGraph, b: RoadwayGraph, shift: Array, applied: Array, min_branch: float) -> None:
        self.net = RoadNet(a)
        self._known = RoadIndex(self.net.roads.items())
        self._parts = {number: [number] for number in self.net.roads}
        self._b, self._p_b = b, b.node_p_map + shift
        self._roads_b = [replace(road, axis=road.axis + shift) for road in roads_of(b)]
        self._back = applied - shift
        self._min_branch = min_branch
        self._node: dict[int, int] = {}
        self._kept: set[int] = set()
        self._touched: dict[int, None] = {}
        self._passed: dict[int, None] = {}
        self._meetings: list[Array] = []
        self._added = 0.0

    def place_intersections(self, ids: Mapping[int, int], positions: Mapping[int, Array]) -> None:
        """Put every intersection where the merged map has it, and B's new ones onto the roadways they lie on."""
        nodes = {number: node for node, number in self.net.intersection.items() if number >= 0}
        for number, node in nodes.items():
            if not np.array_equal(self.net.p[node], positions[number]):
                self.net.move_node(node, positions[number])
        others = _Nodes(self.net, [node for node, number in self.net.intersection.items() if number < 0])
        for row, id_b in enumerate(self._b.node_intersection.tolist()):
            if id_b >= 0:
                number = ids[id_b]
                if number not in nodes:
                    nodes[number] = self._new_intersection(number, positions[number], self._p_b[row], others)
                self._match(row, nodes[number])

    def _new_intersection(self, number: int, position: Array, p: Array, others: _Nodes) -> int:
        """A node for an intersection that only B shows: A's end or bend at that place, or a new one on A's roadway."""
        free = [node for _, node in others.near(p) if self.net.intersection[node] < 0]
        if not free:
            node = self.net.add_node(position, "intersection", number)
            self._put_on_road(node, p)
            return node
        self.net.kind[free[0]], self.net.intersection[free[0]] = "intersection", number
        self.net.move_node(free[0], position)
        return free[0]

    def _match(self, row: int, node: int) -> None:
        self._node[row] = node
        self._kept.add(node)

    def match_ends(self) -> None:
        """B's ends, bends and halls at places where the net has a node, nearest first; two ends never become one."""
        nodes = _Nodes(self.net, list(self.net.p))
        rows = np.flatnonzero(self._b.node_intersection < 0).tolist()
        found = [(distance, row, node) for row in rows for distance, node in nodes.near(self._p_b[row])]
        taken: set[int] = set()
        for _, row, node in sorted(found):
            if row not in self._node and node not in taken:
                self._match(row, node)
                self._compare_kinds(node, str(self._b.node_kind[row]))
                if self.net.intersection[node] < 0:
                    taken.add(node)

    def _compare_kinds(self, node: int, kind_b: str) -> None:
        """Where A's roadway went on unseen B may know how it ends; where B shows a mere bend, A had an intersection."""
        if self.net.kind[node] == "open_end":
            self.net.kind[node] = kind_b
        elif self.net.kind[node] == "intersection" and kind_b == "bend":
            self._passed[self.net.intersection[node]] = None

    def add_roads(self) -> None:
        """B's roadways, cut where known nodes lie on them; the pieces that lie along known roadways are not new."""
        nodes = _Nodes(self.net, list(self.net.p))
        for piece in [piece for road in self._roads_b for piece in self._pieces(self._named(road), nodes)]:
            on = self._known.road_at(piece.samples()) >= 0
            if not _is_known(on, piece.length):
                self._add(piece, on)

    def _named(self, road: Road) -> Road:
        """A road of B between nodes of the net; a loose node has the number -1 - row."""
        start, end = (self._node.get(row, -1 - row) for row in road.nodes)
        return replace(road, nodes=(start, end))

    def _pieces(self, road: Road, nodes: _Nodes) -> list[Road]:
        """The road cut at the nodes that lie on it, away from its ends."""
        on = nodes.along(road.samples(), road.reach) - set(road.nodes)
        places = sorted((road.nearest(self.net.p[node])[0], node) for node in on if self.net.kind[node] != "hall")
        pieces, begin, total = [], 0.0, road.length
        for at, node in places:
            if at - begin > road.reach and total - at > road.reach:
                self._kept.add(node)
                if self.net.intersection[node] >= 0:
                    self._passed[self.net.intersection[node]] = None
                first, road = road.cut(at - begin, node, self.net.p[node])
                pieces.append(first)
                begin = at
        return [*pieces, road]

    def _add(self, piece: Road, on: NDArray[np.bool_]) -> None:
        """Add the stretches of a piece that are new; where they leave known roadways, not at its ends, is a meeting."""
        samples = piece.samples()
        step = piece.length / (len(samples) - 1)
        nodes = {0: piece.nodes[0], len(samples) - 1: piece.nodes[1]}
        for first, last in _new_stretches(on, step):
            for k in (first, last):
                if k not in nodes:
                    nodes[k] = self._meeting(samples[k])
            a, b = nodes[first], nodes[last] = self._placed(nodes[first]), self._placed(nodes[last])
            road = piece.between((first * step, last * step), (a, b), samples[[first, last]])
            self.net.add_road(road.changed((a, b), road.axis + self._back, road.profile))
            self._added += road.length
            self._touched |= {a: None, b: None}

    def _meeting(self, p: Array) -> int:
        """A node on a known roadway where a new one leaves it."""
        node = self.net.add_node(p, "bend")
        self._put_on_road(node, p)
        self._meetings.append(p)
        return node

    def _placed(self, node: int) -> int:
        """The node itself, or for a loose one a new node of the net."""
        row = -1 - node
        if node < 0 and row not in self._node:
            self._match(row, self.net.add_node(self._p_b[row] + self._back, str(self._b.node_kind[row])))
            self._put_on_road(self._node[row], self._p_b[row])
        return node if node >= 0 else self._node[row]

    def _put_on_road(self, node: int, p: Array) -> None:
        """Cut the known roadway that a new node at ``p`` (3,) lies on, away from its ends."""
        known = int(self._known.road_at(p[None])[0])
        if known < 0:
            return
        parts = self._parts[known]
        number = min(parts, key=lambda part: self.net.roads[part].nearest(p)[1])
        at, _ = self.net.roads[number].nearest(p)
        if _CUT_M < at < self.net.roads[number].length - _CUT_M:
            parts.remove(number)
            parts += [half for half in self.net.cut(number, at, node) if not self._drop_leftover(half, node)]

    def _drop_leftover(self, number: int, node: int) -> bool:
        """Take away what a cut at ``node`` left of a dead end that B does not show, if it is shorter than a branch."""
        road = self.net.roads[number]
        end = road.nodes[1] if road.nodes[0] == node else road.nodes[0]
        loose = self.net.kind[end] in _ENDS and len(self.net.leaving(end)) == 1 and end not in self._kept
        if road.length >= self._min_branch or not loose:
            return False
        self.net.remove_road(number)
        self.net.remove_node(end)
        return True

    def join_ends(self) -> None:
        """Ends that are none any more: two roadways become one; where more meet, neither shows an intersection."""
        for node in self._touched:
            roads = self.net.leaving(node) if self.net.kind[node] in _ENDS else []
            if len(roads) > 2:
                self.net.kind[node] = "bend"
                self._meetings.append(self.net.p[node])
            elif len(set(roads)) == 2:
                self.net.dissolve(node)

    def result(self) -> MergedRoadways:
        """What came of it."""
        meetings = np.array(self._meetings).reshape(-1, 3)
        return MergedRoadways(self.net.graph(), self._added, tuple(self._passed), meetings)


class _Nodes:
    """Some nodes of a net as they lie now, to be found by place."""

    def __init__(self, net: RoadNet, nodes: list[int]) -> None:
        self._nodes = nodes
        self._p = np.array([net.p[node] for node in nodes]).reshape(-1, 3)
        self._tree = cKDTree(self._p)

    def near(self, p: Array) -> list[tuple[float, int]]:
        """Those at the same place as a point (3,), nearest first, each with its distance [m]."""
        rows = self._tree.query_ball_point(p, _SAME_END_M)
        return sorted((float(np.linalg.norm(self._p[row] - p)), self._nodes[row]) for row in rows)

    def along(self, line: Array, reach: float) -> set[int]:
        """Those nearer than ``reach`` [m] to one of the points (n, 3)."""
        return {self._nodes[k] for some in self._tree.query_ball_point(line, reach) for k in some}


def _is_known(on: NDArray[np.bool_], length: float) -> bool:
    """Whether a piece of which the samples ``on`` lie along known roadways is nothing new."""
    unknown = float(np.mean(~on))
    return unknown * length < _SAME_END_M or (unknown < _GAPS and unknown * length < _TOGETHER_M)


def _new_stretches(on: NDArray[np.bool_], step: float) -> list[tuple[int, int]]:
    """First and last sample of the stretches to add of a piece whose samples ``on``, ``step`` [m] apart, are known.

    A stretch runs on to the end of the piece, or across a known roadway to the middle of it, unless the piece runs
    along known roadways there for long.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~on, [False]]).astype(np.int8)))
    runs = edges.reshape(-1, 2)
    length = np.diff(runs, axis=1)[:, 0]
    runs = runs[length >= min(_SAME_END_M / step, length.max())].tolist()
    bounds = [0 if runs[0][0] * step <= _TOGETHER_M else runs[0][0] - 1]
    for (_, end), (begin, _) in pairwise(runs):
        if (begin - end) * step > _TOGETHER_M:
            bounds += [end, begin - 1]
        elif (begin - end) * step > _BESIDE_M:
            bounds += [(begin + end) // 2] * 2
    left = len(on) - runs[-1][1]
    bounds.append(len(on) - 1 if left * step <= _TOGETHER_M else runs[-1][1])
    return list(zip(bounds[::2], bounds[1::2], strict=True))
