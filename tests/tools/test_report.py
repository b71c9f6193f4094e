"""The report page: whole, self-contained, and it shows what the files say."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from semmap import database
from semmap.errors import InputFileError
from semmap.geometry import se3
from semmap.intersections import SemanticMap
from semmap.trajectory import Trajectory
from tools.evaluate import evaluate_run
from tools.report import write_report
from tools.report.contours import contour_picture
from tools.report.events import cell, event_tables, state_bands
from tools.report.page import table


@pytest.fixture
def run(tmp_path: Path, semantic_map: SemanticMap) -> Path:
    """A run of ten seconds over the map, with its truth, as the files of `semmap localize` say it."""
    out = tmp_path / "run"
    stamps = np.int64(1e8) * np.arange(100)
    truth = semantic_map.origin + np.outer(np.arange(100) * 0.2, [1.0, 0.2, 0.0])
    Trajectory("map", stamps, se3(np.eye(3), truth)).save_tum(tmp_path / "truth.tum")
    Trajectory("map", stamps, se3(np.eye(3), truth + np.array([0.0, 0.25, 0.0]))).save_tum(out / "trajectory.tum")
    Trajectory("map", stamps[40:], se3(np.eye(3), truth[40:])).save_tum(out / "realtime.tum")
    Trajectory("odom", stamps, se3(np.eye(3), truth - truth[0])).save_tum(out / "odometry.tum")
    database.save(semantic_map, tmp_path / "mine.h5")
    events = [
        {
            "stamp_ns": 4_000_000_000,
            "kind": "state",
            "before": "unknown",
            "after": "tracking",
            "why": "seen <twice>",
        },
        {
            "stamp_ns": 4_000_000_000,
            "kind": "intersection",
            "id": 8,
            "accepted": True,
            "fit": 0.9123,
            "reason": "fits",
        },
        {
            "stamp_ns": 6_000_000_000,
            "kind": "intersection",
            "id": 3,
            "accepted": False,
            "reason": "contradicts",
        },
    ]
    (out / "events.jsonl").write_text("".join(json.dumps(event) + "\n" for event in events))
    summary = {
        "map": str(tmp_path / "mine.h5"),
        "scans": 100,
        "intersections_recognised": [8],
        "versions": {"a": "1"},
    }
    (out / "summary.json").write_text(json.dumps({**summary, "ms_per_scan_median": 12.4, "recording": "r", "rig": "g"}))
    (out / "settings.yaml").write_text("seed: 0\n")
    evaluate_run(out, tmp_path / "truth.tum")
    return out


class _Balanced(HTMLParser):
    """Checks that every element that is opened is closed, in order."""

    VOID = frozenset({"meta", "br", "img", "link", "circle", "path", "line", "use", "rect", "image"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag


def assert_self_contained(page: str) -> None:
    checker = _Balanced()
    checker.feed(page)
    assert checker.open == []
    assert "<script" not in page
    links = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert all(link.startswith(("#", "data:")) for link in links), links


def test_a_run_page_shows_the_figures_of_the_run(run: Path, tmp_path: Path) -> None:
    write_report(run, tmp_path / "run.html")
    page = (tmp_path / "run.html").read_text()
    assert_self_contained(page)
    for words in ("Plan", "Position over time", "Errors", "State", "Events: intersection (2)", "seed: 0"):
        assert words in page
    assert "<dd>0.250 m</dd>" in page  # RMSE without alignment
    assert "seen &lt;twice&gt;" in page
    assert len(page) < 2_000_000


def test_a_run_page_does_not_need_database_evaluation_or_poses(run: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.h5").unlink()
    (run / "evaluation.json").unlink()
    Trajectory("map", np.empty(0, np.int64), np.empty((0, 4, 4))).save_tum(run / "trajectory.tum")
    (run / "realtime.tum").unlink()
    (run / "odometry.tum").unlink()
    (run / "events.jsonl").write_text("")
    write_report(run, tmp_path / "run.html")
    assert "Nothing to draw" in (tmp_path / "run.html").read_text()


def test_a_database_page_shows_every_intersection(semantic_map: SemanticMap, tmp_path: Path) -> None:
    database.save(semantic_map, tmp_path / "mine.h5")
    write_report(tmp_path / "mine.h5", tmp_path / "mine.html")
    page = (tmp_path / "mine.html").read_text()
    assert_self_contained(page)
    assert "600030.00" in page
    assert page.count('role="img"') == 2
    assert "PWCV similarity" in page


def test_the_same_files_give_the_same_page(run: Path, tmp_path: Path) -> None:
    write_report(run, tmp_path / "one.html")
    write_report(run, tmp_path / "two.html")
    assert (tmp_path / "one.html").read_bytes() == (tmp_path / "two.html").read_bytes()


@pytest.mark.parametrize(("file", "text"), [("events.jsonl", '{"stamp_ns": 1\n'), ("summary.json", "[]")])
def test_a_damaged_run_is_refused_and_nothing_is_written(run: Path, tmp_path: Path, file: str, text: str) -> None:
    (run / file).write_text(text)
    with pytest.raises(InputFileError, match=file):
        write_report(run, tmp_path / "run.html")
    assert not (tmp_path / "run.html").exists()


def test_a_contour_is_drawn_where_it_was_seen(semantic_map: SemanticMap) -> None:
    picture = contour_picture(semantic_map.by_id(3), radius=12.0)
    path = re.search(r' d="([^"]*)"', picture)
    assert path is not None
    assert path[1].count("M60.0 60.0L") == 1  # one stretch of observed sectors, from the centre
    assert picture.count("<line") == 3  # one mark a roadway


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
        {"stamp_ns": 2, "kind": "a", "y": 2},
    ]
    titles = [title for title, _ in event_tables(events, 0)]
    assert titles == ["Events: a (2)", "Events: b (1)"]


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
