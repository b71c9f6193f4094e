"""What the README shows runs as it stands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from small_files import write_recording

from semmap import database
from semmap.intersections import SemanticMap
from semmap.rig import Rig
from tools import cli

README = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    """The one code block of a language."""
    (text,) = re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)
    return str(text)


def test_the_rig_is_valid() -> None:
    rig = Rig.model_validate(yaml.safe_load(block("yaml")))
    assert None not in (rig.lidar, rig.wheel, rig.uwb, rig.total_station)


def test_the_python_example_runs(
    tmp_path: Path, rig_file: Path, semantic_map: SemanticMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    database.save(semantic_map, tmp_path / "mine.h5")
    write_recording(tmp_path / "flight.bag", rig_file, "bag")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(block("python"), "README.md", "exec"), names)
    assert names["result"].odometry.frame == "odom"  # type: ignore[attr-defined]


def test_every_command_exists(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["--help"]) == 0
    known = set(re.findall(r"^  (\w+) ", capsys.readouterr().out, flags=re.MULTILINE))
    shown = set(re.findall(r"^    semmap (\w+)", README, flags=re.MULTILINE))
    assert len(shown) > 4
    assert shown <= known
