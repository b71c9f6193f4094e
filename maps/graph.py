"""The roadway graph of a semantic map: how its intersections, bends and ends are joined, and by what roadways."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from maps.branches import widths
from maps.free_space import FreeSpace
from maps.intersections import Crossing, runs_within
from maps.roadways import Roadway
from maps.settings import TopologySettings
from maps.topology import Topology, cut_at_corners
from semmap.geometry import Array
from semmap.intersections import RoadwayGraph, axis_slope

_AXIS_STEP_M = 1.0
_SMOOTH_M = 0.5
_SIDE_ROADWAY = 3.0
"""Where the walls left and right are more than this many times as far apart as the nearest is off, a roadway leaves."""


def roadway_graph(
    topology: Topology, crossings: Sequence[Crossing], space: FreeSpace, origin: Array, settings: TopologySettings
) -> RoadwayGraph:
    """Graph whose first nodes are the intersections, in their order.

    The others are ends of roadways, halls, and bends: turns by ``settings.bend_deg`` and more that are none.

    origin : (3,) added to every position to come to the map frame.
    """
    row = {node: number for number, crossing in enumerate(crossings) for node in crossing.nodes}
    roads = [road for road in topology.roadways if not _within_one(road, row, crossings)]
    roads, bends = cut_at_corners(roads, settings.bend_deg, max(topology.nodes, default=-1) + 1, settings)
    at = dict(topology.nodes) | {node: bend.p for node, bend in bends.items()}
    others = [node for node in sorted(at) if node not in row]
    row |= {node: len(crossings) + k for k, node in enumerate(others)}
    p = np.array([crossing.p for crossing in crossings] + [at[node] for node in others]).reshape(-1, 3)
    edges = np.array([[row[node] for node in road.nodes] for road in roads], np.int64).reshape(-1, 2)
    axes = [_axis(road, *p[ends]) for road, ends in zip(roads, edges, strict=True)]
    profiles = [_profile(road, axis, space) for road, axis in zip(roads, axes, strict=True)]
    open_ends = np.array([row[node] for node in topology.open_ends], np.int64)
    ids = np.arange(len(p), dtype=np.int64)
    return RoadwayGraph(
        node_p_map=p + origin,
        node_intersection=np.where(ids < len(crossings), ids, -1),
        node_kind=_kinds(edges, len(crossings), open_ends, len(p)),
        edge_nodes=edges,
        edge_length=np.array([np.linalg.norm(np.diff(axis, axis=0), axis=1).sum() for axis in axes]),
        edge_width=np.array([_median(profile[:, 0]) for profile in profiles]),
        edge_height=np.array([_median(profile[:, 1]) for profile in profiles]),
        edge_slope=np.array([axis_slope(axis) for axis in axes]),
        edge_axes=tuple(axis + origin for axis in axes),
        edge_profiles=tuple(profiles),
    )


def _within_one(road: Roadway, row: Mapping[int, int], crossings: Sequence[Crossing]) -> bool:
    """Whether a roadway is only a piece of one intersection."""
    number = row.get(road.nodes[0])
    return number is not None and runs_within(road, crossings[number].nodes)


def _kinds(edges: NDArray[np.int64], crossings: int, open_ends: NDArray[np.int64], nodes: int) -> NDArray[np.str_]:
    """Kinds (n,) of the nodes: the first are intersections, the others what the number of their roadways makes them."""
    leave = np.bincount(edges.ravel(), minlength=nodes)
    kinds = np.array(["dead_end", "dead_end", "bend", "hall"])[np.minimum(leave, 3)].astype("<U12")
    kinds[open_ends] = "open_end"
    kinds[:crossings] = "intersection"
    return np.asarray(kinds, dtype=np.str_)


def _axis(road: Roadway, start: Array, end: Array) -> Array:
    """Axis (k, 3) of a roadway from node to node, without the steps of the cells."""
    walked, _ = road.resampled(_AXIS_STEP_M)
    even, fine = road.resampled(0.5 * _SMOOTH_M)
    smooth = gaussian_filter1d(fine, 2.0, axis=0, mode="nearest")
    inner = [np.interp(walked[1:-1], even, smooth[:, k]) for k in range(3)]
    return np.vstack([start, np.stack(inner, axis=-1), end])


def _profile(road: Roadway, axis: Array, space: FreeSpace) -> Array:
    """Width and height (k, 2) at each point of the axis [m], 0 where not known.

    The width is the distance between the walls left and right; where a roadway leaves, twice that to the nearest wall.
    """
    walked, _ = road.resampled(_AXIS_STEP_M)
    clearance = np.interp(walked, road.walked, road.clearance)
    across = widths(axis, space)
    rows = space.find(axis)
    height = np.where(rows >= 0, space.headroom[rows], 0.0)
    width = np.where(across > _SIDE_ROADWAY * clearance, 2.0 * clearance, across)
    return np.column_stack([width, np.where(np.isfinite(height), height, 0.0)])


def _median(values: Array) -> float:
    """Median of the known values, 0 where none is."""
    return float(np.median(values[values > 0.0])) if (values > 0.0).any() else 0.0
