"""`simulate`: a mine and a flight through it, written as the files the rest of semmap starts from."""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from maps.las import save_laz
from semmap.errors import InputFileError
from semmap.geometry import Array
from semmap.measurements import Scan
from semmap.recordings import RecordingWriter
from semmap.rig import Rig
from tools.simulator.check_points import save_check_points
from tools.simulator.flight import EPOCH_NS, Flight, driven_settings, fly, robot_of
from tools.simulator.junctions import save_junctions
from tools.simulator.measurements import arrival_ns, simulate_measurements
from tools.simulator.mine import MESH_SUFFIXES, Mine, load_mesh, scenario
from tools.simulator.progress import PERCENT, Progress, ignored, part
from tools.simulator.rigs import as_recorded, save_rig
from tools.simulator.route import load_route
from tools.simulator.settings import SimulationSettings
from tools.simulator.surveying import survey

PRIOR_MAP, RECORDING, RIG = "prior_map.laz", "recording", "rig.yaml"
GROUND_TRUTH, CHECK_POINTS, JUNCTIONS = "ground_truth.tum", "check_points.csv", "junctions.csv"

_DUG, _CHECKED, _RECORDED = 10, 15, 95
"""[%] of the whole when these steps are done."""


@dataclass(frozen=True, slots=True)
class Simulation:
    """What was written.

    out, mine : the directory, and the mine's name.
    junctions : how many are in junctions.csv; None if there is no such file, because a mesh does not say where its
        intersections are.
    scans, measurements : counts. duration_s, length_m : of the recorded flight.
    floor_shift : by how much the heights of a route of one's own were moved to the mine's floor, see `fly` [m].
    settings : as used: with the motion of the mine's own robot where none was asked for.
    """

    out: Path
    mine: str
    junctions: int | None
    scans: int
    measurements: int
    duration_s: float
    length_m: float
    floor_shift: float
    settings: SimulationSettings


def simulate(
    source: str | Path,
    *,
    out: str | Path,
    route: str | Path | None = None,
    rig: Rig | None = None,
    seed: int = 0,
    settings: SimulationSettings | None = None,
    progress: Progress | None = None,
) -> Simulation:
    """Simulate a mine and a robot in it; write prior map, recording, rig, truth, check points and reference junctions.

    The files appear in ``out`` when all of them are done; an error leaves it as it was.

    Parameters
    ----------
    source : name of a built-in mine (`tools.simulator.scenarios`) or a mesh file in metres, z up.
    out : directory for ``prior_map.laz``, ``recording/``, ``rig.yaml``, ``ground_truth.tum``, ``check_points.csv`` and,
        for built-in mines only, ``junctions.csv``.
    route : CSV of floor points, heights may be left out, see `load_route`; the built-in mine's own route if None.
    rig : the robot's sensors; the mine's own robot's, or `default_rig`, if None.
    settings : where they do not set the motion, the mine's own robot moves its own way.
    seed : of everything random; the same seed gives the same files.
    progress : called with (done, total) from time to time.

    Raises
    ------
    InputFileError
        For an unknown source, a bad mesh or route, a route that leaves the mine, or an ``out`` that is in
        the way.
    """
    out = Path(out)
    report = progress or ignored
    _check_out(out)
    points = None if route is None else load_route(route)
    mine = _open_mine(source, seed, part(report, 0, _DUG))
    settings = driven_settings(mine, settings)
    sensors = as_recorded(rig or robot_of(mine).rig)
    flight = fly(mine, points, sensors, settings=settings, seed=seed, progress=part(report, _DUG, _CHECKED))
    aside = _make_aside(out)
    try:
        counts = _record(aside / RECORDING, flight, part(report, _CHECKED, _RECORDED))
        save_laz(aside / PRIOR_MAP, survey(mine, settings.map, seed=seed, route=_under(flight, settings)))
        save_rig(aside / RIG, flight.rig)
        truth = flight.truth()
        truth.save_tum(aside / GROUND_TRUTH)
        save_check_points(aside / CHECK_POINTS, truth)
        if mine.scenario:
            save_junctions(aside / JUNCTIONS, mine.junctions)
        _move_in(aside, out)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    report(PERCENT, PERCENT)
    duration = flight.last_s - flight.first_s
    junctions = len(mine.junctions) if mine.scenario else None
    return Simulation(out, mine.name, junctions, *counts, duration, truth.length(), flight.floor_shift, settings)


def _open_mine(source: str | Path, seed: int, report: Progress) -> Mine:
    """A mesh where the source looks like a file, a built-in mine otherwise."""
    path = Path(source)
    if path.is_file() or path.suffix.lower() in MESH_SUFFIXES:
        return load_mesh(path)
    return scenario(str(source), seed, progress=report)


def _record(path: Path, flight: Flight, report: Progress) -> tuple[int, int]:
    """Write the recording; the number of scans and of measurements in it."""
    scans = measurements = 0
    span_ns = max(1, round((flight.last_s - flight.first_s) * 1e9))
    first_ns = EPOCH_NS + round(flight.first_s * 1e9)
    with RecordingWriter(path, flight.rig) as recording:
        for measurement in simulate_measurements(flight):
            recording.write(measurement)
            measurements += 1
            if measurements % 1000 == 0:
                report(arrival_ns(measurement) - first_ns, span_ns)
            scans += isinstance(measurement, Scan)
    return scans, measurements


def _under(flight: Flight, settings: SimulationSettings) -> Array:
    """Floor points (n, 3), half a metre apart or so, under the whole flight."""
    t = np.arange(0.0, flight.motion.duration_s, 0.5 / settings.motion.speed)
    return np.asarray(flight.motion(t).position - [0.0, 0.0, settings.motion.height])


def _check_out(out: Path) -> None:
    """Raise before the work starts where its results could not be put."""
    if out.exists() and not out.is_dir():
        raise InputFileError("is a file", file=out, mend="choose another --out")
    old = out / RECORDING
    if old.exists() and not (old / "metadata.yaml").is_file():
        raise InputFileError("is in the way and is not a recording", file=old, mend="choose another --out")


def _make_aside(out: Path) -> Path:
    """A temporary directory beside ``out``, on the same disk."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    except OSError as reason:
        raise InputFileError(f"cannot be written ({reason.strerror})", file=out, mend="choose another --out") from None


def _move_in(aside: Path, out: Path) -> None:
    """Put the finished files in their place, older ones of the same names and a stale junctions.csv away."""
    out.mkdir(exist_ok=True)
    shutil.rmtree(out / RECORDING, ignore_errors=True)
    (out / JUNCTIONS).unlink(missing_ok=True)
    for finished in sorted(aside.iterdir()):
        finished.replace(out / finished.name)
