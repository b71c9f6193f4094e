"""Drives of the roadheader through its roadway, from clear air to 200 mg/m³ of dust, by our system and parts of it.

    python -m tools.bench.roadheader --drives --seeds 10 --out bench_roadheader

One line a drive goes to ``drives.jsonl`` as soon as it is done; what is there already is not done again.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial import cKDTree

from localize import Localizer
from localize.results import LocalizationResult
from semmap.geometry import Array, inverse, so3_log
from semmap.measurements import Measurement, PrismFix, Scan
from semmap.rig import Rig
from semmap.trajectory import Trajectory
from tools.bench.peers import PEERS
from tools.bench.roadheader_ins import ins_track
from tools.bench.roadheader_peers import peer_track
from tools.run import stream, timing
from tools.simulator import SensorFaults, SimulationSettings, fly, scenario
from tools.simulator.flight import EPOCH_NS, Flight
from tools.simulator.measurements import simulate_measurements
from tools.tables import text_table

SYSTEMS: dict[str, tuple[str, ...]] = {
    "semmap": (),
    "without enhancement": ("inertial-enhancement",),
    "without prism": ("prism",),
    "without LiDAR": ("lidar",),
}
"""Ours whole, and what is left out."""
INS = "INS and total station"
"""The filter of paper 002 II-B by itself, see `roadheader_ins`; the others are peers, see `roadheader_peers`."""
HIDDEN_S = (95.0, 125.0)
"""When the prism is out of sight, where it is: driving, turning and reversing, in seconds of the drive."""
STARTED_S = 29.0
"""The machine is about to move; what has no place in the map is put onto the truth here."""
_START_UP_S = 10.0
_CUBE_M, _CUBE_POINTS = 0.3, 20
_EVERY = 5
"""Scans that make the map whose thickness is measured: each fifth."""
_ROCK_EVERY, _SEEN_EVERY = 3, 11
"""Points of them that stand for the rock, and that are compared with it."""


@dataclass(frozen=True, slots=True)
class Case:
    """A recording and what is done with it. imu : tactical or consumer. dust : [mg/m³]."""

    imu: str
    dust: float
    system: str = "semmap"
    hidden: bool = False

    def __str__(self) -> str:
        hidden = ", prism out of sight" if self.hidden else ""
        return f"{self.imu}, {self.dust:g} mg/m³, {self.system}{hidden}"


CASES = (
    Case("tactical", 0.0),
    Case("tactical", 0.0, "without prism"),
    Case("tactical", 0.0, "rko-lio:mine"),
    Case("tactical", 0.0, "genz-lio:mine"),
    Case("tactical", 0.0, "dlio:mine"),
    Case("tactical", 0.0, "without enhancement"),
    Case("tactical", 200.0),
    Case("tactical", 200.0, hidden=True),
    Case("tactical", 200.0, "without prism"),
    Case("tactical", 200.0, "rko-lio:mine"),
    Case("tactical", 200.0, "genz-lio:mine"),
    Case("tactical", 200.0, "dlio:mine"),
    Case("tactical", 200.0, "without enhancement"),
    Case("tactical", 200.0, INS),
    Case("tactical", 200.0, INS, hidden=True),
    Case("tactical", 25.0),
    Case("tactical", 50.0),
    Case("tactical", 100.0),
    Case("consumer", 0.0),
    Case("consumer", 0.0, "without enhancement"),
    Case("consumer", 200.0),
    Case("consumer", 200.0, hidden=True),
    Case("consumer", 200.0, "without LiDAR"),
    Case("consumer", 200.0, "without prism"),
    Case("consumer", 200.0, "without enhancement"),
)


@dataclass(frozen=True, slots=True)
class Drive:
    """One case of one seed against the truth: what was known when each scan was done, and the final trajectory.

    rms, z_rms, z_max, final_rms, final_z_rms : of the IMU's position [m]. roll, pitch, yaw : RMS [deg].
    start_yaw : error when the place in the map became known [deg]. start_rms : position over the first 10 s from then
    on [m]. start_lean : most of roll and pitch over the first 10 s of odometry [deg]. after_hidden : position error
    when the prism came back into sight, most_hidden : the most until then [m]. thickness : of the walls in the map that
    the final poses make [m]; true_thickness : that the true ones make. ghosts : what points that are put into the map
    when their scan is done lie off the rock, RMS [m]; true_ghosts : by true poses. ms : a scan, median.
    """

    case: str
    seed: int
    rms: float = np.nan
    z_rms: float = np.nan
    z_max: float = np.nan
    roll: float = np.nan
    pitch: float = np.nan
    yaw: float = np.nan
    final_rms: float = np.nan
    final_z_rms: float = np.nan
    start_yaw: float = np.nan
    start_rms: float = np.nan
    start_lean: float = np.nan
    after_hidden: float = np.nan
    most_hidden: float = np.nan
    thickness: float = np.nan
    true_thickness: float = np.nan
    ghosts: float = np.nan
    true_ghosts: float = np.nan
    known_from_s: float = np.nan
    ms: float = np.nan


def drives(seeds: Sequence[int], cases: Sequence[Case], out: Path, peers_python: Path) -> Iterator[Drive]:
    """Every case of every seed, from ``drives.jsonl`` where it is there, else driven now."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / "drives.jsonl"
    known = {(d.case, d.seed): d for d in map(_read, file.read_text().splitlines())} if file.is_file() else {}
    for seed in seeds:
        recording: tuple[tuple[str, float], Flight, list[Measurement]] | None = None
        for case in cases:
            if (str(case), seed) not in known:
                key = (case.imu, case.dust)
                if recording is None or recording[0] != key:
                    flight = roadheader_flight(case.imu, seed, SensorFaults(dust=case.dust))
                    recording = key, flight, list(simulate_measurements(flight))
                if case.system.split(":")[0] in PEERS:
                    directory = out / f"{case.imu}-{case.dust:g}-{seed}"
                    track = peer_track(case.system, recording[1], directory, peers_python)
                    done = unplaced(case, seed, track, recording[1].truth())
                else:
                    done = driven(case, seed, recording[1], recording[2])
                known[str(case), seed] = done
                with file.open("a") as lines:
                    lines.write(json.dumps(asdict(done)) + "\n")
            yield known[str(case), seed]


