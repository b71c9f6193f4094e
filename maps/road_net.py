"""A roadway graph that can be changed: roads are cut, joined, added, and looked for by place."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from semmap.geometry import Array
from semmap.intersections import RoadwayGraph, axis_slope

_STEP_M = 0.5
_TINY_M = 1e-6
_REACH_M = (1.5, 2.5)
"""Least and greatest distance from an axis that is still on the road: half its width, within these."""


@dataclass(frozen=True, slots=True, eq=False)
class Road:
    """One roadway, see `RoadwayGraph`: ``profile`` (k, 2) is its width and height along the ``axis`` (k, 3)."""

    nodes: tuple[int, int]
    axis: Array
    profile: Array
    length: float
    width: float
    height: float
    slope: float

    @property
    def reach(self) -> float:
        """What is nearer than this to the axis is on the road [m]."""
        return float(np.clip(0.5 * self.width, *_REACH_M))

    def walked(self) -> Array:
        """Length (k,) along the axis up to each of its points [m]."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.axis, axis=0), axis=1))])

    def reversed(self) -> Road:
        """The same road from its other end."""
        (a, b), axis, profile = self.nodes, self.axis[::-1], self.profile[::-1]
        return replace(self, nodes=(b, a), axis=axis, profile=profile, slope=-self.slope)

    def changed(self, nodes: tuple[int, int], axis: Array, profile: Array) -> Road:
        """Another course: length and slope follow from it, width and height where the profile knows them."""
        length = float(np.linalg.norm(np.diff(axis, axis=0), axis=1).sum())
        width, height = _median(profile[:, 0], self.width), _median(profile[:, 1], self.height)
        return Road(nodes, axis, profile, length, width, height, axis_slope(axis))

    def ending_at(self, nodes: tuple[int, int], start: Array, end: Array) -> Road:
        """The same road with its first and last point moved to its nodes."""
        if np.array_equal(self.axis[0], start) and np.array_equal(self.axis[-1], end):
            return replace(self, nodes=nodes)
        return self.changed(nodes, np.vstack([start, self.axis[1:-1], end]), self.profile)

    def cut(self, at: float, node: int, p: Array) -> tuple[Road, Road]:
        """The two parts, cut ``at`` [m] along the axis, where ``node`` is at ``p`` (3,)."""
        (a, b), total = self.nodes, float(self.walked()[-1])
        first = self.between((0.0, at), (a, node), np.stack([self.axis[0], p]))
        return first, self.between((at, total), (node, b), np.stack([p, self.axis[-1]]))

    def between(self, at: tuple[float, float], nodes: tuple[int, int], p: Array) -> Road:
        """The part between two places ``at`` [m] along the axis, where ``nodes`` are at ``p`` (2, 3)."""
        walked = self.walked()
        inner = slice(*np.searchsorted(walked, [at[0] + _TINY_M, at[1] - _TINY_M]).tolist())
        ends = np.stack([np.interp(at, walked, column) for column in self.profile.T], axis=-1)
        axis = np.vstack([p[:1], self.axis[inner], p[1:]])
        return self.changed(nodes, axis, np.vstack([ends[:1], self.profile[inner], ends[1:]]))

    def joined(self, after: Road) -> Road:
        """This road and the one that goes on from its second node."""
        axis = np.vstack([self.axis, after.axis[1:]])
        return self.changed((self.nodes[0], after.nodes[1]), axis, np.vstack([self.profile, after.profile[1:]]))

    def nearest(self, p: Array) -> tuple[float, float]:
        """Where along the axis a point (3,) lies, and how far from it [m]."""
        start, step = self.axis[:-1], np.diff(self.axis, axis=0)
        square = np.maximum(np.sum(step**2, axis=1), 1e-12)
        share = np.clip(np.sum((p - start) * step, axis=1) / square, 0.0, 1.0)
        distance = np.linalg.norm(start + share[:, None] * step - p, axis=1)
        k = int(np.argmin(distance))
        return float(self.walked()[k] + share[k] * np.sqrt(square[k])), float(distance[k])

    def samples(self) -> Array:
        """Points (n, 3) along the axis, half a metre apart."""
        walked = self.walked()
        at = np.linspace(0.0, walked[-1], max(2, int(np.ceil(walked[-1] / _STEP_M)) + 1))
        return np.stack([np.interp(at, walked, column) for column in self.axis.T], axis=-1)


def _median(values: Array, otherwise: float) -> float:
    known = values[values > 0.0]
    return float(np.median(known)) if len(known) else otherwise


