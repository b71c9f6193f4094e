"""The command line. Commands import what they need when they run, so that `semmap --help` answers at once."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

import semmap
from semmap.errors import SemmapError

if TYPE_CHECKING:
    from tools.settings import ToolSettings

ClickException: Any = typer.BadParameter.__mro__[2]
"""Base of the parser's errors, BadParameter < UsageError < ClickException; typer exports only the first."""

USER_ERROR, CRASH, INTERRUPTED = 2, 1, 130
"""Exit status: wrong input or usage; a fault of semmap itself; Ctrl-C."""

COMMON_FLAGS = ("-v", "--verbose", "--dump-config", "--version")
COMMON_VALUES = ("--config", "--seed")
EPILOG = "On every command: --config FILE, --seed N, --dump-config, -v (see `semmap --help`)."


def common_options_first(args: Sequence[str]) -> list[str]:
    """The common options moved before the command's name, so that they may stand anywhere before a ``--``."""
    first: list[str] = []
    rest: list[str] = []
    words = iter(args)
    for word in words:
        if word == "--":
            return [*first, *rest, word, *words]
        if word in COMMON_FLAGS or word.startswith(tuple(f"{option}=" for option in COMMON_VALUES)):
            first.append(word)
        elif word in COMMON_VALUES:
            first += [word, *([value] if (value := next(words, None)) is not None else [])]
        else:
            rest.append(word)
    return [*first, *rest]


class _CommonOptionsAnywhere(TyperGroup):
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return list(super().parse_args(ctx, common_options_first(args)))


app = typer.Typer(
    name="semmap",
    cls=_CommonOptionsAnywhere,
    help="Localize robots in underground mines against a semantic database of roadway intersections.",
    add_completion=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)


@dataclass(slots=True)
class _Common:
    """The common options of this call; `main` reads ``verbose`` after the parser is gone."""

    config: Path | None = None
    seed: int | None = None
    verbose: bool = False

    def settings(self) -> ToolSettings:
        from tools.settings import load_settings

        return load_settings(self.config, self.seed)


_common = _Common()


@app.callback(invoke_without_command=True)
def _common_options(
    ctx: typer.Context,
    config: Annotated[Path | None, typer.Option(metavar="FILE", help="Settings (YAML).")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of everything random.")] = None,
    dump_config: Annotated[bool, typer.Option("--dump-config", help="Print the settings in use and stop.")] = False,
    verbose: Annotated[bool, typer.Option("-v", "--verbose", help="Show log messages and tracebacks.")] = False,
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
) -> None:
    _common.config, _common.seed, _common.verbose = config, seed, verbose
    if version:
        typer.echo(f"semmap {semmap.__version__}")
        raise typer.Exit
    if dump_config:
        typer.echo(_common.settings().to_yaml(), nl=False)
        raise typer.Exit
    if ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())
        raise typer.Exit
    if verbose:
        logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s")


@app.command(epilog=EPILOG)
def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the files go.")] = Path("demo"),
) -> None:
    """Run the main job on a built-in simulated mine.

    Simulates, builds the database, localizes with and without it, evaluates, reports.
    """
    from tools.demo import run_demo

    run_demo(out, _common.settings())


@app.command(epilog=EPILOG)
def simulate(
    source: Annotated[str, typer.Argument(metavar="SCENARIO|MESH", help="A built-in mine, or a mesh file.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the files go.")],
    route: Annotated[Path | None, typer.Option(metavar="CSV", help="Way points x,y,z or x,y on the floor.")] = None,
    rig: Annotated[Path | None, typer.Option(metavar="FILE", help="The robot's sensors.")] = None,
) -> None:
    """Simulate a mine and a robot.

    Writes prior_map.laz, recording/, rig.yaml, ground_truth.tum and junctions.csv.
    """
    from tools.simulate import outcome, simulate_mine

    done = simulate_mine(source, out, _common.settings(), route=route, rig=rig)
    typer.echo(f"{outcome(done)}: {out}")


@app.command(epilog=EPILOG)
def build(
    maps: Annotated[list[Path], typer.Argument(metavar="MAP...", help="Point clouds: PCD, PLY, LAS, LAZ, COPC, E57.")],
    out: Annotated[Path, typer.Option(metavar="DB.h5", help="The semantic database to write.")],
    workers: Annotated[
        int, typer.Option(metavar="N", min=1, help="Processes on this machine (more than 1: Dask).")
    ] = 1,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Work on a Dask cluster instead (tcp://HOST:PORT), files on a shared disk."),
    ] = None,
    tile: Annotated[
        float, typer.Option(metavar="METRES", min=1, max=1000, help="Tiles of this size; the result is the same.")
    ] = 20.0,
) -> None:
    """Build the semantic database of a mine from its point-cloud map.

    The map may be larger than memory. What is finished is kept in DB.h5.work/ until all is done: after a crash or
    Ctrl-C the same command goes on from there.
    """
    from tools.build import build_database

    if scheduler is not None and workers > 1:
        raise typer.BadParameter("give --workers or --scheduler, not both")
    semantic_map = build_database(maps, out, _common.settings(), workers=workers, scheduler=scheduler, tile=tile)
    typer.echo(f"{len(semantic_map)} intersections: {out}")


