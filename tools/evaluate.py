"""A run directory against the truth: `evaluation.json` and a table.

The truth is a TUM trajectory of the IMU in the map frame, or a CSV of surveyed check points.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from semmap.errors import InputFileError, TrajectoryError
from semmap.files import written_whole
from semmap.geometry import Array
from semmap.trajectory import Trajectory, stamp_ns_of_text
from tools import metrics
from tools.tables import text_table

TRAJECTORIES = ("trajectory", "realtime", "odometry")
MAP_FRAME = "map"


@dataclass(frozen=True, slots=True)
class CheckPoints:
    """Surveyed positions of the IMU: names, stamps (n,) int64 [ns], points (n, 3) [m] in the map."""

    names: tuple[str, ...]
    stamps_ns: NDArray[np.int64]
    points: Array


def evaluate_run(run: str | Path, truth_file: str | Path) -> dict[str, Any]:
    """Compare the trajectories of ``run`` with the truth; write ``evaluation.json`` there and return it.

    Raises `InputFileError` where ``run`` is not a run, `TrajectoryError` where the truth does not fit.
    """
    run = Path(run)
    found = load_trajectories(run)
    truth = read_truth(truth_file)
    evaluation: dict[str, Any] = {"truth": str(truth_file), "unit": "m"}
    evaluation["trajectories"] = {name: _compared(estimate, truth) for name, estimate in found.items()}
    evaluation["realtime"] = coverage(found)
    with written_whole(run / "evaluation.json") as temporary:
        temporary.write_text(json.dumps(evaluation, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return evaluation


def load_trajectories(run: str | Path) -> dict[str, Trajectory]:
    """The trajectories of a run directory by name; raises `InputFileError` where there is none."""
    run = Path(run)
    found = {name: Trajectory.load_tum(run / f"{name}.tum") for name in TRAJECTORIES if (run / f"{name}.tum").is_file()}
    if not found:
        raise InputFileError("holds no trajectory.tum", file=run, mend="give the --out directory of `semmap localize`")
    return found


def read_truth(path: str | Path) -> Trajectory | CheckPoints:
    """The truth by its file's name: ``.csv`` holds check points, anything else is a TUM trajectory."""
    if Path(path).suffix.lower() == ".csv":
        return read_check_points(path)
    truth = Trajectory.load_tum(path)
    if not len(truth):
        raise TrajectoryError("holds no poses", file=path, mend="give the true trajectory")
    return truth


def read_check_points(path: str | Path) -> CheckPoints:
    """Check points from a CSV: columns ``time`` (or ``stamp``, seconds), ``x, y, z`` and maybe ``name``."""
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            rows = [{key.strip().lower(): value for key, value in row.items() if key} for row in csv.DictReader(file)]
    except (OSError, UnicodeDecodeError) as reason:
        raise TrajectoryError(f"cannot be read ({reason})", file=path, mend="check the path") from None
    names, stamps, points = [], [], []
    for number, row in enumerate(rows, 2):
        try:
            stamps.append(stamp_ns_of_text((row["time"] if "time" in row else row["stamp"]).strip()))
            points.append([float(row[axis]) for axis in "xyz"])
        except (KeyError, TypeError, ValueError, AttributeError):
            raise TrajectoryError(
                "is not a check point",
                file=path,
                field=f"line {number}",
                mend="columns: time,x,y,z and maybe name",
            ) from None
        names.append((row.get("name") or str(number - 1)).strip())
    if not points or not np.isfinite(points).all():
        raise TrajectoryError("holds no finite check points", file=path, mend="columns: time,x,y,z and maybe name")
    return CheckPoints(tuple(names), np.array(stamps, np.int64), np.array(points))


def _compared(estimate: Trajectory, truth: Trajectory | CheckPoints) -> dict[str, Any]:
    if isinstance(truth, CheckPoints):
        return _compare_points(estimate, truth)
    return _compare_trajectory(estimate, truth)


def _compare_trajectory(estimate: Trajectory, truth: Trajectory) -> dict[str, Any]:
    """All figures of one trajectory: errors as it stands in the map, or else from the true start."""
    row: dict[str, Any] = {"frame": estimate.frame, "poses": len(estimate)}
    pairs = metrics.associate(estimate, truth)
    row["compared"] = len(pairs)
    if not len(pairs):
        return row
    row["flown_m"] = float(pairs.distance_flown()[-1])
    in_map = pairs if estimate.frame == MAP_FRAME else pairs.aligned(metrics.start_alignment(pairs))
    row["absolute" if estimate.frame == MAP_FRAME else "from_start"] = _errors(in_map)
    row["aligned"] = _errors(pairs.aligned(metrics.best_alignment(pairs)))
    row["relative"] = metrics.relative_errors(pairs)
    row["rep_percent"] = metrics.rep(in_map)
    return row


