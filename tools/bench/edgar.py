"""Pins on a long flight: errors with and without the map, the intersections passed, and starts anywhere (paper 004).

    python -m tools.bench.edgar --map MINE.h5 --mesh MINE.ply --route WAYPOINTS.csv --cache DIR --out DIR
    python -m tools.bench.edgar … --starts 100
    python -m tools.bench.edgar --mesh MINE.ply --route WAYPOINTS.csv --cache DIR --out DIR
    python -m tools.bench.edgar --mesh MINE.ply --route WAYPOINTS.csv --cache DIR --beside NAME=FILE.npz …

The recording is that of `tools.bench.odometry --recording mesh`: LiDAR and IMU, no wheel. With the map errors are in
the map frame without any alignment; without, after the best SE(3) fit. A pin is false if it puts its keyframe more than
0.3 m off. A pass is constrained if the intersection pins a keyframe within 12 m of it. Without a map the intersections
found on the way close loops; a view is false if it puts its intersection more than 0.3 m from where it was seen first.
Beside them stand the poses that `tools.bench.odometry_run`, `tools.bench.scan_context_loops` and `tools.bench.slam_run`
wrote of other systems, after the best SE(3) fit.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from localize import LocalizationResult, Localizer
from maps.build import build_semantic_map
from maps.prior_map import PriorMap
from semmap import database
from semmap.geometry import Array, transform
from semmap.intersections import SemanticMap
from semmap.measurements import ImuSample, Measurement, Scan
from semmap.rig import Rig
from semmap.trajectory import Trajectory
from tools.bench.odometry_cache import Recorded
from tools.bench.odometry_recordings import recorded
from tools.bench.own_map import loops_of, scan_map_points, surface_errors
from tools.files import write_text
from tools.metrics import Pairs, associate, best_alignment, rep
from tools.progress import progress_bar
from tools.run import process_facts
from tools.simulator import Mine, load_mesh
from tools.tables import text_table

FALSE_M = 0.3
PASS_M, REACH_M = 4.0, 12.0
_HEAD = ("", "max m", "RMSE m", *(f"REP-{k} %" for k in range(1, 6)))
BINS_M = (0.0, 10.0, 25.0, 50.0, 100.0, 200.0, 400.0)


@dataclass(frozen=True, slots=True)
class Passes:
    """What the intersections did: passes through stored ones, how many of them were constrained, pins, false ones."""

    passes: int
    constrained: int
    pins: int
    false: int


@dataclass(frozen=True, slots=True)
class Found:
    """One start: where [s], metres flown and intersections passed until a pose was published, and its error [m].

    found is false where the recording ended, or ``--metres-at-most`` were flown, without one.
    """

    start_s: float
    found: bool
    flown_m: float
    passed: int
    error_m: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--map", type=Path, help="the database; without it, the flight without a map")
    recording_arguments(parser)
    parser.add_argument("--starts", type=int, default=0, help="random starts instead of the whole flight")
    parser.add_argument("--metres-at-most", type=float, default=400.0, help="flown from each start")
    parser.add_argument("--beside", nargs="+", default=[], metavar="NAME=FILE", help="only rows of other systems")
    parser.add_argument("--out", type=Path, default=Path("bench_edgar"))
    options = parser.parse_args()
    flight = recording_of(options)
    options.out.mkdir(parents=True, exist_ok=True)
    if options.beside:
        _tell_others(dict(pair.split("=", 1) for pair in options.beside), Trajectory("map", *flight.truth()))
    elif options.map is None:
        _tell_own_flight(flight, None if options.mesh is None else load_mesh(options.mesh), options.out)
    elif options.starts:
        found = starts(flight, database.load(options.map), options.starts, options.metres_at_most)
        _tell_starts(found, options.out)
    else:
        _tell_flight(flight, database.load(options.map), options.out)


def recording_arguments(parser: argparse.ArgumentParser) -> None:
    """What says which recording is flown, for `recording_of`."""
    parser.add_argument("--mesh", type=Path)
    parser.add_argument("--route", type=Path)
    parser.add_argument("--recording", default="mesh", help="one of `tools.bench.odometry`")
    parser.add_argument("--cache", type=Path, default=Path("bench_recordings"))
    parser.add_argument("--metres", type=float)
    parser.add_argument("--seed", type=int, default=1)


def recording_of(options: argparse.Namespace) -> Recorded:
    """The recording that the arguments name, simulated if it is not in the cache."""
    with progress_bar("simulating") as advance:
        return recorded(
            options.recording, options.cache, mesh=options.mesh, route=options.route, metres=options.metres,
            seed=options.seed, progress=advance,
        )  # fmt: skip


def measurements(flight: Recorded, first: int = 0) -> Iterator[Measurement]:
    """IMU and scans in order, from scan number ``first`` on."""
    for rows, scan in flight.in_order(first):
        samples = zip(flight.imu_ns[rows].tolist(), flight.gyro[rows], flight.accel[rows], strict=True)
        yield from (ImuSample(*sample) for sample in samples)
        points, offsets_ns, ring = scan.returns()
        yield Scan(scan.stamp_ns, points, offsets_ns, ring)


def _localizer(flight: Recorded, there: SemanticMap | None) -> Localizer:
    return Localizer(Rig.model_validate(flight.about["rig"]), there)


def _tell_flight(flight: Recorded, there: SemanticMap, out: Path) -> None:
    """The whole flight with the map: tables on the terminal, all figures in ``edgar.json``."""
    truth = Trajectory("map", *flight.truth())
    result, costs = _flown(_localizer(flight, there), flight)
    rows = {
        "with map": _figures(associate(result.trajectory, truth)),
        "with map, real time": _figures(associate(result.realtime, truth)),
    }
    passed, since = passes(result, there, truth), since_pin(result, truth)
    console = Console()
    console.print(text_table(_HEAD, map(_cells, rows.items())))
    console.print(text_table(("m since the last pin", "poses", "RMSE m", "max m"), map(_bin_cells, since)))
    console.print(f"{asdict(passed)}  ms a scan: {np.percentile(costs, [50, 95, 100]).round(1).tolist()}")
    console.print(str([event for event in result.events if event["kind"] in ("state", "odometry_broken")]))
    figures = {"errors": rows, "passes": asdict(passed), "since_pin": since, "summary": result.summary}
    write_text(out / "edgar.json", json.dumps(figures, indent=1) + "\n")


def _tell_own_flight(flight: Recorded, mine: Mine | None, out: Path) -> None:
    """The whole flight without a map, and the map it makes: on the terminal, all figures in ``edgar_own.json``."""
    truth = Trajectory("map", *flight.truth())
    result, costs = _flown(_localizer(flight, None), flight)
    tracks = {
        "without map": result.trajectory, "without map, real time": result.realtime, "odometry": result.odometry
    }  # fmt: skip
    rows = {name: _figures(_aligned(associate(track, truth))) for name, track in tracks.items()}
    loops, console = loops_of(result, truth), Console()
    console.print(text_table(_HEAD, map(_cells, rows.items())))
    console.print(f"{asdict(loops)}, {result.summary['intersections_found']} intersections found")
    console.print(f"ms a scan: {np.percentile(costs, [50, 95, 100]).round(1).tolist()}")
    figures = {"errors": rows, "loops": asdict(loops), "summary": result.summary}
    if mine is not None:
        figures["own_map"] = _own_map(flight, result, truth, mine)
        console.print(f"the map it makes: {figures['own_map']}")
    write_text(out / "edgar_own.json", json.dumps(figures, indent=1) + "\n")


def _tell_others(files: dict[str, str], truth: Trajectory) -> None:
    """Rows of what other systems made of the flight."""
    rows = {}
    for name, file in files.items():
        found = np.load(file)
        rows[name] = _figures(_aligned(associate(Trajectory("odom", found["stamps_ns"], found["poses"]), truth)))
    Console().print(text_table(_HEAD, map(_cells, rows.items())))


def _own_map(flight: Recorded, alone: LocalizationResult, truth: Trajectory, mine: Mine) -> dict[str, float]:
    """What `semmap map` makes of the flight: points, how far they are from the rock [m], intersections found in it."""
    points = scan_map_points(Rig.model_validate(flight.about["rig"]), measurements(flight), alone)
    off = surface_errors(mine, transform(best_alignment(associate(alone.trajectory, truth)), points))
    found = build_semantic_map(PriorMap(points.astype(np.float32), np.zeros(3)))
    return {
        "points": len(points), "surface_median": float(np.median(off)), "surface_p95": float(np.percentile(off, 95)),
        "intersections": len(found), "peak_memory_mb": process_facts()["peak_memory_mb"],
    }  # fmt: skip


def _flown(localizer: Localizer, flight: Recorded) -> tuple[LocalizationResult, list[float]]:
    """The result, and what each scan cost [ms]."""
    costs = []
    for measurement in measurements(flight):
        began = time.perf_counter()
        if localizer.add(measurement) is not None:
            costs.append(1e3 * (time.perf_counter() - began))
    return localizer.finish(), costs


def _figures(pairs: Pairs) -> dict[str, Any]:
    errors = pairs.position_errors()
    rmse = float(np.sqrt(np.mean(errors**2)))
    return {"poses": len(pairs), "max": float(errors.max()), "rmse": rmse, "rep": rep(pairs)}


def _aligned(pairs: Pairs) -> Pairs:
    return pairs.aligned(best_alignment(pairs))


def _cells(row: tuple[str, dict[str, Any]]) -> list[str]:
    name, figures = row
    reps = ("" if value is None else f"{value:.3f}" for value in figures["rep"])
    return [name, f"{figures['max']:.3f}", f"{figures['rmse']:.3f}", *reps]


def _bin_cells(row: dict[str, float]) -> list[str]:
    return [f"{row['from_m']:.0f} and more", f"{row['poses']:.0f}", f"{row['rmse']:.3f}", f"{row['max']:.3f}"]


def pins_of(result: LocalizationResult) -> list[dict[str, Any]]:
    """Every pin, as in the events: ``stamp_ns`` of its keyframe, ``id``, and ``p_map`` where it puts its keyframe."""
    return [pin for event in result.events if event["kind"] == "intersection" for pin in event["pins"]]


def passes(result: LocalizationResult, there: SemanticMap, truth: Trajectory) -> Passes:
    """How often the flight came by a stored intersection, and what it made of it."""
    pins = pins_of(result)
    stamps = np.array([pin["stamp_ns"] for pin in pins], np.int64)
    off = np.linalg.norm(np.array([pin["p_map"] for pin in pins]).reshape(-1, 3) - truth.at(stamps)[:, :3, 3], axis=1)
    count = constrained = 0
    for id, begin_ns, end_ns in _passes(there, truth):
        here = (stamps >= begin_ns) & (stamps <= end_ns)
        count += 1
        constrained += any(pins[k]["id"] == id for k in np.flatnonzero(here))
    return Passes(count, constrained, len(pins), int(np.sum(off > FALSE_M)))


def _passes(there: SemanticMap, truth: Trajectory) -> Iterator[tuple[int, int, int]]:
    """Id, and stamps [ns] of coming within `REACH_M` and leaving, of each pass that came within `PASS_M` in plan."""
    columns = there.columns
    for row in range(len(there)):
        d = truth.positions - columns.p_map[row]
        near = np.hypot(d[:, 0], d[:, 1]) + 100.0 * (np.abs(d[:, 2]) > 3.0)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], near < REACH_M, [0]]).astype(int)))
        for begin, end in edges.reshape(-1, 2):
            if near[begin:end].min() < PASS_M:
                yield int(columns.id[row]), int(truth.stamps_ns[begin]), int(truth.stamps_ns[end - 1])


def since_pin(result: LocalizationResult, truth: Trajectory) -> list[dict[str, float]]:
    """Errors in real time by how far was flown since the last keyframe that was pinned when they were published."""
    pairs = associate(result.realtime, truth)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth.positions, axis=0), axis=1))])
    flown = np.interp(pairs.stamps_ns, truth.stamps_ns, way)
    stamps = sorted(event["stamp_ns"] for event in result.events if event["kind"] == "intersection" and event["pins"])
    last = np.searchsorted(stamps, pairs.stamps_ns, side="right") - 1
    at_pin = np.interp(stamps, pairs.stamps_ns, flown) if stamps else np.zeros(1)
    away, errors = flown - at_pin[np.maximum(last, 0)], pairs.position_errors()
    rows = []
    for low, high in zip(BINS_M, (*BINS_M[1:], np.inf), strict=True):
        here = errors[(away >= low) & (away < high)]
        if len(here):
            rmse = float(np.sqrt(np.mean(here**2)))
            rows.append({"from_m": low, "poses": float(len(here)), "rmse": rmse, "max": float(here.max())})
    return rows


def starts(flight: Recorded, there: SemanticMap, count: int, at_most: float) -> Iterator[Found]:
    """Starts at random scans, each in motion and until a pose is published; the seed is the count."""
    truth = Trajectory("map", *flight.truth())
    rng = np.random.default_rng(count)
    for first in rng.integers(0, len(flight.stamps_ns) - 600, size=count).tolist():
        yield _found(flight, there, truth, first, at_most)


def _found(flight: Recorded, there: SemanticMap, truth: Trajectory, first: int, at_most: float) -> Found:
    localizer, begin_ns = _localizer(flight, there), int(flight.stamps_ns[first])
    flown, before = 0.0, _position(truth, begin_ns)
    found, error = False, float("nan")
    stamp_ns = begin_ns
    for measurement in measurements(flight, first):
        update = localizer.add(measurement)
        if update is None:
            continue
        stamp_ns = update.stamp_ns
        true = _position(truth, stamp_ns)
        flown, before = flown + float(np.linalg.norm(true - before)), true
        if update.T_map_imu is not None:
            found, error = True, float(np.linalg.norm(update.T_map_imu[:3, 3] - true))
        if found or flown > at_most:
            break
    window = (truth.stamps_ns >= begin_ns) & (truth.stamps_ns <= stamp_ns)
    passed = len(list(_passes(there, Trajectory("map", truth.stamps_ns[window], truth.poses[window]))))
    return Found((begin_ns - int(flight.stamps_ns[0])) * 1e-9, found, flown, passed, error)


def _position(truth: Trajectory, stamp_ns: int) -> Array:
    """True position (3,) at one time, from its neighbours in a long track."""
    after = int(np.clip(np.searchsorted(truth.stamps_ns, stamp_ns), 1, len(truth) - 1))
    near = slice(after - 1, after + 1)
    position: Array = Trajectory("map", truth.stamps_ns[near], truth.poses[near]).at(np.array([stamp_ns]))[0, :3, 3]
    return position


def _tell_starts(found: Iterator[Found], out: Path) -> None:
    """A line each, and what they come to; all of it in ``starts.json``."""
    console, rows = Console(), []
    for one in found:
        rows.append(one)
        console.print(str(asdict(one)))
    right = [one for one in rows if one.found and one.error_m <= FALSE_M]
    within = [one for one in right if one.passed <= 3]
    told = {
        "starts": len(rows), "wrong": sum(one.found for one in rows) - len(right), "found": len(right),
        "found_within_three": len(within), "median_flown_m": float(np.median([one.flown_m for one in right])),
        "largest_error_m": max(one.error_m for one in right),
    }  # fmt: skip
    console.print(str(told))
    write_text(out / "starts.json", json.dumps({**told, "rows": [asdict(one) for one in rows]}, indent=1) + "\n")


if __name__ == "__main__":
    main()