@app.command(epilog=EPILOG)
def info(
    database: Annotated[Path, typer.Argument(metavar="DB.h5", help="A semantic database.")],
    every: Annotated[bool, typer.Option("--all", help="List every intersection, however many.")] = False,
) -> None:
    """Say what is in a semantic database."""
    from tools.info import print_info

    print_info(database, every=every)


@app.command(epilog=EPILOG)
def merge(
    a: Annotated[Path, typer.Argument(metavar="A.h5", help="The database that is kept up.")],
    b: Annotated[Path, typer.Argument(metavar="B.h5", help="A newer survey of the same mine, in the same frame.")],
    out: Annotated[Path, typer.Option(metavar="C.h5", help="The database to write.")],
    align: Annotated[bool, typer.Option("--align", help="Move B onto A by the shift found between them.")] = False,
    conflicts: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="All pairs and conflicts as JSON; by default C.merge.json beside C.h5."),
    ] = None,
) -> None:
    """Merge two surveys of one mine.

    Intersections of both are recognised and keep A's ids, new ones and new roadways are added; where the surveys do
    not agree, a table says what was kept and why.
    """
    from tools.merge import merge_databases, outcome, print_merge

    result, record = merge_databases(a, b, out, _common.settings(), align=align, record=conflicts)
    print_merge(result, record)
    typer.echo(f"{outcome(result)}: {out}")


@app.command(epilog=EPILOG)
def export(
    database: Annotated[Path, typer.Argument(metavar="DB.h5", help="A semantic database.")],
    geojson: Annotated[Path | None, typer.Option(metavar="FILE", help="Points and lines, for maps and GIS.")] = None,
    graphml: Annotated[Path | None, typer.Option(metavar="FILE", help="The roadway graph, for graph tools.")] = None,
) -> None:
    """Write a semantic database for other programs, in map coordinates."""
    from tools.export import export_database, outcome

    semantic_map = export_database(database, geojson=geojson, graphml=graphml)
    written = ", ".join(str(file) for file in (geojson, graphml) if file is not None)
    typer.echo(f"{outcome(semantic_map)}: {written}")


@app.command(epilog=EPILOG)
def localize(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="rosbag1 .bag, or rosbag2 sqlite3 or MCAP.")],
    rig: Annotated[Path, typer.Option(metavar="rig.yaml", help="The robot's sensors.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the files of the run go.")],
    database: Annotated[Path | None, typer.Option("--map", metavar="DB.h5", help="The semantic database.")] = None,
    prism: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The total station's own fixes: CSV time,x,y,z or Leica GSI.")
    ] = None,
    without: Annotated[
        str,
        typer.Option(
            metavar="LIST",
            help="Leave out, comma-separated: uwb,wheel,prism,lidar,intersections,inertial-enhancement.",
        ),
    ] = "",
    live: Annotated[bool, typer.Option("--live", help="Play it at its own pace, as a robot would.")] = False,
) -> None:
    """Localize a recording.

    Writes trajectory.tum, realtime.tum, odometry.tum, events.jsonl, overlays.h5, uncertainty.csv, timing.csv,
    summary.json and settings.yaml.
    """
    from tools.progress import progress_bar
    from tools.run import localize_recording, outcome

    names = [name.strip() for name in without.split(",") if name.strip()]
    settings = _common.settings()
    with progress_bar("localizing") as progress:
        summary = localize_recording(
            recording,
            rig,
            out,
            map_file=database,
            prism_file=prism,
            without=names,
            settings=settings,
            live=live,
            progress=progress,
        )
    typer.echo(f"{outcome(summary)}: {out}")


@app.command("map", epilog=EPILOG)
def map_command(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="rosbag1 .bag, or rosbag2 sqlite3 or MCAP.")],
    rig: Annotated[Path, typer.Option(metavar="rig.yaml", help="The robot's sensors.")],
    out: Annotated[Path, typer.Option(metavar="map.laz", help="The point-cloud map to write.")],
    database: Annotated[
        Path | None, typer.Option(metavar="DB.h5", help="Build its semantic database, too, as `semmap build` does.")
    ] = None,
    without: Annotated[
        str, typer.Option(metavar="LIST", help="Leave out, comma-separated: uwb,wheel,prism,intersections.")
    ] = "",
) -> None:
    """Make the map of a mine from a recording alone.

    Intersections that the robot passes again close loops. The map is level, in the frame of the rig's UWB anchors or
    total station, else in a frame of its own.
    """
    from tools.mapping import map_recording, outcome

    names = [name.strip() for name in without.split(",") if name.strip()]
    made = map_recording(recording, rig, out, _common.settings(), database=database, without=names)
    typer.echo(f"{outcome(made)}: {out}" + (f", {database}" if database is not None else ""))


