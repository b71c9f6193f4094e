"""The roadheader benchmark on the shortest of stretches."""

from __future__ import annotations

import numpy as np

from semmap.measurements import Scan
from semmap.trajectory import Trajectory
from tools.bench import roadheader
from tools.bench.roadheader_drives import ghosts, thickness
from tools.simulator.roadheader import roadheader_rig


def test_the_enhancement_removes_more_of_the_heading_error_than_the_papers() -> None:
    off = {method: roadheader._off(roadheader.TACTICAL, 4, 30.0, method) for method in ("mean", "enhanced")}
    assert abs(off["enhanced"][0]) < (1.0 - roadheader.PAPER_PERCENT / 100.0) * abs(off["mean"][0])
    assert np.degrees(off["enhanced"][1]) < 0.02


def test_it_prints_a_line_a_seed_and_a_summary(capsys, monkeypatch) -> None:
    monkeypatch.setattr(roadheader, "HELD_S", 3.0)
    roadheader.alignment(1, 5.0)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + 2 * (1 + len(roadheader.METHODS))
    assert "% removed" in lines[-1]


def test_the_latency_is_as_stated(capsys) -> None:
    roadheader.online(4.0)
    for line in capsys.readouterr().out.splitlines():
        assert "latency 1.25 s stated, 1.25" in line


def test_a_track_that_is_off_puts_ghosts_into_the_map() -> None:
    rig, rng = roadheader_rig(), np.random.default_rng(3)
    assert rig.lidar is not None
    stamps = np.arange(0, 4_000_000_001, 100_000_000)
    truth = Trajectory("map", stamps, np.tile(np.eye(4), (len(stamps), 1, 1)))
    wall = [
        Scan(stamp, np.column_stack([np.full(4000, 5.0), *rng.uniform(-2.0, 2.0, (2, 4000))]).astype(np.float32),
             np.zeros(4000, np.int64))
        for stamp in stamps[:-1].tolist()
    ]  # fmt: skip
    off = truth.poses.copy()
    off[:, 0, 3] -= 0.08
    moved, half = Trajectory("map", stamps, off), Trajectory("map", stamps, np.r_[truth.poses[:20], off[20:]])
    assert ghosts(truth, truth, rig, wall) < 0.03
    assert abs(ghosts(moved, truth, rig, wall) - 0.08) < 0.01
    # a map of one whole shift is crisp all the same; one that is off by half of the time is not
    assert thickness(moved, rig, wall) < 0.01
    assert thickness(half, rig, wall) > 0.03