def _read(line: str) -> Drive:
    return Drive(**json.loads(line))


def roadheader_flight(imu: str, seed: int, faults: SensorFaults) -> Flight:
    """The built-in drive; seed for seed its noise is the same in every dust."""
    mine = scenario("roadway" if imu == "tactical" else "roadway-consumer", seed)
    return fly(mine, seed=seed, settings=SimulationSettings(faults=faults))


def driven(case: Case, seed: int, flight: Flight, measurements: Sequence[Measurement]) -> Drive:
    """Run one case and compare it with the truth."""
    if case.system == INS:
        return _by_ins(case, seed, flight, [m for m in measurements if not (case.hidden and _hidden(m))])
    localizer = Localizer(flight.rig.without(*SYSTEMS[case.system]), None)
    seen = (m for m in measurements if not (case.hidden and _hidden(m)))
    costs = stream(localizer, seen)
    result, truth = localizer.finish(), flight.truth()
    scans = [m for m in measurements if isinstance(m, Scan)][::_EVERY]
    ms = timing(costs)["ms_per_scan_median"]
    return compared(str(case), seed, result, truth, flight.rig, scans, np.nan if ms is None else ms)


def _by_ins(case: Case, seed: int, flight: Flight, measurements: Sequence[Measurement]) -> Drive:
    track = ins_track(flight.rig, measurements, EPOCH_NS + round(STARTED_S * 1e9))
    return _of_errors(case, seed, _Errors.of(track, flight.truth()))


def unplaced(case: Case, seed: int, odometry: Trajectory, truth: Trajectory) -> Drive:
    """The figures of an odometry that is put onto the truth where the machine is about to move."""
    began_ns = EPOCH_NS + round(STARTED_S * 1e9)
    if not len(odometry) or odometry.stamps_ns[-1] <= began_ns:
        return Drive(str(case), seed)
    placed = _started(odometry, truth)
    moving = placed.stamps_ns >= began_ns
    return _of_errors(case, seed, _Errors.of(Trajectory("map", placed.stamps_ns[moving], placed.poses[moving]), truth))


def _of_errors(case: Case, seed: int, at: _Errors) -> Drive:
    roll, pitch, yaw = np.sqrt(np.mean(at.turn_deg**2, axis=0)).tolist()
    hidden = (at.t >= HIDDEN_S[0]) & (at.t < HIDDEN_S[1])
    off = at.off[hidden] if hidden.any() else np.full((1, 3), np.nan)
    return Drive(
        str(case), seed, rms=_rms(at.off), z_rms=_rms(at.off[:, 2:]), z_max=float(np.abs(at.off[:, 2]).max()),
        roll=roll, pitch=pitch, yaw=yaw, start_yaw=float(at.turn_deg[0, 2]),
        after_hidden=float(np.linalg.norm(off[-1])), most_hidden=float(np.linalg.norm(off, axis=1).max()),
        known_from_s=float(at.t[0]),
    )  # fmt: skip


