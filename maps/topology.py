"""Roadway topology: the medial axis of free space, cleaned until its nodes are intersections and its edges roadways."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from maps.corners import corner_of
from maps.free_space import FreeSpace
from maps.pruning import pruned
from maps.roadways import Roadway
from maps.settings import TopologySettings
from maps.skeleton import PixelGraph, skeleton_graph
from semmap.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class Topology:
    """Nodes and roadways in plan view.

    nodes : node number -> (2,) position [m].
    roadways : the edges.
    open_ends : loose ends where it was not seen how the roadway goes on.
    corners : nodes that are no meeting of roadways but a sharp corner of one.
    """

    nodes: dict[int, Array]
    roadways: tuple[Roadway, ...]
    open_ends: frozenset[int]
    corners: frozenset[int]

    def leaving(self) -> dict[int, list[Roadway]]:
        """For each node the roadways that leave it, each with the node first; a loop leaves twice."""
        out: dict[int, list[Roadway]] = {node: [] for node in self.nodes}
        for road in self.roadways:
            out[road.nodes[0]].append(road)
            out[road.nodes[1]].append(road.reversed())
        return out


def roadway_topology(space: FreeSpace, settings: TopologySettings) -> Topology:
    """Graph of the roadways: niches shorter than a branch pruned, bends that meet nothing dissolved unless sharp."""
    graph = skeleton_graph(space.clearance)
    open_ends = _open_ends(graph, space)
    roads = [
        Roadway(ends, space.grid.centres(path), space.clearance[tuple(path.T)])
        for ends, path in zip(graph.edges, graph.paths, strict=True)
    ]
    kept = pruned(roads, open_ends, settings)
    position = space.grid.centres(graph.nodes)
    nodes = {node: position[node] for node in sorted({node for road in kept for node in road.nodes})}
    return _with_corners(nodes, kept, open_ends & nodes.keys(), settings)


def _with_corners(
    nodes: dict[int, Array], roads: tuple[Roadway, ...], open_ends: frozenset[int], settings: TopologySettings
) -> Topology:
    """The topology with a node at every sharp corner."""
    corners: dict[int, Array] = {}
    todo, done = list(roads), []
    while todo:
        road = todo.pop()
        corner = corner_of(road, settings)
        if corner is None:
            done.append(road)
            continue
        number = max(nodes, default=-1) + len(corners) + 1
        corners[number] = corner.p
        todo.extend(road.split(corner.at, number))
    return Topology(nodes | corners, tuple(done), open_ends, frozenset(corners))


def _open_ends(graph: PixelGraph, space: FreeSpace) -> frozenset[int]:
    """Nodes whose nearest boundary is not a wall: there the roadway goes on unseen."""
    frontier = space.frontier()
    if not frontier.any():
        return frozenset()
    to_frontier = ndimage.distance_transform_edt(~frontier) * space.grid.cell
    cells = tuple(graph.nodes.T)
    return frozenset(np.flatnonzero(to_frontier[cells] < space.clearance[cells] + 2.0 * space.grid.cell).tolist())