class RoadNet:
    """A roadway graph to be changed; nodes and roads have numbers that stay theirs.

    Attributes
    ----------
    p : node -> (3,) [m]. kind : node -> of `NODE_KINDS`. intersection : node -> id, -1 for none.
    roads : number -> `Road`.
    """

    def __init__(self, graph: RoadwayGraph) -> None:
        self.p: dict[int, Array] = dict(enumerate(graph.node_p_map))
        self.kind: dict[int, str] = dict(enumerate(graph.node_kind.tolist()))
        self.intersection: dict[int, int] = dict(enumerate(graph.node_intersection.tolist()))
        self.roads: dict[int, Road] = {}
        self._at: dict[int, list[int]] = {node: [] for node in self.p}
        self._next_node, self._next_road = len(self.p), 0
        for road in roads_of(graph):
            self._put(road)

    def add_node(self, p: Array, kind: str, intersection: int = -1) -> int:
        """A new node; returns its number."""
        node = self._next_node
        self.p[node], self.kind[node], self.intersection[node], self._at[node] = p, kind, intersection, []
        self._next_node += 1
        return node

    def remove_node(self, node: int) -> None:
        """Take away a node at which no road ends."""
        del self.p[node], self.kind[node], self.intersection[node], self._at[node]

    def move_node(self, node: int, p: Array) -> None:
        """Move a node, and the ends of its roads with it."""
        self.p[node] = p
        for number in self._at[node]:
            self.roads[number] = self._fastened(self.roads[number])

    def add_road(self, road: Road) -> int:
        """A new road between nodes that are there, its ends moved onto them; returns its number."""
        return self._put(self._fastened(road))

    def remove_road(self, number: int) -> Road:
        """Take a road away; its nodes stay."""
        road = self.roads.pop(number)
        for node in road.nodes:
            self._at[node].remove(number)
        return road

    def leaving(self, node: int) -> list[int]:
        """Numbers of the roads that end at a node; a loop ends twice."""
        return self._at[node]

    def cut(self, number: int, at: float, node: int) -> tuple[int, int]:
        """Cut a road ``at`` [m] along its axis, where ``node`` then lies on it; returns the numbers of its parts."""
        first, second = self.remove_road(number).cut(at, node, self.p[node])
        return self._put(first), self._put(second)

    def dissolve(self, node: int) -> None:
        """Make one road of the two that meet at a node, and take the node away."""
        first, second = (self.remove_road(number) for number in tuple(self._at[node]))
        first = first if first.nodes[1] == node else first.reversed()
        second = second if second.nodes[0] == node else second.reversed()
        self._put(first.joined(second))
        self.remove_node(node)

    def _put(self, road: Road) -> int:
        number = self._next_road
        self.roads[number] = road
        for node in road.nodes:
            self._at[node].append(number)
        self._next_road += 1
        return number

    def _fastened(self, road: Road) -> Road:
        a, b = road.nodes
        return road.ending_at(road.nodes, self.p[a], self.p[b])

    def graph(self) -> RoadwayGraph:
        """As a roadway graph: intersections first, then the other nodes, else in the order they came."""
        nodes = sorted(self.p, key=lambda node: self.intersection[node] < 0)
        row = {node: number for number, node in enumerate(nodes)}
        roads = list(self.roads.values())
        return RoadwayGraph(
            node_p_map=np.array([self.p[node] for node in nodes]).reshape(-1, 3),
            node_intersection=np.array([self.intersection[node] for node in nodes], np.int64),
            node_kind=np.array([self.kind[node] for node in nodes], np.str_),
            edge_nodes=np.array([[row[a], row[b]] for a, b in (road.nodes for road in roads)], np.int64).reshape(-1, 2),
            edge_length=np.array([road.length for road in roads]),
            edge_width=np.array([road.width for road in roads]),
            edge_height=np.array([road.height for road in roads]),
            edge_slope=np.array([road.slope for road in roads]),
            edge_axes=tuple(road.axis for road in roads),
            edge_profiles=tuple(road.profile for road in roads),
        )


def roads_of(graph: RoadwayGraph) -> list[Road]:
    """The edges of a graph as roads between the rows of its nodes."""
    columns = (graph.edge_length, graph.edge_width, graph.edge_height, graph.edge_slope)
    figures = np.stack(columns, axis=-1).tolist()
    rows = zip(graph.edge_nodes.tolist(), graph.edge_axes, graph.edge_profiles, figures, strict=True)
    return [_road((a, b), axis, profile, figures, graph) for (a, b), axis, profile, figures in rows]


def _road(nodes: tuple[int, int], axis: Array, profile: Array, figures: list[float], graph: RoadwayGraph) -> Road:
    """A road that has a course: without one, straight from node to node."""
    if len(axis) < 2:
        axis, profile = graph.node_p_map[list(nodes)], np.zeros((2, 2))
    return Road(nodes, axis, profile, *figures)


class RoadIndex:
    """Finds the road that a point lies on, among the roads there were when it was made."""

    def __init__(self, roads: Iterable[tuple[int, Road]]) -> None:
        numbers, lines, reach = [], [np.zeros((0, 3))], []
        for number, road in roads:
            lines.append(road.samples())
            numbers += [number] * len(lines[-1])
            reach += [road.reach] * len(lines[-1])
        self._tree = cKDTree(np.concatenate(lines))
        self._number = np.array([*numbers, -1], np.int64)
        self._reach = np.array([*reach, 0.0])

    def road_at(self, p: Array) -> NDArray[np.int64]:
        """Numbers (n,) of the roads that points (n, 3) lie on, -1 for none."""
        distance, nearest = self._tree.query(p)
        return np.where(distance <= self._reach[nearest], self._number[nearest], -1)
