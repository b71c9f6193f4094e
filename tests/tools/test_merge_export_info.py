"""Databases as a user keeps them up and hands them on: `semmap merge`, `semmap export`, `semmap info`."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from small_files import small_map

from semmap import database
from semmap.intersections import IntersectionTable, RoadwayGraph, SemanticMap
from tools import cli
from tools.bench.database import made_up_map


def saved(semantic_map: SemanticMap, path: Path) -> Path:
    database.save(semantic_map, path)
    return path


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    return saved(made_up_map(3, 5), tmp_path / "mine.h5")


def shifted(semantic_map: SemanticMap, shift: tuple[float, float, float]) -> SemanticMap:
    roads, rows = semantic_map.roadways, IntersectionTable.of(semantic_map.intersections)
    columns = replace(rows.columns, p_map=rows.columns.p_map + shift)
    moved = replace(roads, node_p_map=roads.node_p_map + shift, edge_axes=[axis + shift for axis in roads.edge_axes])
    return replace(semantic_map, intersections=rows.with_columns(columns), roadways=moved)


class TestMerge:
    def test_with_itself_nothing_changes(self, mine, tmp_path, capsys) -> None:
        out = tmp_path / "c.h5"
        assert cli.run(["merge", str(mine), str(mine), "--out", str(out)]) == 0
        printed = capsys.readouterr().out
        assert "B lies on A" in printed
        assert f"9 intersections: 9 in both, 0 new, 0 m of new roadways, 0 conflicts: {out}" in printed
        assert out.read_bytes() == mine.read_bytes()
        record = json.loads((tmp_path / "c.merge.json").read_text())
        assert [pair["id"] for pair in record["pairs"]] == [pair["id_b"] for pair in record["pairs"]] == list(range(9))
        assert record["added"] == record["conflicts"] == []

    def test_over_the_first_file(self, mine, tmp_path) -> None:
        before = mine.read_bytes()
        assert cli.run(["merge", str(mine), str(mine), "--out", str(mine)]) == 0
        assert mine.read_bytes() == before

    def test_a_larger_newer_survey_that_lies_aside(self, mine, tmp_path, capsys) -> None:
        newer = saved(shifted(made_up_map(3, 5), (0.42, 0.0, 0.0)), tmp_path / "newer.h5")
        plain, moved = tmp_path / "plain.h5", tmp_path / "moved.h5"
        assert cli.run(["merge", str(mine), str(newer), "--out", str(plain)]) == 0
        assert "B is shifted by 0.42 m east (± 0.05 m, 9 intersections); it was left there" in capsys.readouterr().out
        conflicts = tmp_path / "record.json"
        line = ["merge", str(mine), str(newer), "--out", str(moved), "--align", "--conflicts", str(conflicts)]
        assert cli.run(line) == 0
        assert "B was moved by 0.42 m west onto A" in capsys.readouterr().out
        assert_allclose(json.loads(conflicts.read_text())["shift_b_to_a_m"], [-0.42, 0.0, 0.0])
        assert not (tmp_path / "moved.merge.json").exists()

    def test_conflicts_are_listed(self, mine, tmp_path, capsys, monkeypatch) -> None:
        monkeypatch.setenv("COLUMNS", "160")
        other = made_up_map(3, 5)
        rows = [replace(one, kind="Y") if one.id in (2, 5) else one for one in other.intersections]
        newer = saved(replace(other, intersections=tuple(rows)), tmp_path / "newer.h5")
        assert cli.run(["merge", str(mine), str(newer), "--out", str(tmp_path / "c.h5")]) == 0
        printed = capsys.readouterr().out
        assert printed.count("X in A, Y in B") == 2 and "B's: newer" in printed and "2 conflicts" in printed
        record = json.loads((tmp_path / "c.merge.json").read_text())
        assert [(one["id"], one["id_b"]) for one in record["conflicts"]] == [(2, 2), (5, 5)]
        assert database.load(tmp_path / "c.h5").by_id(5).kind == "Y"

    def test_with_an_empty_map(self, mine, tmp_path, capsys) -> None:
        graph = RoadwayGraph(
            np.empty((0, 3)), np.empty(0, np.int64), np.empty(0, np.str_), np.empty((0, 2), np.int64),
            *(np.empty(0) for _ in range(4)), (), (),
        )  # fmt: skip
        empty = saved(replace(made_up_map(3, 5), intersections=(), roadways=graph), tmp_path / "empty.h5")
        for a, b, added in ((mine, empty, 0), (empty, mine, 9)):
            out = tmp_path / f"{added}.h5"
            assert cli.run(["merge", str(a), str(b), "--out", str(out)]) == 0
            assert f"9 intersections: 0 in both, {added} new" in capsys.readouterr().out
            merged, whole = database.load(out), database.load(mine)
            assert_array_equal(merged.p_map, whole.p_map)
            assert_array_equal(merged.contours.cwc, whole.contours.cwc)
            assert_allclose(merged.roadways.edge_length, whole.roadways.edge_length)
            assert_array_equal(merged.roadways.edge_nodes, whole.roadways.edge_nodes)


class TestExport:
    @pytest.fixture
    def small(self, tmp_path) -> Path:
        return saved(replace(small_map(), crs="EPSG:25832"), tmp_path / "small.h5")

    def test_geojson_holds_points_and_lines_in_map_coordinates(self, small, tmp_path, capsys) -> None:
        out = tmp_path / "mine.geojson"
        assert cli.run(["export", str(small), "--geojson", str(out)]) == 0
        assert capsys.readouterr().out == f"2 intersections, 2 roadways: {out}\n"
        collection = json.loads(out.read_text())
        assert collection["type"] == "FeatureCollection"
        assert collection["crs"] == {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
        of = {name: [f for f in collection["features"] if f["properties"]["feature"] == name] for name in NAMES}
        assert [len(of[name]) for name in NAMES] == [2, 1, 2]
        first = of["intersection"][0]
        assert first["geometry"] == {"type": "Point", "coordinates": [600000.0, 5400000.0, 200.0]}
        assert first["properties"] == {"feature": "intersection", "id": 3, "kind": "T", "quality": 0.9, "branches": 3}
        assert of["node"][0]["properties"]["kind"] == "dead_end"
        road = of["roadway"][0]
        assert road["geometry"]["type"] == "LineString"
        assert road["geometry"]["coordinates"] == [[600000.0, 5400000.0, 200.0], [600030.0, 5400005.0, 200.0]]
        assert road["properties"] == {
            "feature": "roadway", "roadway": 0, "from": 3, "to": 8,
            "length_m": round(math.hypot(30, 5), 3), "width_m": 4.0, "height_m": 3.0, "slope": 0.0,
        }  # fmt: skip
        assert "height_m" not in of["roadway"][1]["properties"] and of["roadway"][1]["properties"]["to"] is None

    def test_graphml_reads_back_in_networkx(self, small, tmp_path) -> None:
        out = tmp_path / "mine.graphml"
        assert cli.run(["export", str(small), "--graphml", str(out)]) == 0
        graph = nx.read_graphml(out, node_type=int)
        assert graph.graph["crs"] == "EPSG:25832" and graph.graph["frame"] == "map"
        assert graph.nodes[0] == {
            "x": 600000.0, "y": 5400000.0, "z": 200.0, "kind": "intersection",
            "intersection": 3, "type": "T", "quality": 0.9, "branches": 3,
        }  # fmt: skip
        assert graph.nodes[2]["kind"] == "dead_end" and "intersection" not in graph.nodes[2]
        assert sorted(graph.edges) == [(0, 1), (1, 2)]
        assert graph.edges[0, 1]["length_m"] == round(math.hypot(30, 5), 3) and graph.edges[0, 1]["height_m"] == 3.0
        assert nx.shortest_path_length(graph, 0, 2, weight="length_m") == pytest.approx(math.hypot(30, 5) + 30.0, 1e-4)

    def test_roadways_between_the_same_nodes_stay_apart(self, small, tmp_path) -> None:
        good = small_map()
        loop = replace(good.roadways, edge_nodes=np.array([[0, 1], [1, 0]]))
        both = saved(replace(good, roadways=loop), tmp_path / "both.h5")
        out = tmp_path / "both.graphml"
        assert cli.run(["export", str(both), "--graphml", str(out)]) == 0
        assert nx.read_graphml(out).number_of_edges() == 2

    def test_both_at_once_and_the_same_bytes_again(self, mine, tmp_path, capsys) -> None:
        for name in "ab":
            files = [f"--geojson={tmp_path / name}.json", f"--graphml={tmp_path / name}.xml"]
            assert cli.run(["export", str(mine), *files]) == 0
            assert f"{name}.json, {tmp_path / name}.xml" in capsys.readouterr().out
        for end in ("json", "xml"):
            assert (tmp_path / f"a.{end}").read_bytes() == (tmp_path / f"b.{end}").read_bytes()
        assert "crs" not in json.loads((tmp_path / "a.json").read_text())


NAMES = ("intersection", "node", "roadway")


class TestInfo:
    def test_figures_and_every_intersection_of_a_small_map(self, tmp_path, capsys, monkeypatch) -> None:
        monkeypatch.setenv("COLUMNS", "120")
        assert cli.run(["info", str(saved(small_map(), tmp_path / "small.h5"))]) == 0
        lines = capsys.readouterr().out.splitlines()
        for line in (
            "intersections  2 (1 T, 1 X)",
            "quality        0.90 to 0.90, median 0.90",
            "points kept    400",
            "roadways       2, 60 m",
            "nodes          1 dead_end, 2 intersection",
            "heights        3.0 to 3.0 m, median 3.0",
            "slopes         0.0 to 0.0 %, median 0.0",
        ):
            assert line in lines
        assert any(line.split()[:3] == ["3", "T", "600000.00"] for line in lines)

    def test_of_many_a_summary(self, tmp_path, capsys) -> None:
        path = saved(made_up_map(30, 2), tmp_path / "many.h5")
        assert cli.run(["info", str(path)]) == 0
        short = capsys.readouterr().out
        assert "900 (900 X)" in short and "The 10 seen worst" in short
        assert len(short.splitlines()) < 80
        assert cli.run(["info", str(path), "--all"]) == 0
        assert len(capsys.readouterr().out.splitlines()) > 900
