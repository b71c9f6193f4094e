"""The roadways of two surveys as one graph: by where they run, whichever survey comes first and however it is cut."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from numpy.testing import assert_allclose
from planned_survey import survey

from maps.merge import MergeResult, merge_maps
from semmap.intersections import RoadwayGraph, SemanticMap

# a T at x; the roadway east runs to y, a T as well
PLAN = {
    "w": (-30, 0), "x": (0, 0), "s": (0, -30), "d": (25, 0), "e": (40, 0), "n": (40, 0), "m": (40, 30), "y": (80, 0),
    "ys": (80, -30), "ye": (110, 0), "y2": (80, 30),
}  # fmt: skip
T_AT_X = ("w x", "x s")
T_AT_Y = ("y ys", "y ye")


def degrees(graph: RoadwayGraph) -> Counter:
    """How many nodes there are of each kind with so many roadways."""
    count = np.bincount(graph.edge_nodes.ravel(), minlength=len(graph.node_p_map))
    return Counter(zip(graph.node_kind.tolist(), count.tolist(), strict=True))


def length(semantic_map: SemanticMap) -> float:
    return float(semantic_map.roadways.edge_length.sum())


def assert_sound(result: MergeResult) -> None:
    """Ends of axes lie on their nodes, figures follow from axes, nodes of intersections lie where those are."""
    graph = result.map.roadways
    for ends, axis, profile, total in zip(
        graph.edge_nodes, graph.edge_axes, graph.edge_profiles, graph.edge_length, strict=True
    ):
        assert_allclose(axis[[0, -1]], graph.node_p_map[ends])
        assert len(profile) == len(axis) and np.linalg.norm(np.diff(axis, axis=0), axis=1).min() > 0.0
        assert_allclose(total, np.linalg.norm(np.diff(axis, axis=0), axis=1).sum())
    place = dict(zip(result.map.columns.id.tolist(), result.map.p_map, strict=True))
    for id, p in zip(graph.node_intersection.tolist(), graph.node_p_map, strict=True):
        if id >= 0:
            assert_allclose(p, place[id])
    assert sorted(graph.node_intersection[graph.node_intersection >= 0]) == sorted(place)


def merged(a: tuple[str, ...], b: tuple[str, ...], **options: str) -> MergeResult:
    result = merge_maps(survey(PLAN, a, **options), survey(PLAN, b, **options))
    assert_sound(result)
    return result


def test_a_dead_end_that_goes_on_becomes_a_through_road() -> None:
    result = merged((*T_AT_X, "x d"), (*T_AT_X, *T_AT_Y, "x y"))
    assert degrees(result.map.roadways) == {("intersection", 3): 2, ("dead_end", 1): 4}
    assert_allclose(length(result.map), 5 * 30 - 30 + 80)
    assert_allclose(result.added_roadways, 55 + 60)
    assert result.added == ((1, 1),)
    assert result.conflicts == ()


def test_a_dead_end_that_was_driven_on_ends_farther_out() -> None:
    result = merged((*T_AT_X, "x d"), (*T_AT_X, "x e"))
    assert degrees(result.map.roadways) == {("intersection", 3): 1, ("dead_end", 1): 3}
    assert_allclose(length(result.map), 100)
    assert_allclose(result.added_roadways, 15)


def test_a_survey_that_saw_less_adds_nothing() -> None:
    result = merged((*T_AT_X, "x e"), (*T_AT_X, "x d"))
    assert degrees(result.map.roadways) == {("intersection", 3): 1, ("dead_end", 1): 3}
    assert_allclose(length(result.map), 100)
    assert result.added_roadways == 0.0 and result.conflicts == ()


def test_an_open_end_is_no_longer_open_where_the_other_survey_saw_it() -> None:
    a, b = survey(PLAN, (*T_AT_X, "x e"), open_ends="e"), survey(PLAN, (*T_AT_X, "x e"))
    for result in (merge_maps(a, b), merge_maps(b, a)):
        assert degrees(result.map.roadways) == {("intersection", 3): 1, ("dead_end", 1): 3}


def test_a_new_branch_cuts_the_roadway_it_leaves() -> None:
    result = merged((*T_AT_X, *T_AT_Y, "x y"), (*T_AT_X, *T_AT_Y, "x n", "n y", "n m"))
    assert degrees(result.map.roadways) == {("intersection", 3): 3, ("dead_end", 1): 5}
    assert_allclose(length(result.map), 4 * 30 + 80 + 30)
    assert_allclose(result.added_roadways, 30)
    assert result.added == ((0, 2),)
    assert result.conflicts == ()


def test_a_branch_that_only_the_older_survey_shows_stays_and_is_reported() -> None:
    result = merged((*T_AT_X, *T_AT_Y, "x n", "n y", "n m"), (*T_AT_X, *T_AT_Y, "x y"))
    assert degrees(result.map.roadways) == {("intersection", 3): 3, ("dead_end", 1): 5}
    assert result.added == () and result.added_roadways == 0.0
    (conflict,) = result.conflicts
    assert conflict.id == 0 and "a roadway of B passes" in conflict.what


def test_an_intersection_where_a_roadway_ended_takes_the_place_of_the_end() -> None:
    plan = {**PLAN, "d": (38.0, 0.5)}
    a, b = survey(plan, (*T_AT_X, "x d")), survey(plan, (*T_AT_X, "x n", "n m", "n y"))
    result = merge_maps(a, b)
    assert_sound(result)
    assert degrees(result.map.roadways) == {("intersection", 3): 2, ("dead_end", 1): 4}
    assert_allclose(length(result.map), 60 + 40 + 30 + 40, atol=0.1)


def test_what_is_left_of_a_dead_end_beyond_a_new_intersection_is_no_branch() -> None:
    plan = {**PLAN, "d": (46.0, 0.3)}
    a, b = survey(plan, (*T_AT_X, "x d")), survey(plan, (*T_AT_X, "x n", "n m", "n y"))
    result = merge_maps(a, b)
    assert_sound(result)
    assert degrees(result.map.roadways) == {("intersection", 3): 2, ("dead_end", 1): 4}
    assert_allclose(length(result.map), 60 + 40 + 30 + 40, atol=0.1)


def test_a_bend_that_the_other_survey_shows_as_a_corner() -> None:
    roads = (*T_AT_X, "x n", "n m")
    bend, corner = survey(PLAN, roads, bends="n"), survey(PLAN, roads)
    result = merge_maps(bend, corner)
    assert_sound(result)
    assert degrees(result.map.roadways) == {("intersection", 3): 1, ("intersection", 2): 1, ("dead_end", 1): 3}
    assert result.added_roadways == 0.0
    back = merge_maps(corner, bend)
    assert_sound(back)
    assert degrees(back.map.roadways) == degrees(result.map.roadways)
    assert ["passes" in conflict.what for conflict in back.conflicts] == [True]


def test_a_loop_that_closes_between_known_intersections_is_new() -> None:
    loop = ("x n", "n y", "n m", "m y2", "y2 y")
    result = merged((*T_AT_X, *T_AT_Y, "x n", "n y", "n m"), (*T_AT_X, *T_AT_Y, *loop))
    assert degrees(result.map.roadways)["intersection", 4] == 1
    assert_allclose(length(result.map), 4 * 30 + 80 + 30 + 40 + 30)


def test_roadways_on_other_levels_do_not_meet() -> None:
    plan = {
        **PLAN,
        "up": (40.0, -40.0, 5.0),
        "over": (40.0, 40.0, 5.0),
        "u2": (60.0, -40.0, 5.0),
        "u3": (40.0, -70.0, 5.0),
    }
    a = survey(plan, (*T_AT_X, *T_AT_Y, "x y"))
    b = survey(plan, ("up over", "up u2", "up u3"))
    result = merge_maps(a, b)
    assert_sound(result)
    assert_allclose(length(result.map), length(a) + length(b))
    assert result.conflicts == ()
    flat = {name: (*values[:2], 0.0) for name, values in plan.items()}
    result = merge_maps(a, survey(flat, ("up over", "up u2", "up u3")))
    assert_sound(result)
    (meeting,) = result.conflicts
    assert_allclose(meeting.p_map, [40.0, 0.0, 0.0], atol=0.6)
    assert "meet and neither shows" in meeting.what
    assert degrees(result.map.roadways)["bend", 4] == 1


def test_parallel_roadways_are_two() -> None:
    plan = {**PLAN, "p": (0.0, 7.0), "q": (80.0, 7.0), "p1": (-30.0, 7.0), "q1": (0.0, 37.0)}
    a, b = survey(plan, (*T_AT_X, *T_AT_Y, "x y")), survey(plan, ("p q", "p p1", "p q1"))
    result = merge_maps(a, b)
    assert_allclose(length(result.map), length(a) + length(b))
    assert degrees(result.map.roadways) == degrees(a.roadways) + degrees(b.roadways)


def test_headings_face_to_face_are_not_joined() -> None:
    plan = {**PLAN, "d": (38.0, 0.0), "e": (39.0, 0.0), "f": (41.5, 0.0)}
    a, b = survey(plan, (*T_AT_X, "x d")), survey(plan, (*T_AT_X, *T_AT_Y, "x e", "y f"))
    result = merge_maps(a, b)
    assert_sound(result)
    assert degrees(result.map.roadways) == {("intersection", 3): 2, ("dead_end", 1): 6}


def test_a_roadway_that_parts_where_no_intersection_was_seen_is_reported() -> None:
    plan = {**PLAN, "k": (40.0, 0.0), "far": (70.0, 30.0)}
    a, b = survey(plan, (*T_AT_X, *T_AT_Y, "x y")), survey(plan, (*T_AT_X, "x k far"))
    result = merge_maps(a, b)
    assert_sound(result)
    assert degrees(result.map.roadways) == {("intersection", 3): 2, ("bend", 3): 1, ("dead_end", 1): 5}
    (conflict,) = result.conflicts
    assert "meet and neither shows" in conflict.what
    assert np.linalg.norm(conflict.p_map[:2] - [40.0, 0.0]) < 4.0
    assert_allclose(length(result.map), length(a) + 42.4, atol=4.0)


@pytest.mark.parametrize("seed", range(12))
def test_parts_of_any_mine_make_up_the_mine(seed: int) -> None:
    """Two surveys of parts of a mine: every roadway once, whichever is merged into which, and nothing new again."""
    nodes, roads = random_mine(seed)
    rng = np.random.default_rng([seed, 1])
    parts = [[road for road in roads if rng.random() < 0.7] for _ in range(2)]
    a, b = (survey(nodes, part) for part in parts)
    whole = 30.0 * len(set(parts[0]) | set(parts[1]))
    ab, ba = merge_maps(a, b), merge_maps(b, a)
    for result in (ab, ba):
        assert_sound(result)
        assert_allclose(length(result.map), whole)
    assert_allclose(ab.added_roadways, whole - length(a), atol=1e-6)
    assert degrees(ab.map.roadways) == degrees(ba.map.roadways)
    for part in (a, b):
        again = merge_maps(ab.map, part)
        assert again.added == () and again.added_roadways == 0.0
        assert_allclose(length(again.map), whole)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("align", [False, True])
def test_surveys_that_lie_apart_and_are_not_quite_the_same(seed: int, align: bool) -> None:
    nodes, roads = random_mine(seed)
    rng = np.random.default_rng([seed, 1])
    parts = [[road for road in roads if rng.random() < 0.8] for _ in range(2)]
    a = survey(nodes, parts[0])
    b = survey(nodes, parts[1], shift=(0.9, -0.6, 0.4), wobble=0.5)
    result = merge_maps(a, b, align=align)
    assert_sound(result)
    assert_allclose(length(result.map), 30.0 * len(set(parts[0]) | set(parts[1])), rtol=0.02)
    assert degrees(result.map.roadways) == degrees(merge_maps(a, survey(nodes, parts[1])).map.roadways)


def random_mine(seed: int) -> tuple[dict[str, tuple[float, float, float]], list[str]]:
    """Some roadways, each of 30 m, of a grid that climbs; no straight through a node that is not a node."""
    rng = np.random.default_rng([seed, 0])
    turn, climb = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-0.1, 0.1)
    c, s, run = np.cos(turn), np.sin(turn), 30.0 * np.sqrt(1.0 - climb**2)
    nodes = {
        f"{i}.{j}": (run * (c * i - s * j), run * (s * i + c * j), 30.0 * climb * (i + j))
        for i in range(5)
        for j in range(4)
    }
    across = [f"{i}.{j} {i + 1}.{j}" for i in range(4) for j in range(4)]
    along = [f"{i}.{j} {i}.{j + 1}" for i in range(5) for j in range(3)]
    return nodes, [road for road in [*across, *along] if rng.random() < 0.8]
