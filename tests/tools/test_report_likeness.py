"""Which intersections look alike, and how soon their order tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from small_files import small_map

from descriptors.similarity import similarity
from localize.settings import LocalizeSettings
from maps.settings import MapSettings
from semmap.geometry import yaw_rotation
from semmap.intersections import Intersection, RoadwayGraph, SemanticMap, WallContour
from tools.report.journeys import NEVER, passed_until_told, ways_of
from tools.report.likeness import likeness_of, told_by

SECTORS, LAYERS = MapSettings().contour.sectors, MapSettings().contour.layers
TURN = 30
"""Sectors by which the second of two twins is turned: a quarter of a full turn."""


def twin_of(one: Intersection, id: int, p_map: np.ndarray) -> Intersection:
    """The same rock, turned by a quarter."""
    c = one.contour
    turned = WallContour(
        *(np.roll(values, TURN, axis=-1) for values in (c.pwcv, c.pwcv_observed, c.cwc, c.cwc_observed))
    )
    cloud = (one.cloud @ yaw_rotation(0.5 * np.pi).T).astype(np.float32)
    bearings = np.sort((one.branch_bearings + 0.5 * np.pi) % (2.0 * np.pi))
    return replace(one, id=id, p_map=p_map, contour=turned, cloud=cloud, branch_bearings=bearings)


def chain(*lengths: float, turned: bool = False) -> RoadwayGraph:
    """Intersections 0, 1, 2, ... in a row along x, so many metres apart; a dead end at both sides."""
    x = np.concatenate([[-20.0], np.cumsum([0.0, *lengths])])
    p = np.column_stack([np.append(x, x[-1] + 20.0), np.zeros((len(x) + 1, 2))])
    edges = np.column_stack([np.arange(len(p) - 1), np.arange(1, len(p))])
    axes = tuple(np.linspace(p[a], p[b], 9) for a, b in edges)
    n = len(edges)
    return RoadwayGraph(
        node_p_map=p,
        node_intersection=np.array([-1, *range(len(p) - 2), -1]),
        node_kind=np.array(["dead_end", *["intersection"] * (len(p) - 2), "dead_end"]),
        edge_nodes=edges,
        edge_length=np.linalg.norm(p[edges[:, 1]] - p[edges[:, 0]], axis=1),
        edge_width=np.full(n, 4.0),
        edge_height=np.full(n, 3.0),
        edge_slope=np.zeros(n),
        edge_axes=axes,
        edge_profiles=tuple(np.full((9, 2), 4.0) for _ in axes),
    )


def mine(graph: RoadwayGraph, places: list[Intersection]) -> SemanticMap:
    return SemanticMap(tuple(places), graph, np.zeros(3), MapSettings().model_dump(mode="json"))


def twins() -> SemanticMap:
    """0 and 2 are twins, 1 is another."""
    first, second = small_map().intersections
    rng = np.random.default_rng(4)
    walls = np.column_stack([rng.uniform(-6, 6, (4000, 2)), rng.uniform(0, 3, 4000)]).astype(np.float32)
    walls[:, rng.integers(0, 2)] = np.sign(walls[:, 0]) * 3.0
    places = [replace(first, id=0, p_map=np.zeros(3), cloud=walls), replace(second, id=1, p_map=np.array([40.0, 0, 0]))]
    places.append(twin_of(places[0], 2, np.array([100.0, 0.0, 0.0])))
    return mine(chain(40.0, 60.0), places)


def test_twins_are_found_with_their_turn_and_their_rock() -> None:
    found = likeness_of(twins(), LocalizeSettings())
    (pair,) = found.pairs
    assert (pair.a, pair.b) == (0, 2)
    assert pair.pwcv == pytest.approx(1.0, abs=1e-3) and pair.cwc == pytest.approx(1.0, abs=1e-3)
    assert pair.yaw == pytest.approx(2.0 * np.pi * TURN / SECTORS, abs=0.02)
    assert pair.rock > 0.9
    assert not found.capped


def test_matrices_hold_the_similarities_of_all() -> None:
    semantic_map = twins()
    found = likeness_of(semantic_map, LocalizeSettings())
    contours = [one.contour for one in semantic_map.intersections]
    for by in ("pwcv", "cwc"):
        expected = [[similarity(a, b, by=by).score for b in contours] for a in contours]
        assert_allclose(getattr(found, by), expected, atol=1e-5)


def test_levels_leave_less_and_less_and_propose_one_anchor_for_one_pair() -> None:
    levels = likeness_of(twins(), LocalizeSettings()).levels
    counts = [len(level.pairs) for level in levels]
    assert counts == sorted(counts, reverse=True) and counts[0] == 1
    assert levels[0].anchors.intersections in ((0,), (2,)) and levels[0].anchors.exact


def test_a_map_without_look_alikes_needs_no_anchor() -> None:
    found = likeness_of(small_map(), LocalizeSettings())
    assert found.pairs == () and all(level.anchors.intersections == () for level in found.levels)


def test_ways_pass_over_bends() -> None:
    graph = chain(40.0, 60.0)
    bent = replace(
        graph,
        node_intersection=np.array([-1, 0, -1, 1, -1]),
        node_kind=np.array(["dead_end", "intersection", "bend", "intersection", "dead_end"]),
    )
    first, second = small_map().intersections
    ways = ways_of(mine(bent, [replace(first, id=0), replace(second, id=1)]))
    assert sorted((way.target, round(way.length)) for way in ways[0]) == [(-1, 20), (1, 100)]
    assert sorted((way.target, round(way.length)) for way in ways[1]) == [(-1, 20), (0, 100)]
    assert {round(np.degrees(way.bearing)) % 360 for way in ways[0]} == {0, 180}


@pytest.mark.parametrize(
    ("lengths", "alike", "passed"),
    [
        ((40.0, 40.0, 60.0, 40.0), {(0, 1)}, 1),  # after 0 comes 1, after 1 comes 2, which looks otherwise
        ((40.0, 60.0), {(0, 1)}, 1),  # how far the next one is tells
        ((40.0,) * 4, {(0, 1), (1, 2)}, 2),  # 0, 1, 2 look alike, 3 does not
        ((40.0,) * 3, {(0, 1), (1, 2), (2, 3)}, 3),
    ],
)
def test_how_many_intersections_are_passed_until_two_are_told_apart(
    lengths: tuple[float, ...], alike: set[tuple[int, int]], passed: int
) -> None:
    first, _ = small_map().intersections
    places = [replace(first, id=k) for k in range(len(lengths) + 1)]
    told = passed_until_told(ways_of(mine(chain(*lengths), places)), dict.fromkeys(alike, 0.0))
    assert told[(0, 1)] == passed


def test_two_that_lead_nowhere_are_never_told_apart_by_order() -> None:
    first, _ = small_map().intersections
    alone = chain()
    p = np.concatenate([alone.node_p_map, alone.node_p_map + [0.0, 100.0, 0.0]])
    graph = replace(
        alone,
        node_p_map=p,
        node_intersection=np.array([-1, 0, -1, -1, 1, -1]),
        node_kind=np.concatenate([alone.node_kind, alone.node_kind]),
        edge_nodes=np.concatenate([alone.edge_nodes, alone.edge_nodes + 3]),
        edge_axes=alone.edge_axes + tuple(axis + [0.0, 100.0, 0.0] for axis in alone.edge_axes),
        edge_profiles=alone.edge_profiles * 2,
        **{
            name: np.tile(getattr(alone, name), 2)
            for name in ("edge_length", "edge_width", "edge_height", "edge_slope")
        },
    )
    ways = ways_of(mine(graph, [replace(first, id=0), replace(first, id=1)]))
    assert passed_until_told(ways, {(0, 1): 0.0}) == {(0, 1): NEVER}


def test_what_tells_a_pair_apart_is_said_in_words() -> None:
    (pair,) = likeness_of(twins(), LocalizeSettings()).pairs
    settings = LocalizeSettings()
    assert told_by(replace(pair, cwc=0.9, rock=0.9, passed=NEVER), settings) == "nothing here: an anchor would"
    assert told_by(replace(pair, cwc=0.1, rock=0.1, passed=2), settings) == "CWC, the next 2 intersections, the rock"
    assert told_by(replace(pair, cwc=0.9, rock=np.nan, passed=1), settings) == "the next intersection"
