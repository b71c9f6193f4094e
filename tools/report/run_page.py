"""The page about a run: where it went, how well, what it recognised and why, what it cost."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from semmap.errors import TrajectoryError
from semmap.geometry import Array
from semmap.trajectory import Trajectory
from tools.evaluate import ERROR_HEAD, MAP_FRAME, TRAJECTORIES, error_rows
from tools.metrics import Pairs, associate, start_alignment
from tools.report.covariance import covariance_over_distance, ellipses_along_track
from tools.report.events import accepted_intersections, cell, event_tables, state_bands
from tools.report.figures import BLUE, FAINT, GREEN, INK, ORANGE
from tools.report.page import facts, figure, folded, note, page, section, table
from tools.report.plan import Track, plan
from tools.report.run_files import RunFiles
from tools.report.series import Line, errors_over_time, mode_bands, position_over_time, seconds

COLOURS = {"trajectory": BLUE, "realtime": GREEN, "odometry": ORANGE}
TITLES = {"trajectory": "final trajectory", "realtime": "in real time", "odometry": "odometry alone"}


def run_page(run: RunFiles) -> str:
    """The page (HTML) about a run."""
    placed = place_odometry(run)
    return page(
        f"Run {run.name}",
        f"recording {Path(str(run.summary.get('recording', '?'))).name}, "
        f"database {Path(run.summary['map']).name if run.summary.get('map') else 'none'}",
        facts(headline(run)),
        section("Plan", _plan(run, placed)),
        section("Position over time", _positions(run, placed)),
        section("Errors", _error_table(run.evaluation), _errors(run, placed), _point_rows(run.evaluation)),
        section("How well the position was known", _covariances(run)),
        section("State", _states(run)),
        *(section(title, rows) for title, rows in event_tables(run.events, run.start_ns)),
        section("What computed this", _costs(run.summary), folded("settings as used", run.settings)),
    )


def headline(run: RunFiles) -> dict[str, str]:
    """The figures one looks for first."""
    s = run.summary
    figures = {"scans": s.get("scans"), "keyframes": s.get("keyframes")}
    values = {name: str(value) for name, value in figures.items() if value is not None}
    if s.get("map"):
        values["intersections recognised"] = str(len(s.get("intersections_recognised", ())))
    if s.get("ms_per_scan_median") is not None:
        values["ms per scan, median"] = f"{s['ms_per_scan_median']:.0f}"
    row = run.evaluation.get("trajectories", {}).get("trajectory", {})
    if "absolute" in row:
        values["RMSE, no alignment"] = f"{row['absolute']['position_m']['rmse']:.3f} m"
        values["largest error"] = f"{row['absolute']['position_m']['max']:.3f} m"
    first = run.evaluation.get("realtime", {}).get("first_fix_s")
    if first is not None:
        values["first place in the map after"] = f"{first:.0f} s"
    return values


def place_odometry(run: RunFiles) -> dict[str, Trajectory]:
    """The trajectories on one plan: those in another frame are put where the truth, or the result, begins."""
    in_map = {name: one for name, one in run.trajectories.items() if one.frame == MAP_FRAME and len(one)}
    reference = run.truth if run.truth is not None and len(run.truth) else in_map.get("trajectory")
    placed = {}
    for name, one in run.trajectories.items():
        if one.frame == MAP_FRAME or reference is None or not len(one):
            placed[name] = one
            continue
        pairs = _associated(one, reference)
        placed[name] = (
            one if pairs is None else Trajectory(one.frame, one.stamps_ns, start_alignment(pairs) @ one.poses)
        )
    return placed


def _associated(estimate: Trajectory, reference: Trajectory) -> Pairs | None:
    try:
        pairs = associate(estimate, reference)
    except TrajectoryError:  # no time in common: nothing to compare
        return None
    return pairs if len(pairs) else None


def _plan(run: RunFiles, placed: Mapping[str, Trajectory]) -> str:
    tracks = [Track("truth", run.truth.positions, FAINT, dashed=True)] if run.truth is not None else []
    shown = [name for name in TRAJECTORIES if name in placed and len(placed[name])]
    if "trajectory" in shown:
        shown = [name for name in shown if name != "realtime"]
    for name in reversed(shown):
        tracks.append(Track(TITLES[name], placed[name].positions, COLOURS[name], dashed=name == "odometry"))
    if run.semantic_map is None and not tracks:
        return note("Nothing to draw: no pose and no database.")
    recognised = accepted_intersections(run.events)
    caption = "Odometry, where it has a frame of its own, is put where the truth or the final trajectory begins."
    return figure(plan(run.semantic_map, tracks, recognised=recognised), caption)


def _positions(run: RunFiles, placed: Mapping[str, Trajectory]) -> str:
    start = run.start_ns
    lines = [
        Line(
            TITLES[name],
            seconds(one.stamps_ns, start),
            one.positions,
            COLOURS[name],
            dashed=name == "odometry",
        )
        for name in reversed(TRAJECTORIES)
        if name in placed and len(one := placed[name])
    ]
    if run.truth is not None and len(run.truth):
        lines.insert(0, Line("truth", seconds(run.truth.stamps_ns, start), run.truth.positions, INK))
    if not lines:
        return note("No pose at any time.")
    caption = "Red marks: an intersection was accepted." if _pins(run) else ""
    return figure(position_over_time(lines, _pins(run)), caption)


def _pins(run: RunFiles) -> list[float]:
    """Seconds at which an intersection was accepted."""
    stamps = [event["stamp_ns"] for event in run.events if event.get("accepted") is True]
    return [(stamp - run.start_ns) * 1e-9 for stamp in stamps]


def _errors(run: RunFiles, placed: Mapping[str, Trajectory]) -> str:
    if run.truth is None:
        return ""
    curves: list[tuple[str, Array, Array, str]] = []
    for name, one in placed.items():
        pairs = _associated(one, run.truth) if len(one) else None
        if pairs is not None:
            curves.append(
                (TITLES[name], seconds(pairs.stamps_ns, run.start_ns), pairs.position_errors(), COLOURS[name])
            )
    return figure(errors_over_time(curves, _pins(run))) if curves else ""


def _error_table(evaluation: Mapping[str, Any]) -> str:
    if "trajectories" not in evaluation:
        return ""
    return note("Position errors in metres.") + table(ERROR_HEAD, error_rows(evaluation), text=ERROR_HEAD[:2])


def _point_rows(evaluation: Mapping[str, Any]) -> str:
    """Errors at the check points, one row a point and one column a trajectory."""
    found = evaluation.get("trajectories", {})
    points = {name: row["check_points"] for name, row in found.items() if "check_points" in row}
    names = next((list(one["errors"]) for one in points.values()), [])
    rows = [[name, *(cell(one["errors"][name]) for one in points.values())] for name in names]
    rows += [[key, *(cell(one[key]) for one in points.values())] for key in ("AvgErr", "TotalErr") if points]
    return table(["check point, error [m]", *points], rows)


def _covariances(run: RunFiles) -> str:
    """The figures of paper 000 on covariance, along the track that it is the covariance of."""
    known = run.uncertainty
    track = run.trajectories.get("realtime" if known is not None and known.frame == MAP_FRAME else "odometry")
    if known is None or track is None or len(track) < 2:
        return ""
    known = known.at(track.stamps_ns)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(track.positions, axis=0), axis=1))])
    return figure(covariance_over_distance(known, way), "Bands: the mode, see State.") + figure(
        ellipses_along_track(known, track.positions)
    )


def _states(run: RunFiles) -> str:
    ends = [int(one.stamps_ns[-1]) for one in run.trajectories.values() if len(one)]
    rows = state_bands(run.events, run.start_ns, max(ends, default=run.start_ns))
    return figure(mode_bands(rows)) if rows else ""


def _costs(summary: Mapping[str, Any]) -> str:
    rows = []
    for key in ("ms_per_scan_median", "ms_per_scan_p95", "wall_s", "peak_memory_mb"):
        if isinstance(summary.get(key), int | float):
            rows.append([key, f"{summary[key]:.1f}"])
    rows += [[f"version of {name}", version] for name, version in summary.get("versions", {}).items()]
    rows += [["recording", str(summary.get("recording"))], ["rig", str(summary.get("rig"))]]
    return table(["what", "value"], rows)
