"""The roadway graph of a semantic map, from the topology in plan view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from maps.free_space import FreeSpace
from maps.intersections import Crossing
from maps.roadways import Roadway
from maps.topology import Topology
from semmap.geometry import Array
from semmap.intersections import RoadwayGraph, axis_slope

_AXIS_STEP_M = 1.0


def roadway_graph(topology: Topology, crossings: Sequence[Crossing], space: FreeSpace, origin: Array) -> RoadwayGraph:
    """Graph whose first nodes are the intersections, in their order, and the others dead ends and halls.

    origin : (3,) added to every position to come to the map frame.
    """
    row = {node: number for number, crossing in enumerate(crossings) for node in crossing.nodes}
    others = [node for node in sorted(topology.nodes) if node not in row]
    row |= {node: len(crossings) + k for k, node in enumerate(others)}
    floor = _on_floor(np.array([topology.nodes[node] for node in others]).reshape(-1, 2), space)
    p = np.concatenate([np.array([crossing.p for crossing in crossings]).reshape(-1, 3), floor])
    roads = [road for road in topology.roadways if not _within_one(road, row, len(crossings))]
    axes = [_axis(road, p[row[road.nodes[0]]], p[row[road.nodes[1]]], space) for road in roads]
    ids = np.arange(len(p), dtype=np.int64)
    return RoadwayGraph(
        node_p_map=p + origin,
        node_intersection=np.where(ids < len(crossings), ids, -1),
        node_kind=np.concatenate([np.full(len(crossings), "intersection"), _kinds(others, topology)]),
        edge_nodes=np.array([[row[a], row[b]] for a, b in (road.nodes for road in roads)], np.int64).reshape(-1, 2),
        edge_length=np.array([np.linalg.norm(np.diff(axis, axis=0), axis=1).sum() for axis in axes]),
        edge_width=np.array([2.0 * np.median(road.clearance) for road in roads]),
        edge_height=np.zeros(len(roads)),
        edge_slope=np.array([axis_slope(axis) for axis in axes]),
        edge_axes=tuple(axis + origin for axis in axes),
        edge_profiles=tuple(_profile(road) for road in roads),
    )


def _kinds(nodes: Sequence[int], topology: Topology) -> NDArray[np.str_]:
    """Kinds of the nodes that are no intersections."""
    leaving = topology.leaving()
    kinds = ["open_end" if n in topology.open_ends else "hall" if len(leaving[n]) > 1 else "dead_end" for n in nodes]
    return np.array(kinds, dtype=np.str_)


def _profile(road: Roadway) -> Array:
    """Width and height (k, 2) at each point of the axis [m]; the height is not known here."""
    walked, _ = road.resampled(_AXIS_STEP_M)
    at = np.linspace(0.0, walked[-1], len(road.clearance))
    return np.column_stack([2.0 * np.interp(walked, at, road.clearance), np.zeros(len(walked))])


def _within_one(road: Roadway, row: dict[int, int], intersections: int) -> bool:
    """Whether a roadway is only a piece of one intersection."""
    a, b = row[road.nodes[0]], row[road.nodes[1]]
    return a == b and a < intersections and road.nodes[0] != road.nodes[1]


def _axis(road: Roadway, start: Array, end: Array, space: FreeSpace) -> Array:
    """Axis (k, 3) of a roadway from node to node, on the floor."""
    _, line = road.resampled(_AXIS_STEP_M)
    return np.vstack([start, _on_floor(line[1:-1], space), end])


def _on_floor(xy: Array, space: FreeSpace) -> Array:
    return np.column_stack([xy, space.ground.at(xy)]) if len(xy) else np.zeros((0, 3))
