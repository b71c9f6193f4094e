"""The main job end to end on a built-in simulated mine: `semmap demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tools.build import build_database
from tools.evaluate import evaluate_run
from tools.progress import progress_bar
from tools.report import Wanted, write_report
from tools.run import cost_text, localize_recording
from tools.settings import ToolSettings
from tools.simulate import simulate_mine
from tools.tables import text_table

SCENARIO = "demo"

RUNS = {"with_database": "with the database", "without_database": "without it"}
"""Directory of a run -> what it is called in the table."""


def run_demo(out: Path, settings: ToolSettings) -> None:
    """Simulate a mine, build its database, localize with and without it, evaluate, report; all in ``out``."""
    console = Console(highlight=False, markup=False, soft_wrap=True)
    mine, database, report = out / "mine", out / "mine.h5", out / "report.html"
    simulate_mine(SCENARIO, mine, settings)
    semantic_map = build_database([mine / "prior_map.laz"], database, settings)
    console.print(f"semantic database: {len(semantic_map)} intersections ({database})")
    write_report([database], Wanted(out / "mine.html"), settings)
    used = {"with_database": database, "without_database": None}
    runs = {name: _run(mine, out / name, used[name], settings) for name in RUNS}
    Console().print(comparison(runs))
    write_report([out / "with_database"], Wanted(report), settings)
    write_report([out / name for name in RUNS], Wanted(out / "comparison.html"), settings)
    console.print(f"report: {report}")


def _run(mine: Path, out: Path, database: Path | None, settings: ToolSettings) -> dict[str, Any]:
    """Localize and evaluate once: the run's summary with its evaluation in it."""
    with progress_bar(f"localizing {RUNS[out.name]}") as progress:
        summary = localize_recording(
            mine / "recording",
            mine / "rig.yaml",
            out,
            map_file=database,
            settings=settings,
            progress=progress,
        )
    return {**summary, "evaluation": evaluate_run(out, mine / "ground_truth.tum")}


def comparison(runs: dict[str, dict[str, Any]]) -> Table:
    """One row a run: error, intersections recognised, cost."""
    head = ("", "RMSE [m]", "max [m]", "intersections recognised", "ms per scan")
    rows = [
        [RUNS[name], *_error_cells(run), str(len(run["intersections_recognised"])), cost_text(run)]
        for name, run in runs.items()
    ]
    return text_table(
        head, rows, title="position error on the simulated mine (without the database: from the true start)"
    )


def _error_cells(run: dict[str, Any]) -> tuple[str, str]:
    row = run["evaluation"]["trajectories"]["trajectory"]
    errors = row.get("absolute") or row.get("from_start")
    if errors is None:
        return "no pose", "no pose"
    return f"{errors['position_m']['rmse']:.3f}", f"{errors['position_m']['max']:.3f}"
