"""`semmap demo`, as a newcomer runs it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tools import cli


@pytest.mark.slow
def test_the_demo_shows_that_the_database_helps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.run(["demo"]) == 0
    out = capsys.readouterr().out
    assert "with the database" in out
    assert "report: demo/report.html" in out
    assert "<h2>Plan</h2>" in Path("demo/report.html").read_text()
    runs = (Path("demo") / name / "evaluation.json" for name in ("with_database", "without_database"))
    with_database, without = (json.loads(path.read_text())["trajectories"]["trajectory"] for path in runs)
    error = with_database["absolute"]["position_m"]["rmse"]
    assert error < 0.1
    assert error < without["from_start"]["position_m"]["rmse"]
