"""Several runs side by side: errors, figures (paper 004, Fig. 9, 10, 18, Table I; paper 000, Fig. 6, 8, Table II)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from semmap.geometry import Array
from semmap.intersections import SemanticMap
from semmap.trajectory import Trajectory
from tools.evaluate import MAP_FRAME, WAYS
from tools.metrics import point_errors
from tools.report.colours import RUNS, TRACKS
from tools.report.figures import Drawing, logarithmic, look
from tools.report.plan import Track, error_maps, plan
from tools.report.run_files import RunFiles
from tools.report.run_tracks import (
    associated,
    check_point_line,
    distance_travelled,
    main_track,
    placed_trajectories,
    position_errors,
)
from tools.report.series import Line, drawn_rows, errors_over_time, errors_over_way, seconds, three_over_time

COMPARISON_HEAD = (
    "run", "taken", "MAE [m]", "RMSE [m]", "mean [m]", "p95 [m]", "REP-1 [%]", "REP-2 [%]", "REP-3 [%]", "REP-4 [%]",
    "REP-5 [%]", "recognised", "place after [s]", "ms per scan", "p95 [ms]", "memory [MB]",
)  # fmt: skip
"""MAE is the greatest error, as in paper 004."""


@dataclass(frozen=True, slots=True, eq=False)
class ComparedRun:
    """A run among others: a name of its own, its colour, and the trajectory that stands for it, or None."""

    name: str
    colour: str
    files: RunFiles
    track: Trajectory | None


def compared(runs: Sequence[RunFiles]) -> list[ComparedRun]:
    """The runs with a name and a colour each."""
    found, taken = [], set[str]()
    for run, colour in zip(runs, cycle(RUNS), strict=False):
        name, again = run.name, 2
        while name in taken:
            name, again = f"{run.name} ({again})", again + 1
        taken.add(name)
        placed = placed_trajectories(run)
        main = main_track(placed)
        found.append(ComparedRun(name, colour, run, None if main is None else placed[main]))
    return found


def common_map(runs: Sequence[ComparedRun]) -> SemanticMap | None:
    """The first database that one of them used."""
    return next((run.files.semantic_map for run in runs if run.files.semantic_map is not None), None)


def common_truth(runs: Sequence[ComparedRun]) -> Trajectory | None:
    """The first truth that one of them was compared with."""
    return next((run.files.truth for run in runs if run.files.truth is not None and len(run.files.truth)), None)


def comparison_rows(runs: Sequence[ComparedRun]) -> list[list[str]]:
    """One row a run: the columns of `COMPARISON_HEAD` (paper 004, Table I)."""
    rows = []
    for run in runs:
        row = run.files.evaluation.get("trajectories", {}).get("trajectory", {})
        way = next((way for way in WAYS if way in row), None)
        errors = row[way]["position_m"] if way is not None else {}
        figures = [_text(errors.get(key), 3) for key in ("max", "rmse", "mean", "p95")]
        rep = [*row.get("rep_percent", []), *[None] * 5][:5]
        rows.append([run.name, WAYS[way] if way else "–", *figures, *(_text(value, 3) for value in rep), *_costs(run)])
    return rows


def _costs(run: ComparedRun) -> list[str]:
    s = run.files.summary
    first = run.files.evaluation.get("realtime", {}).get("first_fix_s")
    values = [(first, 1), (s.get("ms_per_scan_median"), 1), (s.get("ms_per_scan_p95"), 1), (s.get("peak_memory_mb"), 0)]
    return [str(len(s.get("intersections_recognised", ()))), *(_text(value, digits) for value, digits in values)]


def _text(value: Any, digits: int) -> str:
    return f"{value:.{digits}f}" if isinstance(value, int | float) else "–"


def point_head(runs: Sequence[ComparedRun]) -> list[str]:
    """Of the table of check points."""
    return ["check point, error [m]", *(run.name for run in runs)]


def point_rows(runs: Sequence[ComparedRun]) -> list[list[str]]:
    """Errors at the check points, their mean and sum: a column a run (paper 000, Table II; paper 004, Table II)."""
    told = [run.files.evaluation.get("trajectories", {}).get("trajectory", {}).get("check_points", {}) for run in runs]
    names = list(dict.fromkeys(name for one in told for name in one.get("errors", {})))
    rows = [[name, *(_text(one.get("errors", {}).get(name), 3) for one in told)] for name in names]
    return rows + [[key, *(_text(one.get(key), 3) for one in told)] for key in ("AvgErr", "TotalErr") if names]


def comparison_drawings(runs: Sequence[ComparedRun]) -> Iterator[Drawing]:
    """All figures of a comparison."""
    for group in (plans, over_time, over_distance):
        yield from group(runs)


def plans(runs: Sequence[ComparedRun]) -> Iterator[Drawing]:
    """Where they went, and how far off they were there."""
    semantic_map, truth = common_map(runs), common_truth(runs)
    tracks = [Track("truth", truth.positions, TRACKS["truth"], dashed=True)] if truth is not None else []
    tracks += [Track(run.name, run.track.positions, run.colour) for run in runs if run.track is not None]
    if tracks or semantic_map is not None:
        yield Drawing("trajectories", plan(semantic_map, tracks), "Trajectories (paper 004, Fig. 9).")
    maps = [
        Track(run.name, run.track.positions, run.colour, position_errors(run.track, truth))
        for run in runs
        if run.track is not None and associated(run.track, truth) is not None
    ]
    if maps:
        yield Drawing("error_maps", error_maps(semantic_map, maps), "Position errors on the plan (paper 004, Fig. 10).")


def over_time(runs: Sequence[ComparedRun]) -> Iterator[Drawing]:
    """Positions and errors over the time of the runs."""
    truth = common_truth(runs)
    lines = [
        Line(run.name, seconds(run.track.stamps_ns, run.files.start_ns), run.track.positions, run.colour)
        for run in runs
        if run.track is not None
    ]
    if not lines:
        return
    if truth is not None:
        times = seconds(truth.stamps_ns, runs[0].files.start_ns)
        lines.append(Line("truth", times, truth.positions, TRACKS["truth"], dashed=True))
    lines += next((dots for run in runs if (dots := check_point_line(run.files))), [])
    labels = ("x [m]", "y [m]", "z [m]")
    yield Drawing("position", three_over_time(lines, labels), "Position over time (paper 000, Fig. 6).", True)
    errors = [
        (run.name, seconds(pairs.stamps_ns, run.files.start_ns), pairs.position_errors(), run.colour)
        for run in runs
        if run.track is not None and (pairs := associated(run.track, truth)) is not None
    ]
    if errors:
        yield Drawing("errors", errors_over_time(errors), "", True)


def over_distance(runs: Sequence[ComparedRun]) -> Iterator[Drawing]:
    """Errors and variances over the distance travelled, and errors at the check points."""
    truth, curves = common_truth(runs), []
    for run in runs:
        pairs = associated(run.track, truth) if run.track is not None else None
        if pairs is not None and truth is not None:
            way = np.interp(pairs.stamps_ns, truth.stamps_ns, distance_travelled(truth))
            curves.append((run.name, way, pairs.position_errors(), run.colour))
    if curves:
        yield Drawing("errors_over_distance", errors_over_way(curves), "")
        yield Drawing("errors_shares", _shares(curves), "Share of the poses whose error is no greater.")
    if any(run.files.uncertainty is not None for run in runs):
        words = "Variances of the position over the distance travelled (paper 000, Fig. 8)."
        yield Drawing("covariance", _variances(runs), words)
    points = [_point_errors(run) for run in runs]
    if any(len(errors) for errors in points):
        words = "Errors at the check points, in their order (paper 004, Fig. 18)."
        yield Drawing("check_points", _check_points(runs, points), words)


def _point_errors(run: ComparedRun) -> Array:
    points = run.files.check_points
    if points is None or run.track is None or run.track.frame != MAP_FRAME:
        return np.zeros(0)
    return point_errors(run.track, points.stamps_ns, points.points)


def _shares(curves: Sequence[tuple[str, Array, Array, str]]) -> Figure:
    with look():
        fig = Figure(figsize=(9.5, 2.8))
        axes = fig.subplots()
        for name, _, errors, colour in curves:
            ordered = np.sort(errors)
            share = 100.0 * np.arange(1, len(ordered) + 1) / len(ordered)
            rows: NDArray[np.int64] = drawn_rows(ordered)
            axes.plot(np.maximum(ordered[rows], 1e-3), share[rows], color=colour, linewidth=1.3, label=name)
        logarithmic(axes.xaxis)
        axes.set_xlabel("position error [m]")
        axes.set_ylabel("poses [%]")
        fig.legend(loc="outside upper center", ncols=4)
        return fig


def _variances(runs: Sequence[ComparedRun]) -> Figure:
    with look():
        fig = Figure(figsize=(9.5, 4.6))
        panels = fig.subplots(2, 1, sharex=True)
        for run in runs:
            known = run.files.uncertainty
            name = "realtime" if known is not None and known.frame == MAP_FRAME else "odometry"
            track = run.files.trajectories.get(name)
            if known is None or track is None:
                continue
            known = known.at(track.stamps_ns)
            way = np.interp(known.stamps_ns, track.stamps_ns, distance_travelled(track)) if len(track) else np.zeros(0)
            for axes, axis in zip(panels, (0, 2), strict=True):
                variance = np.maximum(known.position[:, axis, axis], 1e-6)
                rows = drawn_rows(variance)
                axes.plot(
                    way[rows], variance[rows], color=run.colour, linewidth=1.3, label=f"{run.name}, {known.frame}"
                )
        for axes, axis in zip(panels, "xz", strict=True):
            logarithmic(axes.yaxis)
            axes.set_ylabel(f"variance of {axis} [m²]")
        panels[1].set_xlabel("distance travelled [m]")
        if panels[0].get_legend_handles_labels()[0]:
            fig.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
        return fig


def _check_points(runs: Sequence[ComparedRun], points: Sequence[Array]) -> Figure:
    with look():
        fig = Figure(figsize=(9.5, 2.8))
        axes = fig.subplots()
        names: tuple[str, ...] = ()
        for run, errors in zip(runs, points, strict=True):
            if len(errors):
                names = run.files.check_points.names if run.files.check_points is not None else ()
                axes.plot(
                    np.arange(len(errors)), errors, "o-", color=run.colour, markersize=4, linewidth=1.2, label=run.name
                )
        step = max(1, len(names) // 30)
        axes.set_xticks(range(0, len(names), step), names[::step], fontsize=7)
        logarithmic(axes.yaxis)
        axes.set_xlabel("check point")
        axes.set_ylabel("position error [m]")
        fig.legend(loc="outside upper center", ncols=4)
        return fig
