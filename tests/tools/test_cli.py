"""The command line itself: its options, its exit status, and that it answers at once."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

import semmap
from semmap.errors import SettingsError
from tools import cli

COMMANDS = ("demo", "simulate", "build", "info", "merge", "export", "localize", "calibrate-imu", "evaluate", "report")


def test_the_command_line_loads_nothing_heavy() -> None:
    heavy = ("numpy", "scipy", "pydantic", "numba", "open3d", "gtsam", "matplotlib", "h5py", "rosbags")
    code = f"import sys, tools.cli; print([m for m in {heavy!r} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"


def test_help_lists_every_command_and_each_has_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["--help"]) == 0
    overview = capsys.readouterr().out
    for command in COMMANDS:
        assert f"  {command}" in overview
        assert cli.run([command, "--help"]) == 0
        assert f"Usage: semmap {command}" in capsys.readouterr().out


def test_without_a_command_the_help_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run([]) == 0
    assert capsys.readouterr().out.startswith("Usage: semmap")


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["--version"]) == 0
    assert capsys.readouterr().out == f"semmap {semmap.__version__}\n"


@pytest.mark.parametrize(
    ("words", "moved"),
    [
        (["localize", "bag", "--seed", "3", "-v"], ["--seed", "3", "-v", "localize", "bag"]),
        (["localize", "bag", "--config=a.yaml"], ["--config=a.yaml", "localize", "bag"]),
        (["simulate", "--out", "d", "--", "--seed"], ["simulate", "--out", "d", "--", "--seed"]),
        (["localize", "--seed"], ["--seed", "localize"]),
    ],
)
def test_common_options_may_stand_anywhere(words: list[str], moved: list[str]) -> None:
    assert cli.common_options_first(words) == moved


def test_dump_config_prints_settings_that_config_reads(tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["localize", "--dump-config", "--seed", "7"]) == 0
    text = capsys.readouterr().out
    settings = yaml.safe_load(text)
    assert settings["seed"] == 7
    assert {"map", "localize", "simulate"} <= set(settings)
    (tmp_path / "config.yaml").write_text(text)
    assert cli.run(["--config", str(tmp_path / "config.yaml"), "--dump-config"]) == 0
    assert capsys.readouterr().out == text


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["locaize"], "localize"),
        (["localize", "bag"], "--rig"),
        (["build", "--out"], "--out"),
        (["info", "a.h5", "--verbos"], "--verbos"),
        (["demo", "--seed", "-1"], "--seed"),
    ],
)
def test_wrong_usage_is_one_line_and_status_2(args: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(args) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("semmap: error: ")
    assert captured.err.count("\n") == 1
    assert words in captured.err


@pytest.mark.parametrize(
    ("fault", "status"),
    [
        (SettingsError("is wrong\nin two lines"), 2),
        (KeyboardInterrupt(), 130),
        (ZeroDivisionError("oops"), 1),
    ],
)
def test_what_goes_wrong_inside_becomes_an_exit_status(
    fault: BaseException, status: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(config: object, seed: object) -> None:
        raise fault

    monkeypatch.setattr("tools.settings.load_settings", broken)
    assert cli.run(["--dump-config"]) == status
    captured = capsys.readouterr()
    assert captured.err.count("\n") == (0 if status == 130 else 1)
    assert "Traceback" not in captured.err


def test_verbose_keeps_the_traceback_of_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(config: object, seed: object) -> None:
        raise ZeroDivisionError("oops")

    monkeypatch.setattr("tools.settings.load_settings", broken)
    with pytest.raises(ZeroDivisionError):
        cli.run(["--dump-config", "-v"])


def test_main_exits_with_the_status() -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.main(["--nonsense"])
    assert stopped.value.code == 2


def test_ctrl_c_ends_quietly_with_130(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tools.cli", "simulate", "demo", "--out", str(tmp_path / "out")]
    # a suite in the background of a script has interrupts ignored, and its children with it
    heard = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **heard) as process:
        while not list(tmp_path.glob(".out.*")) and process.poll() is None:  # the work has begun
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    # a shell shows 130 for both: an interrupt inside generated code makes Python end itself by the signal
    assert process.returncode in (130, -signal.SIGINT)
    assert out + err == ""
    assert list(tmp_path.iterdir()) == []