def _hidden(measurement: Measurement) -> bool:
    since_s = (measurement.stamp_ns - EPOCH_NS) * 1e-9
    return isinstance(measurement, PrismFix) and HIDDEN_S[0] <= since_s < HIDDEN_S[1]


def compared(
    case: str, seed: int, result: LocalizationResult, truth: Trajectory, rig: Rig, scans: Sequence[Scan], ms: float
) -> Drive:
    """The figures of one drive."""
    odometry = _started(result.odometry, truth)
    lean = _Errors.of(odometry, truth)
    early = lean.t < lean.t[0] + _START_UP_S
    placed = result.trajectory.frame == "map"
    if placed and not len(result.trajectory):
        return Drive(case, seed, start_lean=float(np.abs(lean.turn_deg[early, :2]).max()), ms=ms)
    now, final = (result.realtime, result.trajectory) if placed else (odometry, odometry)
    if not placed:
        from_start = odometry.stamps_ns >= EPOCH_NS + round(STARTED_S * 1e9)
        now = final = Trajectory("map", odometry.stamps_ns[from_start], odometry.poses[from_start])
    at, end = _Errors.of(now, truth), _Errors.of(final, truth)
    hidden = (at.t >= HIDDEN_S[0]) & (at.t < HIDDEN_S[1])
    first = at.t < at.t[0] + _START_UP_S
    roll, pitch, yaw = np.sqrt(np.mean(at.turn_deg**2, axis=0)).tolist()
    return Drive(
        case, seed,
        rms=_rms(at.off), z_rms=_rms(at.off[:, 2:]), z_max=float(np.abs(at.off[:, 2]).max()),
        roll=roll, pitch=pitch, yaw=yaw,
        final_rms=_rms(end.off), final_z_rms=_rms(end.off[:, 2:]),
        start_yaw=float(at.turn_deg[0, 2]), start_rms=_rms(at.off[first]),
        start_lean=float(np.abs(lean.turn_deg[early, :2]).max()),
        after_hidden=float(np.linalg.norm(at.off[hidden][-1])),
        most_hidden=float(np.linalg.norm(at.off[hidden], axis=1).max()),
        thickness=thickness(final, rig, scans), true_thickness=thickness(truth, rig, scans),
        ghosts=ghosts(now, truth, rig, scans), true_ghosts=ghosts(truth, truth, rig, scans),
        known_from_s=float(at.t[0]), ms=ms,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Errors:
    """Position (n, 3) [m] and attitude (n, 3) [deg], in map axes, off the truth at times (n,) of the drive [s]."""

    t: Array
    off: Array
    turn_deg: Array

    @classmethod
    def of(cls, estimate: Trajectory, truth: Trajectory) -> _Errors:
        inside = (estimate.stamps_ns >= truth.stamps_ns[0]) & (estimate.stamps_ns <= truth.stamps_ns[-1])
        stamps, poses = estimate.stamps_ns[inside], estimate.poses[inside]
        true = truth.at(stamps)
        turn = so3_log(poses[:, :3, :3] @ np.swapaxes(true[:, :3, :3], 1, 2))
        return cls((stamps - EPOCH_NS) * 1e-9, poses[:, :3, 3] - true[:, :3, 3], np.degrees(turn))


def _rms(off: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def _started(odometry: Trajectory, truth: Trajectory) -> Trajectory:
    """Odometry put onto the truth where the machine is about to move: a start without error."""
    stamp = odometry.stamps_ns[np.searchsorted(odometry.stamps_ns, EPOCH_NS + round(STARTED_S * 1e9))]
    at = np.array([stamp])
    return Trajectory("map", odometry.stamps_ns, truth.at(at)[0] @ inverse(odometry.at(at)[0]) @ odometry.poses)


def _placed(track: Trajectory, rig: Rig, scans: Sequence[Scan]) -> Array:
    """The points (n, 3) of scans in the map, each where the track was at its own time [m]."""
    assert rig.lidar is not None
    parts = [np.empty((0, 3))]
    for scan in scans:
        at = scan.stamp_ns + scan.offsets_ns
        good = (at >= track.stamps_ns[0]) & (at <= track.stamps_ns[-1])
        if not good.any():
            continue
        columns, which = np.unique(at[good], return_inverse=True)
        poses = track.at(columns) @ rig.lidar.T_imu_lidar
        p = scan.points[good].astype(np.float64)
        parts.append(np.einsum("nij,nj->ni", poses[which, :3, :3], p) + poses[which, :3, 3])
    return np.concatenate(parts)


def ghosts(track: Trajectory, truth: Trajectory, rig: Rig, scans: Sequence[Scan]) -> float:
    """How far the points that a track puts into the map lie off the rock that other scans show, RMS [m]."""
    rock, seen = _placed(truth, rig, scans[::2])[::_ROCK_EVERY], _placed(track, rig, scans[1::2])[::_SEEN_EVERY]
    return float(np.sqrt(np.mean(cKDTree(rock).query(seen)[0] ** 2))) if len(rock) and len(seen) else np.nan


def thickness(track: Trajectory, rig: Rig, scans: Sequence[Scan]) -> float:
    """How thick walls are in the map that a track makes of scans [m]: across, RMS in cubes, the median of these."""
    points = _placed(track, rig, scans)
    keys = np.floor(points / _CUBE_M).astype(np.int64) @ np.array([1, 1 << 20, 1 << 40])
    cube, count = np.unique(keys, return_inverse=True, return_counts=True)[1:]
    mean = np.column_stack([np.bincount(cube, axis) for axis in points.T]) / count[:, None]
    off = points - mean[cube]
    scatter = np.array([[np.bincount(cube, off[:, a] * off[:, b]) for b in range(3)] for a in range(3)])
    full = count >= _CUBE_POINTS
    squares = np.linalg.eigvalsh(np.moveaxis(scatter[:, :, full] / count[full], -1, 0))[:, 0]
    return float(np.median(np.sqrt(np.maximum(squares, 0.0))))


def table(done: Sequence[Drive]) -> Table:
    """Root mean squares over the seeds, and of what hides nothing the worst."""
    rows = []
    for case in dict.fromkeys(drive.case for drive in done):
        mine = [drive for drive in done if drive.case == case]
        found = [drive for drive in mine if np.isfinite(drive.rms)]
        value = {f.name: _column(found, f.name) for f in fields(Drive) if f.name not in ("case", "seed")}

        def over(name: str, scale: float = 1e3, digits: int = 1, value: dict[str, Array] = value) -> str:
            column = value[name]
            return f"{scale * np.sqrt(np.mean(column**2)):.{digits}f}" if len(column) else "–"

        worst = f"{1e3 * value['rms'].max():.1f}" if found else "–"
        lean = np.concatenate([value["roll"], value["pitch"]])
        z = f"{over('z_rms')} ({1e3 * value['z_max'].max():.0f})" if found else "–"
        attitude = f"{np.sqrt(np.mean(lean**2)):.3f} ({lean.max():.3f})" if found else "–"
        hidden = f"{over('after_hidden')} ({1e3 * value['most_hidden'].max():.0f})" if "out of" in case else ""
        thick = f"{over('thickness')} ({over('true_thickness')})"
        start = (over("start_lean", 1.0, 3), over("start_yaw", 1.0, 2), over("start_rms"))
        ghost = f"{over('ghosts', 1e3, 0)} ({over('true_ghosts', 1e3, 0)})"
        cells = (f"{len(found)} of {len(mine)}", over("rms"), worst, over("final_rms"), z, attitude, over("yaw", 1, 3))
        rows.append([case, *cells, hidden, *start, thick, ghost, over("ms", 1.0, 0)])
    head = (
        "case", "seeds", "RMS [mm]", "worst seed", "final RMS", "z (most)", "roll, pitch RMS [deg] (worst)",
        "yaw [deg]", "after 30 s (most)", "start: lean [deg]", "yaw [deg]", "RMS [mm]", "thickness (true) [mm]",
        "ghosts (true) [mm]", "ms",
    )  # fmt: skip
    return text_table(head, rows, title="Roadheader")


def _column(found: Sequence[Drive], name: str) -> Array:
    values = np.array([getattr(drive, name) for drive in found], dtype=np.float64)
    return values[np.isfinite(values)]


def run(seeds: Sequence[int], out: Path, wanted: str, peers_python: Path) -> None:
    """Drive the ``wanted`` cases, by name and separated by semicolons (all by default), and print the table."""
    words = [word.strip() for word in wanted.split(";") if word.strip()]
    cases = [case for case in CASES if not words or str(case) in words]
    console = Console(width=220)
    done = []
    for drive in drives(seeds, cases, out, peers_python):
        console.print(f"{drive.case}, seed {drive.seed}: {1e3 * drive.rms:.1f} mm", markup=False)
        done.append(drive)
    console.print(table(done))