def _errors(pairs: metrics.Pairs) -> dict[str, dict[str, float]]:
    return {
        "position_m": metrics.Statistics.of(pairs.position_errors()).as_dict(),
        "rotation_deg": metrics.Statistics.of(pairs.rotation_errors_deg()).as_dict(),
    }


def _compare_points(estimate: Trajectory, truth: CheckPoints) -> dict[str, Any]:
    """AvgErr and TotalErr of paper 000: mean and sum of the distances at the check points, in the map."""
    row: dict[str, Any] = {"frame": estimate.frame, "poses": len(estimate)}
    if estimate.frame != MAP_FRAME:
        return row
    errors = metrics.point_errors(estimate, truth.stamps_ns, truth.points)
    known = errors[np.isfinite(errors)]
    row["check_points"] = {
        "errors": {name: float(e) if np.isfinite(e) else None for name, e in zip(truth.names, errors, strict=True)},
        "AvgErr": float(known.mean()) if len(known) else None,
        "TotalErr": float(known.sum()) if len(known) else None,
        "compared": len(known),
    }
    return row


def coverage(found: Mapping[str, Trajectory]) -> dict[str, float | None]:
    """How much of the run had a map pose at once: percent of the scans, and seconds until the first one."""
    scans, realtime = found.get("odometry"), found.get("realtime")
    if scans is None or realtime is None or not len(scans):
        return {"scans_covered_percent": None, "first_fix_s": None}
    known = realtime.stamps_ns if realtime.frame == MAP_FRAME else realtime.stamps_ns[:0]
    first = float((known[0] - scans.stamps_ns[0]) * 1e-9) if len(known) else None
    return {"scans_covered_percent": 100.0 * len(known) / len(scans), "first_fix_s": first}


WAYS = {"absolute": "as it is", "from_start": "from start", "aligned": "fitted"}
"""How errors were taken: without alignment; put on the true start; fitted to the truth."""


def evaluation_table(evaluation: Mapping[str, Any]) -> Table:
    """The evaluation as a table for the terminal, errors in metres."""
    points = any("check_points" in row for row in evaluation["trajectories"].values())
    return _point_table(evaluation) if points else _trajectory_table(evaluation)


def error_rows(evaluation: Mapping[str, Any]) -> list[list[str]]:
    """One row a trajectory and way of taking its errors; the columns are `ERROR_HEAD`."""
    rows = []
    for name, row in evaluation["trajectories"].items():
        for way in [way for way in WAYS if way in row]:
            position, rotation = row[way]["position_m"], row[way]["rotation_deg"]
            cells = [f"{position[key]:.3f}" for key in ("max", "rmse", "mean", "median", "p95")]
            rows.append([name, WAYS[way], *cells, f"{rotation['rmse']:.3f}"])
    return rows


DRIFT_HEAD = ("trajectory", "stretch [m]", "stretches", "of its length [%]", "turned [°/100 m]")


def drift_rows(evaluation: Mapping[str, Any]) -> list[list[str]]:
    """Relative errors, one row a trajectory and length of the stretches; the columns are `DRIFT_HEAD`."""
    return [
        [name, f"{one['length_m']:g}", str(one["segments"]), f"{one['translation_percent']:.3f}",
         f"{one['rotation_deg_per_100m']:.3f}"]
        for name, row in evaluation["trajectories"].items()
        for one in row.get("relative", [])
    ]  # fmt: skip


ERROR_HEAD = ("trajectory", "how", "max", "RMSE", "mean", "median", "p95", "RMSE [°]")


def _trajectory_table(evaluation: Mapping[str, Any]) -> Table:
    title = f"position error [m] against {Path(evaluation['truth']).name}"
    return text_table(ERROR_HEAD, error_rows(evaluation), title=title, left=2)


def _point_table(evaluation: Mapping[str, Any]) -> Table:
    rows = []
    for name, row in evaluation["trajectories"].items():
        points = row.get("check_points", {})
        figures = [points.get("AvgErr"), points.get("TotalErr")]
        cells = ["–" if figure is None else f"{figure:.3f}" for figure in figures]
        rows.append([name, row["frame"], str(points.get("compared", 0)), *cells])
    title = f"error at the check points of {Path(evaluation['truth']).name} [m]"
    return text_table(("trajectory", "frame", "check points", "AvgErr", "TotalErr"), rows, title=title, left=2)


def coverage_line(evaluation: Mapping[str, Any]) -> str:
    """One sentence on when the run knew where it was."""
    covered, first = evaluation["realtime"]["scans_covered_percent"], evaluation["realtime"]["first_fix_s"]
    if covered is None:
        return "realtime.tum or odometry.tum is missing: coverage unknown"
    if first is None:
        return "no map pose in real time: the run never knew where it was on the map"
    return f"map pose in real time: {covered:.1f} % of the scans, the first after {first:.1f} s"
