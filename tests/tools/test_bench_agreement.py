"""Pairing of found intersections with labels: one to one, by height where it is known, corners aside."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from semmap.errors import InputFileError
from semmap.intersections import Intersection, RoadwayGraph, SemanticMap, WallContour
from tools.bench.agreement import Label, agreement, read_labels
from tools.bench.disagreements import draw_disagreements


def found(id: int, p: tuple[float, float, float], branches: int = 3) -> Intersection:
    nothing = np.zeros(4, np.float32), np.zeros(4, bool), np.zeros((1, 4), np.float32), np.zeros((1, 4), bool)
    bearings = np.linspace(0.0, 6.0, branches, endpoint=False)
    kind = {2: "L", 3: "Y", 4: "X"}[branches]
    contour, cloud = WallContour(*nothing), np.zeros((0, 3), np.float32)
    return Intersection(
        id=id,
        p_map=np.array(p),
        kind=kind,
        branch_bearings=bearings,
        branch_widths=np.full(branches, 4.0),
        quality=1.0,
        contour=contour,
        cloud=cloud,
    )


def label(id: int, p: tuple[float, float, float], branches: int = 3) -> Label:
    return Label(str(id), np.array(p), np.linspace(0.0, 6.0, branches, endpoint=False))


def test_pairs_are_one_to_one_and_near() -> None:
    labels = [label(0, (0, 0, 0)), label(1, (3, 0, 0)), label(2, (50, 0, 0), 4)]
    agreed = agreement(labels, [found(7, (1.6, 0, 0)), found(8, (-1, 0, 0)), found(9, (50, 4.5, 0))])
    assert {(one.id, other.id) for one, other, _ in agreed.meetings} == {("0", 8), ("1", 7)}
    assert [one.id for one in agreed.missed] == ["2"]
    assert [one.id for one in agreed.extra] == [9]
    assert_allclose(sorted(agreed.distance), [1.0, 1.4])


def test_levels_are_told_apart_where_the_labels_have_heights() -> None:
    upper, lower = found(1, (0, 0, 12)), found(2, (0.5, 0, 0))
    agreed = agreement([label(0, (0, 0, 0)), label(1, (0, 0, 12))], [upper, lower])
    assert {(one.id, other.id) for one, other, _ in agreed.meetings} == {("0", 2), ("1", 1)}
    assert agreement([label(0, (0, 0, 5.0))], [upper]).missed
    assert not agreement([label(0, (0, 0, np.nan))], [upper]).missed


def test_corners_count_neither_as_missed_nor_as_extra() -> None:
    labels = [label(0, (0, 0, 0), 2), label(1, (30, 0, 0), 4), label(2, (60, 0, 0))]
    agreed = agreement(labels, [found(0, (90, 0, 0), 2), found(1, (30, 1, 0), 3), found(2, (60, 2, 0))])
    figures = agreed.figures()
    assert (figures.labels, figures.found, figures.met, figures.right, figures.equal) == (2, 2, 2, 2, 1)
    assert [(one.id, other.id) for one, other in agreed.unequal] == [("1", 1)]
    both = figures + figures
    assert (both.labels, both.equal, len(both.distance)) == (4, 2, 4)
    assert "100.0%" in str(both) and " 50.0%" in str(both) and "1.50" in str(both)


def test_nothing_found_is_no_agreement() -> None:
    figures = agreement([label(0, (0, 0, 0))], []).figures()
    assert (figures.labels, figures.met) == (1, 0)
    assert "nan" in str(figures)


def test_labels_are_read_with_and_without_heights(tmp_path: Path) -> None:
    path = tmp_path / "junctions.csv"
    path.write_text('id,x_m,y_m,branches,bearings_deg,z_m\n3,1.5,2.5,2,"0;90",-7.25\n')
    (one,) = read_labels(path)
    assert one.id == "3"
    assert_allclose(one.p_map, [1.5, 2.5, -7.25])
    assert_allclose(one.bearings, [0.0, np.pi / 2])
    path.write_text('id,x_m,y_m,branches,bearings_deg\n3,1.5,2.5,2,"0;90"\n')
    assert np.isnan(read_labels(path)[0].p_map[2])
    path.write_text('id,x_m,y_m,branches,bearings_deg\n3,1.5,2.5,3,"0;90"\n')
    with pytest.raises(InputFileError, match="not as many bearings"):
        read_labels(path)
    with pytest.raises(InputFileError, match="holds no junctions"):
        read_labels(tmp_path / "gone.csv")


def test_each_disagreement_is_drawn(tmp_path: Path) -> None:
    axis = np.column_stack([np.arange(40.0), np.zeros(40), np.ones(40)])
    roads = RoadwayGraph(
        node_p_map=axis[[0, -1]],
        node_intersection=np.array([-1, -1]),
        node_kind=np.array(["dead_end", "dead_end"]),
        edge_nodes=np.array([[0, 1]]),
        edge_length=np.array([39.0]),
        edge_width=np.array([10.0]),
        edge_height=np.array([3.0]),
        edge_slope=np.zeros(1),
        edge_axes=(axis,),
        edge_profiles=(np.tile([10.0, 3.0], (40, 1)),),
    )
    extra, poor = found(5, (10, 0, 1)), found(6, (30, 0, 1), 4)
    there = SemanticMap((extra, poor), roads, np.zeros(3), {})
    agreed = agreement([label(0, (30, 1, np.nan)), label(1, (90, 0, np.nan))], there.intersections)
    cloud = np.random.default_rng(0).uniform([0.0, -5.0, 0.0], [40.0, 5.0, 3.0], (5000, 3))
    drawn = draw_disagreements(agreed, there, cloud, tmp_path / "figures")
    assert [path.name for path in drawn] == ["missed_1.png", "extra_5.png", "branches_0.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in drawn)
