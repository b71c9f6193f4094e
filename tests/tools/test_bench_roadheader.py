"""The roadheader benchmark on the shortest of stretches."""

from __future__ import annotations

import numpy as np

from tools.bench import roadheader


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
