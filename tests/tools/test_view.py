"""`semmap view` off-screen, and a run for the Rerun viewer."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from small_files import RIG, write_recording

from semmap import database
from semmap.errors import SettingsError
from semmap.intersections import SemanticMap
from tools import cli
from tools.report import Wanted, write_report
from tools.settings import ToolSettings
from tools.view import view_source


def colours_of(path: Path) -> int:
    """How many colours a picture has."""
    image = pytest.importorskip("PIL.Image").open(path).convert("RGB")
    return len(np.unique(np.asarray(image).reshape(-1, 3), axis=0))


def test_a_database_a_run_and_a_map_have_their_pictures(run: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyvista", reason="needs pyvista")
    cloud = tmp_path / "map.pcd"
    points = np.random.default_rng(0).uniform(0.0, 9.0, (1500, 3)).astype(np.float32)
    header = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1500\nHEIGHT 1\nPOINTS 1500\n"
    cloud.write_text(
        header + "DATA ascii\n" + "\n".join(" ".join(f"{value:.3f}" for value in point) for point in points) + "\n"
    )
    mine = tmp_path / "mine.h5"
    for number, words in enumerate(([mine], [mine, "--intersection=8"], [run], [cloud])):
        picture = tmp_path / f"{number}.png"
        assert cli.run(["view", *map(str, words), f"--screenshot={picture}"]) == 0
        assert picture.read_bytes().startswith(b"\x89PNG")
        assert colours_of(picture) > 20


def test_what_cannot_be_shown_is_said(
    semantic_map: SemanticMap, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = tmp_path / "mine.h5"
    database.save(semantic_map, mine)
    picture = tmp_path / "a.png"
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    if sys.platform == "linux":
        with pytest.raises(SettingsError, match="--screenshot"):
            view_source(mine)
    with pytest.raises(SettingsError, match=r"of a database|pyvista"):
        view_source(run, screenshot=picture, intersection=8)
    with pytest.raises(SettingsError, match=r"no intersection 5|pyvista"):
        view_source(mine, screenshot=picture, intersection=5)
    assert not picture.exists()


def test_without_pyvista_or_rerun_one_line_says_how_to_get_them(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pyvista", None)
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert cli.run(["view", str(tmp_path / "mine.h5"), f"--screenshot={tmp_path / 'a.png'}"]) == 2
    assert cli.run(["report", str(run), f"--rerun={tmp_path / 'a.rrd'}"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert ["pip install" in line for line in lines] == [True, True]
    assert not list(tmp_path.glob("a.*"))


def test_a_run_for_rerun_holds_map_trajectory_scans_and_intersections(run: Path, tmp_path: Path) -> None:
    rerun = pytest.importorskip("rerun", reason="needs rerun-sdk")
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(RIG))
    recording = write_recording(tmp_path / "recording", rig)
    summary = json.loads((run / "summary.json").read_text())
    (run / "summary.json").write_text(json.dumps(summary | {"rig": str(rig), "recording": "gone"}))
    for name, source in {"with": recording, "without": None}.items():
        write_report([run], Wanted(rerun=tmp_path / f"{name}.rrd"), ToolSettings(), recording=source)
        assert (tmp_path / f"{name}.rrd").read_bytes().startswith(b"RRF")
    assert rerun.__version__
