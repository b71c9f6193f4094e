"""What a run directory holds, read back for the report."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from semmap import database
from semmap.errors import InputFileError, SemmapError
from semmap.intersections import SemanticMap
from semmap.trajectory import Trajectory
from tools.evaluate import load_trajectories
from tools.report.uncertainty import Uncertainties, read_uncertainties


@dataclass(frozen=True, slots=True)
class RunFiles:
    """One run: trajectories by name, events, summary, settings text; evaluation, truth, map and uncertainty if any."""

    name: str
    trajectories: dict[str, Trajectory]
    events: tuple[dict[str, Any], ...]
    summary: dict[str, Any]
    settings: str
    evaluation: dict[str, Any]
    truth: Trajectory | None
    semantic_map: SemanticMap | None
    uncertainty: Uncertainties | None = None

    @property
    def start_ns(self) -> int:
        """Stamp of the first pose of any trajectory, 0 where there is none."""
        return min((int(one.stamps_ns[0]) for one in self.trajectories.values() if len(one)), default=0)


def read_run(directory: Path) -> RunFiles:
    """The run in ``directory``; raises `InputFileError` where a file of it is missing or damaged."""
    trajectories = load_trajectories(directory)
    summary = _json(directory / "summary.json")
    told = directory / "uncertainty.csv"
    evaluation = _json(directory / "evaluation.json") if (directory / "evaluation.json").is_file() else {}
    return RunFiles(
        name=directory.resolve().name,
        trajectories=trajectories,
        events=tuple(_events(directory / "events.jsonl")),
        summary=summary,
        settings=_text(directory / "settings.yaml"),
        evaluation=evaluation,
        truth=_truth(evaluation.get("truth")),
        semantic_map=_semantic_map(summary.get("map")),
        uncertainty=read_uncertainties(told) if told.is_file() else None,
    )


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as reason:
        raise InputFileError(f"cannot be read ({reason})", file=path, mend="run `semmap localize` again") from None


def _parsed(text: str, path: Path, line: int | None = None) -> dict[str, Any]:
    try:
        data = json.loads(text)
    except json.JSONDecodeError as reason:
        field = f"line {line or reason.lineno}"
        mend = "run `semmap localize` again"
        raise InputFileError(f"is not JSON ({reason.msg})", file=path, field=field, mend=mend) from None
    if not isinstance(data, dict):
        raise InputFileError("is not a JSON object", file=path, mend="run `semmap localize` again")
    return data


def _json(path: Path) -> dict[str, Any]:
    return _parsed(_text(path), path)


def _events(path: Path) -> list[dict[str, Any]]:
    lines = enumerate(_text(path).splitlines(), 1)
    return [_parsed(line, path, number) for number, line in lines if line.strip()]


def _truth(name: str | None) -> Trajectory | None:
    """The truth the evaluation used, where it is a trajectory that is still there."""
    if name is None or name.endswith(".csv") or not Path(name).is_file():
        return None
    return Trajectory.load_tum(name)


def _semantic_map(name: str | None) -> SemanticMap | None:
    """The database the run used, where it is still there: without it the page merely lacks the plan."""
    if name is None or not Path(name).is_file():
        return None
    try:
        return database.load(name)
    except SemmapError:
        return None
