"""The pages of `semmap report`: whole, self-contained, holding what the files say. See also test_report_browser."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from report_files import HOSTILE, write_run

from semmap import database
from semmap.errors import DatabaseError, InputFileError, SettingsError
from semmap.intersections import SemanticMap
from semmap.trajectory import Trajectory
from tools import cli
from tools.report import Wanted, write_report
from tools.report.events import cell, event_tables, state_bands
from tools.report.page import table
from tools.settings import ToolSettings


class _Page(HTMLParser):
    """Checks that every element that is opened is closed, in order, and collects the scripts."""

    VOID = frozenset({"meta", "br", "img", "link", "circle", "path", "line", "use", "rect", "image", "input"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.scripts: list[dict[str, str | None]] = []
        self.data = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "script":
            self.scripts.append(dict(attrs))
        assert tag != "img"
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script" and self.scripts[-1].get("id") == "data":
            self.data += data


def page_of(*sources: Path, out: Path) -> tuple[str, dict]:
    """The page about some sources, checked to be whole and to ask nobody for anything; and its data."""
    write_report(sources, Wanted(out), ToolSettings())
    text = out.read_text()
    page = _Page()
    page.feed(text)
    assert page.open == []
    running = [one for one in page.scripts if one.get("type") is None]
    assert len(running) == 1 and not any("src" in one for one in page.scripts)
    links = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert all(link.startswith(("#", "data:")) for link in links), links
    assert "default-src &#x27;none&#x27;" in text
    return text, json.loads(page.data)


def test_a_run_page_holds_the_figures_of_the_run(run: Path, tmp_path: Path) -> None:
    text, data = page_of(run, out=tmp_path / "run.html")
    for words in ("Plan", "Over time", "Errors", "roll [°]", "processing of a scan [ms]", "variance of the position"):
        assert words in text
    assert "<dd>0.250 m</dd>" in text  # RMSE without alignment
    assert "seed: 0" in text
    assert [event["accepted"] for event in data["events"]] == [True, False]
    assert data["recognised"] == [8]
    assert [len(data["seen"]), len(data["clouds"])] == [2, 2]
    assert {one["name"] for one in data["tints"]} == {"position error", "mode", "state"}
    assert len(text) < 3_000_000


def test_hostile_names_stay_words(run: Path, tmp_path: Path) -> None:
    text, data = page_of(run, out=tmp_path / "run.html")
    assert data["events"][1]["reason"] == HOSTILE
    assert "<script>document" not in text and "<img" not in text


def test_a_run_page_does_not_need_database_evaluation_poses_or_overlays(run: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.h5").unlink()
    for name in ("evaluation.json", "realtime.tum", "odometry.tum", "overlays.h5", "timing.csv", "uncertainty.csv"):
        (run / name).unlink()
    Trajectory("map", np.empty(0, np.int64), np.empty((0, 4, 4))).save_tum(run / "trajectory.tum")
    (run / "events.jsonl").write_text("")
    text, data = page_of(run, out=tmp_path / "run.html")
    assert "No pose at any time" in text and data["events"] == []


def test_a_database_that_moved_is_named(run: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.h5").rename(tmp_path / "moved.h5")
    assert page_of(run, out=tmp_path / "run.html")[1]["intersections"]["id"] == []
    write_report([run], Wanted(tmp_path / "run.html"), ToolSettings(), map_file=tmp_path / "moved.h5")
    assert '"id":[3,8]' in (tmp_path / "run.html").read_text()
    with pytest.raises(DatabaseError):
        write_report([run], Wanted(tmp_path / "run.html"), ToolSettings(), map_file=run / "settings.yaml")


def test_a_database_page_holds_every_intersection(semantic_map: SemanticMap, tmp_path: Path) -> None:
    database.save(semantic_map, tmp_path / "mine.h5")
    text, data = page_of(tmp_path / "mine.h5", out=tmp_path / "mine.html")
    marks, origin = data["intersections"], data["plan"]["origin"]
    assert marks["id"] == [3, 8] and marks["kind"] == ["T", "X"]
    assert marks["x"][1] + origin[0] == pytest.approx(600_030.0)
    assert [row[1] for row in data["clouds"]] == [200, 200]
    assert "settings" in text.lower()


def test_runs_are_compared(run: Path, semantic_map: SemanticMap, tmp_path: Path) -> None:
    other = write_run(tmp_path / "second", semantic_map, off=0.5)
    text, data = page_of(run, other, out=tmp_path / "both.html")
    assert [track["title"] for track in data["tracks"]] == ["run", "run (2)", "truth"]
    assert "<td>0.250</td>" in text and "<td>0.500</td>" in text and "REP-5 [%]" in text


def test_the_same_files_give_the_same_page(run: Path, tmp_path: Path) -> None:
    for source in (run, tmp_path / "mine.h5"):
        page_of(source, out=tmp_path / "one.html")
        page_of(source, out=tmp_path / "two.html")
        assert (tmp_path / "one.html").read_bytes() == (tmp_path / "two.html").read_bytes()


def test_figures_and_tables_are_written(
    run: Path, semantic_map: SemanticMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tools.report.figures.PRINT_DPI", 50)
    other = write_run(tmp_path / "second", semantic_map, off=0.5)
    figures, tables = tmp_path / "figures", tmp_path / "tables"
    for name, sources in {"run": [run], "both": [run, other], "mine": [tmp_path / "mine.h5"]}.items():
        command = [*map(str, sources), f"--figures={figures / name}", f"--csv={tables / name}"]
        assert cli.run(["report", *command]) == 0
    drawn = {path.relative_to(figures).with_suffix("") for path in figures.rglob("*.*")}
    for wanted in ("run/plan_by_error", "run/errors_in_sigmas", "run/attitude", "both/error_maps", "mine/similarity"):
        assert Path(wanted) in drawn
    for path in figures.rglob("*.*"):
        begin = path.read_bytes()[:300]
        assert begin.startswith(b"\x89PNG") if path.suffix == ".png" else b"<svg" in begin or b"<?xml" in begin
    rows = list(csv.reader((tables / "run" / "errors_trajectory.csv").open()))
    assert len(list(csv.reader((tables / "run" / "drift.csv").open()))) > 3
    assert len(rows) == 101 and float(rows[5][5]) == pytest.approx(0.25, abs=1e-4)
    assert {path.name for path in (tables / "mine").iterdir()} == {
        "intersections.csv", "similarity_pwcv.csv", "similarity_cwc.csv", "look_alikes.csv", "anchors.csv",
    }  # fmt: skip
    assert (tables / "both" / "comparison.csv").read_text().count("\n") == 3
    assert all(re.fullmatch(r"[\w.-]+", path.name) for path in tables.rglob("*"))


def test_a_spreadsheet_takes_no_word_for_a_formula(run: Path, tmp_path: Path) -> None:
    event = {"stamp_ns": 1, "kind": "note", "why": "=cmd()", "off": -1.5}
    (run / "events.jsonl").write_text(json.dumps(event) + "\n")
    assert cli.run(["report", str(run), f"--csv={tmp_path / 'tables'}"]) == 0
    assert "'=cmd()" in (tmp_path / "tables" / "events_note.csv").read_text()
    assert ",-1.5" in (tmp_path / "tables" / "events_note.csv").read_text()


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("events.jsonl", '{"stamp_ns": 1\n'),
        ("events.jsonl", '{"stamp_ns": "soon", "kind": "a"}\n'),
        ("summary.json", "[]"),
        ("timing.csv", "ms\nlong\n"),
        ("overlays.h5", "no overlays"),
        ("uncertainty.csv", "stamp\n1\n"),
    ],
)
def test_a_damaged_run_is_refused_and_nothing_is_written(run: Path, tmp_path: Path, file: str, text: str) -> None:
    (run / file).write_text(text)
    with pytest.raises(InputFileError, match=file):
        write_report([run], Wanted(tmp_path / "run.html"), ToolSettings())
    assert not (tmp_path / "run.html").exists()


def test_what_does_not_go_together_is_said(run: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.h5"
    with pytest.raises(SettingsError, match="nothing to write"):
        write_report([run], Wanted(), ToolSettings())
    with pytest.raises(SettingsError, match="not a directory of a run"):
        write_report([run, mine], Wanted(tmp_path / "a.html"), ToolSettings())
    with pytest.raises(SettingsError, match="made of a run"):
        write_report([mine], Wanted(rerun=tmp_path / "a.rrd"), ToolSettings())


def test_bands_cover_the_run_without_gaps() -> None:
    events = [
        {"stamp_ns": 2_000_000_000, "kind": "state", "before": "unknown", "after": "tracking"},
        {"stamp_ns": 5_000_000_000, "kind": "state", "before": "tracking", "after": "suspect"},
    ]
    bands = state_bands(events, 1_000_000_000, 9_000_000_000)["state"]
    assert [(band.start, band.end, band.name) for band in bands] == [
        (0.0, 1.0, "unknown"),
        (1.0, 4.0, "tracking"),
        (4.0, 8.0, "suspect"),
    ]


def test_events_of_a_kind_share_a_table() -> None:
    events = [
        {"stamp_ns": 0, "kind": "a", "x": 1},
        {"stamp_ns": 1, "kind": "b"},
        {"stamp_ns": 2, "kind": "a", "y": [2, 3]},
    ]
    first, second = event_tables(events, 0)
    assert (first.kind, first.columns, first.words) == ("a", ("time [s]", "x", "y"), (False, False, True))
    assert [row[1:] for row in first.rows] == [(1, ""), ("", "2  3")]
    assert (second.kind, second.count) == ("b", 1)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, ""),
        (True, "yes"),
        (0.123456, "0.123"),
        (5400000.25, "5400000.2"),
        ([1.0, 2.0], "1  2"),
        ({"id": 3}, "id 3"),
    ],
)
def test_cells(value: object, text: str) -> None:
    assert cell(value) == text


def test_tables_escape_what_they_show() -> None:
    assert "&lt;b&gt;" in table(["a"], [["<b>"]])
    assert table(["a"], []) == ""


@pytest.mark.parametrize("count", [0, 1])
def test_a_map_of_hardly_any_intersection_has_its_page_too(
    count: int, semantic_map: SemanticMap, tmp_path: Path
) -> None:
    graph = replace(semantic_map.roadways, node_intersection=np.array([3, -1, -1]) if count else np.full(3, -1))
    kinds = np.where(graph.node_intersection < 0, "dead_end", "intersection")
    few = replace(
        semantic_map, intersections=semantic_map.intersections[:count], roadways=replace(graph, node_kind=kinds)
    )
    database.save(few, tmp_path / "few.h5")
    _, data = page_of(tmp_path / "few.h5", out=tmp_path / "few.html")
    assert len(data["intersections"]["id"]) == count and data["pairs"] == []
    assert cli.run(["report", str(tmp_path / "few.h5"), f"--csv={tmp_path / 'tables'}"]) == 0