@app.command("calibrate-imu", epilog=EPILOG)
def calibrate_imu(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="With a minute or more at rest.")],
    rig: Annotated[Path, typer.Option(metavar="rig.yaml", help="The robot's sensors.")],
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Another rig file to write instead.")] = None,
) -> None:
    """Find an IMU's noise from a stretch at rest, and write it into the rig file.

    Engines may run; the stretch is found by itself. Ten minutes tell the bias walks, one minute hardly.
    """
    from tools.calibrate import calibrate_recording, report_lines
    from tools.progress import progress_bar

    target = rig if out is None else out
    with progress_bar("reading") as progress:
        found = calibrate_recording(recording, rig, target, progress=progress)
    for line in report_lines(found):
        typer.echo(line)
    typer.echo(f"noise of the imu: {target}")


@app.command(epilog=EPILOG)
def evaluate(
    run: Annotated[Path, typer.Argument(metavar="DIR", help="The --out directory of `semmap localize`.")],
    truth: Annotated[Path, typer.Option(metavar="FILE", help="ground_truth.tum, or check points .csv.")],
) -> None:
    """Compare a run with the truth.

    Prints a table and writes evaluation.json into DIR.
    """
    from rich.console import Console

    from tools.evaluate import coverage_line, evaluate_run, evaluation_table

    evaluation = evaluate_run(run, truth)
    Console().print(evaluation_table(evaluation))
    typer.echo(coverage_line(evaluation))


@app.command(epilog=EPILOG)
def report(
    sources: Annotated[
        list[Path], typer.Argument(metavar="DB.h5|DIR...", help="A semantic database, or directories of runs.")
    ],
    out: Annotated[Path | None, typer.Option(metavar="report.html", help="The page to write.")] = None,
    figures: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Its figures for print, as PNG (300 dpi) and SVG.")
    ] = None,
    tables: Annotated[Path | None, typer.Option("--csv", metavar="DIR", help="Its tables as CSV.")] = None,
    rerun: Annotated[
        Path | None, typer.Option(metavar="FILE.rrd", help="A run for the Rerun viewer (pip install rerun-sdk).")
    ] = None,
    database: Annotated[
        Path | None, typer.Option("--map", metavar="DB.h5", help="The run's database, if it has moved.")
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option(metavar="RECORDING", help="The run's recording: its IMU is shown, too, and --rerun looks here."),
    ] = None,
) -> None:
    """Write an HTML page about a database or a run, or one that compares runs.

    One file that needs no network.
    """
    from tools.progress import progress_bar
    from tools.report import Wanted, write_report

    wanted = Wanted(out, figures, tables, rerun)
    with progress_bar("reporting") as progress:
        write_report(sources, wanted, _common.settings(), map_file=database, recording=recording, progress=progress)
    typer.echo(f"report: {', '.join(str(path) for path in (out, figures, tables, rerun) if path is not None)}")


@app.command(epilog=EPILOG)
def view(
    source: Annotated[Path, typer.Argument(metavar="DB.h5|DIR|MAP", help="A database, a run, or a point cloud.")],
    screenshot: Annotated[
        Path | None, typer.Option(metavar="PNG", help="Take a picture off-screen instead of opening a window.")
    ] = None,
    intersection: Annotated[
        int | None, typer.Option(metavar="ID", min=0, help="Only this one of a database, with all its points.")
    ] = None,
) -> None:
    """Look at a database, a run or a map in three dimensions."""
    from tools.view import view_source

    view_source(source, screenshot=screenshot, intersection=intersection)
    if screenshot is not None:
        typer.echo(f"picture: {screenshot}")


def main(args: Sequence[str] | None = None) -> None:
    """Entry point of `semmap`: runs a command and exits with its status."""
    sys.exit(run(sys.argv[1:] if args is None else args))


def run(args: Sequence[str]) -> int:
    """Run one command; what a user can mend becomes one line on standard error and status 2."""
    try:
        status = app(args=list(args), prog_name="semmap", standalone_mode=False)
    except SemmapError as error:
        return _complain(str(error), USER_ERROR)
    except ClickException as error:
        return _complain(error.format_message().rstrip("."), USER_ERROR)
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except Exception as error:
        if _common.verbose:
            raise
        fault = f"{type(error).__name__}: {error}".splitlines()[0]
        return _complain(f"fault in semmap ({fault}); run again with -v and report the traceback", CRASH)
    return status if isinstance(status, int) else 0


def _complain(text: str, status: int) -> int:
    if _common.verbose and (cause := sys.exc_info()[1]) is not None:
        logging.getLogger("semmap").info("raised by", exc_info=cause)
    line = " ".join(text.split())
    sys.stderr.write(f"semmap: error: {line}\n")
    return status


if __name__ == "__main__":
    main()
