"""The roadway graph: kinds of nodes, where roadways end, widths, heights and slopes along their axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from synthetic_mine import SyntheticMine, corner, straight, t_junction

from maps.columns import columns_of
from maps.free_cells import split_ground_and_walls
from maps.graph import roadway_graph
from maps.intersections import find_intersections
from maps.settings import FreeSpaceSettings, TopologySettings
from maps.topology import roadway_topology
from semmap.geometry import Array
from semmap.intersections import NODE_KINDS, RoadwayGraph

SETTINGS = TopologySettings()
ORIGIN = np.array([2000.0, -1000.0, 300.0])


def graph_of(cloud: Array) -> RoadwayGraph:
    space = split_ground_and_walls(columns_of(cloud, FreeSpaceSettings()), FreeSpaceSettings())
    topology = roadway_topology(space, SETTINGS)
    graph = roadway_graph(topology, find_intersections(topology, space, SETTINGS), space, ORIGIN, SETTINGS)
    assert set(graph.node_kind) <= set(NODE_KINDS)
    for ends, axis, profile in zip(graph.edge_nodes, graph.edge_axes, graph.edge_profiles, strict=True):
        assert_allclose(axis[[0, -1]], graph.node_p_map[ends])
        assert profile.shape == (len(axis), 2)
    return graph


def nodes_of(graph: RoadwayGraph, kind: str) -> Array:
    return np.asarray(graph.node_p_map[graph.node_kind == kind] - ORIGIN)


@pytest.mark.parametrize("width", [2.4, 4.0, 7.0])
def test_a_roadway_ends_in_the_middle_of_its_face(width: float) -> None:
    mine = straight(width).turned(0.7)
    graph = graph_of(mine.cloud())
    ends = nodes_of(graph, "dead_end")[:, :2] @ mine.R
    assert_allclose(ends[np.argsort(ends[:, 0])], [[-20.0, 0.0], [20.0, 0.0]], atol=0.6)
    assert_allclose(graph.edge_length, 40.0, atol=0.8)
    assert_allclose(graph.edge_width, width, atol=0.2)
    assert_array_equal(graph.node_intersection, [-1, -1])


@pytest.mark.parametrize(("turn_deg", "kind"), [(20.0, None), (48.0, "bend"), (90.0, "intersection")])
def test_a_turn_is_nothing_a_bend_or_an_intersection(turn_deg: float, kind: str | None) -> None:
    graph = graph_of(corner(turn_deg=turn_deg).cloud())
    others = graph.node_kind[graph.node_kind != "dead_end"].tolist()
    assert others == ([kind] if kind else [])
    assert len(graph.edge_nodes) == (2 if kind else 1)
    if kind:
        assert np.linalg.norm(nodes_of(graph, kind)[0]) < 1.5


def test_a_hall_is_no_intersection_but_a_node() -> None:
    hall = SyntheticMine(((-40.0, 0.0, -9.0, 0.0, 4.0), (-10.0, 0.0, 10.0, 0.0, 20.0), (0.0, 9.0, 0.0, 40.0, 4.0)))
    graph = graph_of(hall.cloud())
    assert len(nodes_of(graph, "intersection")) == 0
    assert 1 <= len(nodes_of(graph, "hall")) <= 2
    assert np.abs(nodes_of(graph, "hall")).max() < 6.0


def test_an_end_without_a_face_is_open() -> None:
    cloud = straight().cloud()
    graph = graph_of(cloud[cloud[:, 0] < 12.0])
    assert_allclose(nodes_of(graph, "open_end"), [[12.0, 0.0, 0.0]], atol=0.6)
    assert_allclose(nodes_of(graph, "dead_end"), [[-20.0, 0.0, 0.0]], atol=0.6)


@pytest.mark.parametrize("slope", [-0.2, 0.1])
def test_slope_length_and_height_follow_the_floor(slope: float) -> None:
    mine = replace(straight(), slope=(slope, 0.0), roof=2.6, yaw=2.2)
    graph = graph_of(mine.cloud())
    downhill = graph.node_p_map[graph.edge_nodes[0, 1], 2] < graph.node_p_map[graph.edge_nodes[0, 0], 2]
    assert_allclose(graph.edge_slope, -abs(slope) if downhill else abs(slope), atol=0.01)
    assert_allclose(graph.edge_length, 40.0 * np.sqrt(1.0 + slope**2), atol=0.8)
    assert_allclose(graph.edge_height, 2.6, atol=0.1)
    (axis,) = graph.edge_axes
    plan = mine.to_map((axis - ORIGIN)[:, :2] @ mine.R)
    assert_allclose((axis - ORIGIN)[:, 2], plan[:, 2], atol=0.06)


def test_profiles_tell_where_a_roadway_is_wide_and_high() -> None:
    wide_half = SyntheticMine(((-30.0, 0.0, 0.5, 0.0, 3.0), (0.0, 0.0, 30.0, 0.0, 5.0)))
    (axis,), (profile,) = (graph := graph_of(wide_half.cloud())).edge_axes, graph.edge_profiles
    x = (axis - ORIGIN)[:, 0]
    assert_allclose(np.median(profile[(x > -25.0) & (x < -5.0), 0]), 3.0, atol=0.2)
    assert_allclose(np.median(profile[(x > 5.0) & (x < 25.0), 0]), 5.0, atol=0.2)
    assert_allclose(profile[2:-2, 1], 3.0, atol=0.1)


def test_without_a_roof_the_height_is_not_known() -> None:
    graph = graph_of(t_junction().cloud(roofed=False))
    assert_array_equal(graph.edge_height, 0.0)
    assert all((profile[:, 1] == 0.0).all() for profile in graph.edge_profiles)


def test_a_side_roadway_does_not_widen_the_one_it_leaves() -> None:
    graph = graph_of(t_junction().cloud())
    assert graph.node_kind.tolist().count("intersection") == 1
    for profile in graph.edge_profiles:
        assert profile[:, 0].max() < 6.5
    assert_allclose(graph.edge_width, 4.0, atol=0.25)


def test_a_speck_of_floor_is_no_roadway() -> None:
    speck = SyntheticMine(((60.0, 0.0, 64.0, 0.0, 3.0),)).cloud()
    assert len(graph_of(np.vstack([straight().cloud(), speck])).edge_nodes) == 1


def test_a_ring_is_a_loop_at_one_node() -> None:
    ring = [(0, 0, 24, 0), (24, 0, 24, 24), (24, 24, 0, 24), (0, 24, 0, 0)]
    legs = [(x0 - 1.5 * np.sign(x1 - x0), y0 - 1.5 * np.sign(y1 - y0), x1, y1, 3.0) for x0, y0, x1, y1 in ring]
    graph = graph_of(SyntheticMine(tuple(legs)).cloud())
    assert_allclose(graph.edge_length.sum(), 96.0, atol=4.0)
    assert np.all(np.bincount(graph.edge_nodes.ravel()) == 2)
    assert (graph.node_kind == "intersection").sum() >= 3
