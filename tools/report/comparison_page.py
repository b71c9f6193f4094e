"""The page that compares several runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from semmap.geometry import Array
from tools.report.colours import TRACKS
from tools.report.comparison import (
    COMPARISON_HEAD,
    common_map,
    common_truth,
    compared,
    comparison_rows,
    over_distance,
    over_time,
    plans,
    point_head,
    point_rows,
)
from tools.report.pack import Blobs
from tools.report.page import figure, folded, note, page, place, section, table
from tools.report.plan_data import marks, plan_data, plan_origin
from tools.report.run_files import RunFiles
from tools.report.run_page import add_track, surveyed_points


def comparison_page(files: Sequence[RunFiles]) -> str:
    """The page (HTML) about some runs."""
    runs = compared(files)
    semantic_map, truth, blobs = common_map(runs), common_truth(runs), Blobs()
    drawn = [run.track.positions for run in runs if run.track is not None]
    origin = plan_origin(semantic_map, [*drawn, *([] if truth is None else [truth.positions])])
    tracks: list[dict[str, Any]] = []
    for number, run in enumerate(runs):
        if run.track is not None:
            add_track(blobs, str(number), run.track, run.files.start_ns, origin)
            tracks.append({"name": str(number), "title": run.name, "colour": run.colour})
    if truth is not None:
        add_track(blobs, "truth", truth, runs[0].files.start_ns, origin)
        tracks.append({"name": "truth", "title": "truth", "colour": TRACKS["truth"], "dashed": True})
    no_walls: Array = np.zeros((0, 2))
    data = {
        "plan": plan_data(semantic_map, origin, no_walls, blobs),
        "intersections": marks(semantic_map, origin),
        "tracks": tracks,
        "points": next((points for run in runs if (points := surveyed_points(run.files, origin))), []),
    }
    words = (
        "Of the final trajectory, as it stands in the map where it is in the map. MAE is the greatest error; REP-k the "
        "mean of error over distance on the first 20 k % of the way, in our reading of paper 004."
    )
    points = point_rows(runs)
    return page(
        f"Comparison of {len(runs)} runs",
        ", ".join(run.name for run in runs),
        section(
            "Errors and costs", table(COMPARISON_HEAD, comparison_rows(runs), text=COMPARISON_HEAD[:2]), note(words)
        ),
        section("At the check points", table(point_head(runs), points)) if points else "",
        section("Plan", place("plan")),
        section("Errors on the plan", *(figure(one) for one in plans(runs) if one.name == "error_maps")),
        section(
            "Over time",
            note("Point at a figure: the plan shows where the robots were then."),
            *map(figure, over_time(runs)),
        )
        if tracks
        else note("No pose at any time."),
        section("Over the distance travelled", *map(figure, over_distance(runs))),
        section("Settings", *(folded(f"settings of {run.name}", run.files.settings) for run in runs)),
        script="comparison",
        data=data,
        blobs=blobs,
    )
