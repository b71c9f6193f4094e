"""The main job on a small simulated mine, through the command line: simulate, build, localize, evaluate, report."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from semmap import database
from semmap.trajectory import Trajectory
from tools import cli
from tools.overlays import read_overlays

SECONDS = 60
RUN_FILES = (
    "trajectory.tum", "realtime.tum", "odometry.tum", "events.jsonl", "overlays.h5", "uncertainty.csv", "timing.csv",
    "summary.json", "settings.yaml",
)  # fmt: skip


def semmap(*words: object) -> None:
    """Run a command that must succeed."""
    assert cli.run([str(word) for word in words]) == 0


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first minute in the built-in mine, and its database ``mine.h5``."""
    out = tmp_path_factory.mktemp("mine")
    config = out / "config.yaml"
    config.write_text(f"simulate: {{duration_s: {SECONDS}}}\n")
    semmap("simulate", "demo", "--out", out, "--config", config, "--seed", 4)
    semmap("build", out / "prior_map.laz", "--out", out / "mine.h5")
    return out


@pytest.fixture(scope="module")
def run(mine: Path) -> Path:
    """That minute, localized with the database and evaluated."""
    out = mine / "run"
    semmap("localize", mine / "recording", "--rig", mine / "rig.yaml", "--map", mine / "mine.h5", "--out", out)
    semmap("evaluate", out, "--truth", mine / "ground_truth.tum")
    return out


def test_the_database_holds_the_mines_junctions(mine: Path) -> None:
    junctions = np.loadtxt(mine / "junctions.csv", delimiter=",", skiprows=1, usecols=(1, 2, 3))
    found = np.array([one.p_map for one in database.load(mine / "mine.h5").intersections])
    distances = np.linalg.norm(junctions[:, None, :2] - found[None, :, :2], axis=-1)
    assert (distances.min(axis=1) < 2.0).all()


def test_a_run_leaves_all_its_files(run: Path) -> None:
    assert all((run / name).stat().st_size > 0 for name in RUN_FILES)
    summary = json.loads((run / "summary.json").read_text())
    assert summary["scans"] >= SECONDS * 10 - 10
    assert summary["ms_per_scan_median"] > 0.0
    assert summary["peak_memory_mb"] > 0.0
    assert all({"stamp_ns", "kind"} <= json.loads(line).keys() for line in (run / "events.jsonl").open())


def test_the_uncertainty_has_a_line_for_each_scan(run: Path) -> None:
    with (run / "uncertainty.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [round(float(row["stamp"]) * 1e9) for row in rows] == Trajectory.load_tum(
        run / "odometry.tum"
    ).stamps_ns.tolist()
    assert {row["mode"] for row in rows} <= {"LIO", "LIW"}
    assert all(float(row["odom_xx"]) >= 0.0 and row["degenerate"] in "01" for row in rows)
    assert rows[0]["map_xx"] == "" and 0.0 < float(rows[-1]["map_xx"]) < 0.1


def test_the_trajectory_is_in_the_map_without_alignment(run: Path) -> None:
    evaluation = json.loads((run / "evaluation.json").read_text())
    final = evaluation["trajectories"]["trajectory"]
    assert final["frame"] == "map"
    assert final["compared"] >= SECONDS * 10 - 10
    assert final["absolute"]["position_m"]["rmse"] < 0.3
    assert final["absolute"]["rotation_deg"]["rmse"] < 2.0


def test_in_real_time_it_says_nothing_before_it_knows_and_then_the_truth(run: Path) -> None:
    realtime = json.loads((run / "evaluation.json").read_text())["realtime"]
    assert 0.0 < realtime["first_fix_s"] < SECONDS
    errors = json.loads((run / "evaluation.json").read_text())["trajectories"]["realtime"]["absolute"]["position_m"]
    assert errors["max"] < 1.0


def test_what_was_compared_lies_on_the_walls_of_the_map(mine: Path, run: Path) -> None:
    events = [json.loads(line) for line in (run / "events.jsonl").open()]
    accepted = [event for event in events if event.get("accepted") and "overlay" in event]
    overlays, semantic_map = read_overlays(run / "overlays.h5"), database.load(mine / "mine.h5")
    assert accepted and [event["overlay"] for event in events if "overlay" in event] == list(range(len(overlays)))
    for event in accepted:
        one = semantic_map.by_id(int(overlays.id[event["overlay"]]))
        points = overlays.in_map(event["overlay"]) - one.p_map
        distance, _ = cKDTree(one.cloud).query(points)
        assert event["id"] == one.id and np.median(distance) < 0.15


def test_without_the_database_there_is_odometry_in_its_own_frame(mine: Path) -> None:
    out = mine / "alone"
    words = ["localize", mine / "recording", "--rig", mine / "rig.yaml", "--map", mine / "mine.h5", "--out", out]
    semmap(*words, "--without", "intersections,wheel")
    assert Trajectory.load_tum(out / "trajectory.tum").frame == "odom"
    assert json.loads((out / "summary.json").read_text())["without"] == ["intersections", "wheel"]


def test_both_reports_are_written(mine: Path, run: Path) -> None:
    semmap("report", run, "--out", mine / "run.html")
    semmap("report", mine / "mine.h5", "--out", mine / "mine.html")
    assert "intersections recognised" in (mine / "run.html").read_text()
    assert "CWC, unrolled" in (mine / "mine.html").read_text()


def test_info_lists_the_intersections(mine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    semmap("info", mine / "mine.h5")
    assert "intersections" in capsys.readouterr().out


def test_without_the_lidar_it_is_not_in_the_map_and_says_so(mine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = mine / "blind"
    words = ["localize", mine / "recording", "--rig", mine / "rig.yaml", "--map", mine / "mine.h5", "--out", out]
    semmap(*words, "--without", "lidar")
    assert "no place in the map" in capsys.readouterr().out
    trajectory = (out / "trajectory.tum").read_text()
    assert trajectory.startswith("# frame: map")
    assert "never found its place" in trajectory
    semmap("report", out, "--out", mine / "blind.html")
