"""What the pages show, as tables for other programs."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from localize.settings import LocalizeSettings
from semmap.geometry import Array
from semmap.intersections import SemanticMap
from tools.evaluate import DRIFT_HEAD, ERROR_HEAD, drift_rows, error_rows
from tools.files import write_text
from tools.info import INTERSECTION_HEAD, intersection_rows
from tools.report.comparison import COMPARISON_HEAD, compared, comparison_rows, point_head, point_rows
from tools.report.events import event_tables
from tools.report.journeys import NEVER
from tools.report.likeness import Likeness, told_by
from tools.report.run_files import RunFiles
from tools.report.run_tracks import associated, consistency, distance_travelled, placed_trajectories

Rows = Iterable[Sequence[Any]]

_ALL_EVENTS = 10**9


def write_csv(path: Path, head: Sequence[str], rows: Rows) -> None:
    """A table with a head. Words that a spreadsheet would take for a formula get a quote in front."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([_harmless(cell) for cell in row] for row in rows)
    write_text(path, text.getvalue())


def _harmless(cell: Any) -> Any:
    if isinstance(cell, float) and not np.isfinite(cell):
        return ""
    if isinstance(cell, str) and cell[:1] in tuple("=+-@\t\r") and not re.fullmatch(r"[-+]?[\d.]+(e[-+]?\d+)?", cell):
        return f"'{cell}"
    return cell


def write_database_tables(
    directory: Path, semantic_map: SemanticMap, likeness: Likeness, settings: LocalizeSettings
) -> None:
    """``intersections.csv``, ``similarity_pwcv.csv``, ``similarity_cwc.csv``, ``look_alikes.csv``, ``anchors.csv``."""
    ids = semantic_map.columns.id
    write_csv(directory / "intersections.csv", INTERSECTION_HEAD, intersection_rows(semantic_map))
    for name in ("pwcv", "cwc"):
        values: Array = getattr(likeness, name)
        rows = ([id, *row] for id, row in zip(ids[likeness.rows].tolist(), values.round(4).tolist(), strict=True))
        write_csv(directory / f"similarity_{name}.csv", ["id", *map(str, ids[likeness.rows].tolist())], rows)
    head = ("id_a", "id_b", "yaw_deg", "pwcv", "cwc", "rock_likeness", "passed_until_told", "told_apart_by")
    pairs = (
        (
            ids[p.a], ids[p.b], round(np.degrees(p.yaw), 2), round(p.pwcv, 4), round(p.cwc, 4), round(p.rock, 4),
            p.passed if p.passed < NEVER else "never", told_by(p, settings),
        )
        for p in likeness.pairs
    )  # fmt: skip
    write_csv(directory / "look_alikes.csv", head, pairs)
    levels = [
        (one.name, len(one.pairs), len(one.anchors.intersections), one.anchors.exact, one.anchors.least,
         " ".join(map(str, one.anchors.intersections)))
        for one in likeness.levels
    ]  # fmt: skip
    write_csv(directory / "anchors.csv", ("looked_at", "pairs_left", "anchors", "fewest", "at_least", "ids"), levels)


def write_run_tables(directory: Path, run: RunFiles) -> None:
    """``errors.csv``, ``drift.csv``, ``errors_<trajectory>.csv``, ``consistency.csv``, ``events_<kind>.csv``."""
    placed = placed_trajectories(run)
    if "trajectories" in run.evaluation:
        write_csv(directory / "errors.csv", ERROR_HEAD, error_rows(run.evaluation))
        write_csv(directory / "drift.csv", DRIFT_HEAD, drift_rows(run.evaluation))
    for name, one in placed.items():
        pairs = associated(one, run.truth)
        if pairs is None or run.truth is None:
            continue
        way = np.interp(pairs.stamps_ns, run.truth.stamps_ns, distance_travelled(run.truth))
        off = pairs.estimate[:, :3, 3] - pairs.truth[:, :3, 3]
        columns = [_times(pairs.stamps_ns, run), way, *off.T, pairs.position_errors(), pairs.rotation_errors_deg()]
        head = ("time_s", "distance_m", "x_m", "y_m", "z_m", "position_m", "rotation_deg")
        write_csv(directory / f"errors_{name}.csv", head, np.column_stack(columns).round(5).tolist())
    told = consistency(run, placed)
    if told is not None:
        axes = ["rx_deg", "ry_deg", "rz_deg", "x_m", "y_m", "z_m"]
        head = ("time_s", *(f"error_{axis}" for axis in axes), *(f"sigma_{axis}" for axis in axes))
        rows = np.column_stack([_times(told.stamps_ns, run), told.errors, told.sigma]).round(6).tolist()
        write_csv(directory / "consistency.csv", head, rows)
    for table in event_tables(run.events, run.start_ns, _ALL_EVENTS):
        kind = re.sub(r"[^a-z0-9_]+", "_", table.kind.lower())[:60]
        write_csv(directory / f"events_{kind}.csv", table.columns, table.rows)


def _times(stamps_ns: Array, run: RunFiles) -> Array:
    times: Array = np.round((stamps_ns - run.start_ns) * 1e-9, 6)
    return times


def write_comparison_tables(directory: Path, files: Sequence[RunFiles]) -> None:
    """``comparison.csv`` and, where there are check points, ``check_points.csv``; and each run's own in a folder."""
    runs = compared(files)
    write_csv(directory / "comparison.csv", COMPARISON_HEAD, comparison_rows(runs))
    points = point_rows(runs)
    if points:
        write_csv(directory / "check_points.csv", point_head(runs), points)
    for number, run in enumerate(runs, 1):
        name = re.sub(r"[^\w.-]+", "_", run.name).lstrip(".")
        write_run_tables(directory / f"{number}_{name}"[:80], run.files)
