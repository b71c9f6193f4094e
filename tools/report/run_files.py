"""What a run directory holds, read back for the report."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from semmap import database
from semmap.errors import InputFileError, SemmapError
from semmap.geometry import Array
from semmap.intersections import SemanticMap
from semmap.trajectory import Trajectory
from tools.evaluate import CheckPoints, load_trajectories, read_check_points
from tools.overlays import Overlays, read_overlays
from tools.report.uncertainty import Uncertainties, read_uncertainties


@dataclass(frozen=True, slots=True)
class RunFiles:
    """One run: trajectories by name, events, summary, settings text; and what there is of the others.

    overlays : what the ICP checks compared. timing : of each scan [ms]; ``timed`` says which time.
    """

    name: str
    trajectories: dict[str, Trajectory]
    events: tuple[dict[str, Any], ...]
    summary: dict[str, Any]
    settings: str
    evaluation: dict[str, Any]
    truth: Trajectory | None
    semantic_map: SemanticMap | None
    uncertainty: Uncertainties | None = None
    check_points: CheckPoints | None = None
    overlays: Overlays | None = None
    timing: Array | None = None
    timed: str = "ms"

    @property
    def end_ns(self) -> int:
        """Stamp of the last pose of any trajectory, 0 where there is none."""
        return max((int(one.stamps_ns[-1]) for one in self.trajectories.values() if len(one)), default=0)

    @property
    def start_ns(self) -> int:
        """Stamp of the first pose of any trajectory, 0 where there is none."""
        return min((int(one.stamps_ns[0]) for one in self.trajectories.values() if len(one)), default=0)


def read_run(directory: Path, map_file: Path | None = None) -> RunFiles:
    """The run in ``directory``; raises `InputFileError` where a file of it is missing or damaged.

    map_file : the database, where it no longer is where the run found it; `DatabaseError` where it is none.
    """
    trajectories = load_trajectories(directory)
    summary = _json(directory / "summary.json")
    told, laid, timed = (directory / name for name in ("uncertainty.csv", "overlays.h5", "timing.csv"))
    timing, timed_as = _timing(timed) if timed.is_file() else (None, "ms")
    evaluation = _json(directory / "evaluation.json") if (directory / "evaluation.json").is_file() else {}
    return RunFiles(
        name=directory.resolve().name,
        trajectories=trajectories,
        events=tuple(_events(directory / "events.jsonl")),
        summary=summary,
        settings=_text(directory / "settings.yaml"),
        evaluation=evaluation,
        truth=_truth(evaluation.get("truth")),
        semantic_map=_semantic_map(summary.get("map")) if map_file is None else database.load(map_file),
        uncertainty=read_uncertainties(told) if told.is_file() else None,
        check_points=_check_points(evaluation.get("truth")),
        overlays=read_overlays(laid) if laid.is_file() else None,
        timing=timing,
        timed=timed_as,
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
    events = [(number, _parsed(line, path, number)) for number, line in lines if line.strip()]
    for number, event in events:
        if type(event.get("stamp_ns")) is not int or not isinstance(event.get("kind"), str):
            mend = "run `semmap localize` again"
            raise InputFileError("has no stamp_ns or kind", file=path, field=f"line {number}", mend=mend)
    return [event for _, event in events]


def _truth(name: str | None) -> Trajectory | None:
    """The truth the evaluation used, where it is a trajectory that is still there."""
    if name is None or name.endswith(".csv") or not Path(name).is_file():
        return None
    return Trajectory.load_tum(name)


def _check_points(name: str | None) -> CheckPoints | None:
    if name is None or not name.endswith(".csv") or not Path(name).is_file():
        return None
    return read_check_points(name)


def _timing(path: Path) -> tuple[Array, str]:
    """Milliseconds of each scan (n,), and what they are."""
    name, *lines = _text(path).split() or [""]
    try:
        return np.array([float(line) for line in lines]), name
    except ValueError as reason:
        mend = "run `semmap localize` again"
        raise InputFileError(f"is not a column of numbers ({reason})", file=path, mend=mend) from None


def _semantic_map(name: str | None) -> SemanticMap | None:
    """The database the run used, where it is still there: without it the page merely lacks the plan."""
    if name is None or not Path(name).is_file():
        return None
    try:
        return database.load(name)
    except SemmapError:
        return None
