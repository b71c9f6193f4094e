"""Roadway topology: the medial axis of free space, cleaned until its nodes are intersections and its edges roadways."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from maps.corners import Corner, corner_of
from maps.free_space import FreeSpace
from maps.pruning import Niche, pruned
from maps.roadways import Roadway
from maps.settings import TopologySettings
from maps.skeleton import SkeletonGraph, skeleton_graph
from semmap.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class Topology:
    """Nodes and roadways on the floor.

    nodes : node number -> (3,) position [m].
    roadways : the edges.
    open_ends : loose ends where it was not seen how the roadway goes on.
    corners : the nodes that are no meeting of roadways but a sharp corner of one.
    niches : the dead ends too short to be roadways that were left out.
    """

    nodes: Mapping[int, Array]
    roadways: tuple[Roadway, ...]
    open_ends: frozenset[int]
    corners: Mapping[int, Corner]
    niches: tuple[Niche, ...]

    def leaving(self) -> dict[int, list[Roadway]]:
        """For each node the roadways that leave it, each with the node first; a loop leaves twice."""
        out: dict[int, list[Roadway]] = {node: [] for node in self.nodes}
        for road in self.roadways:
            out[road.nodes[0]].append(road)
            out[road.nodes[1]].append(road.reversed())
        return out


def roadway_topology(space: FreeSpace, settings: TopologySettings) -> Topology:
    """Graph of the roadways: niches shorter than a branch pruned, bends that meet nothing dissolved unless sharp."""
    graph = skeleton_graph(space)
    open_ends = _open_ends(graph, space)
    roads = [
        Roadway((int(a), int(b)), space.centres(path), space.clearance[path].astype(np.float64))
        for (a, b), path in zip(graph.edges, graph.paths, strict=True)
    ]
    kept, niches = pruned(roads, open_ends, settings)
    roads, corners = cut_at_corners(kept, settings.corner_deg, len(graph.nodes), settings)
    position = space.centres(graph.nodes)
    nodes = {node: position[node] for node in sorted({node for road in kept for node in road.nodes})}
    at = nodes | {node: corner.p for node, corner in corners.items()}
    return Topology(at, tuple(roads), open_ends & nodes.keys(), corners, niches)


def cut_at_corners(
    roads: Iterable[Roadway], turn_deg: float, number: int, settings: TopologySettings
) -> tuple[list[Roadway], dict[int, Corner]]:
    """The roadways with a node at every corner of ``turn_deg`` and more, and these nodes, numbered from ``number``."""
    corners: dict[int, Corner] = {}
    todo, done = list(roads), []
    while todo:
        road = todo.pop()
        corner = corner_of(road, turn_deg, settings)
        if corner is None:
            done.append(road)
            continue
        todo.extend(road.split(corner.at, number + len(corners)))
        corners[number + len(corners)] = corner
    return done, corners


def _open_ends(graph: SkeletonGraph, space: FreeSpace) -> frozenset[int]:
    """Nodes whose nearest boundary is not a wall: there the roadway goes on unseen."""
    frontier = np.flatnonzero(space.frontier())
    if not len(frontier) or not len(graph.nodes):
        return frozenset()
    away, _ = cKDTree(space.centres(frontier)).query(space.centres(graph.nodes))
    return frozenset(np.flatnonzero(away < space.clearance[graph.nodes] + 2.0 * space.cell).tolist())
