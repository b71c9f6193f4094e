"""Our odometry beside others: the same recordings, the same machine, one after the other.

    python -m tools.bench.odometry --recording mesh --mesh MINE.ply --route WAYPOINTS.csv --metres 945 \
        --systems semmap,rko-lio:mine,genz-lio:mine,dlio,kiss-icp:mine --peers-python peers/bin/python --out bench

A recording is simulated once (IMU at 200 Hz and a spinning LiDAR, from 4 s at rest) and kept in ``--cache``. Every
system runs in a process of its own. What is timed is the call that hands over a scan; by then the IMU samples up to
the first at or after the scan's end are handed over (systems that work in these calls are timed there too, see the
column imu). Making a system's own form of a cloud is not timed. ``name`` is a system as it ships, ``name:mine``
with the settings its authors advise for 16 beams in narrow places (`tools.bench.peers`).

The peers come with ``pip install semmap[bench]``, or into an environment of their own that ``--peers-python`` names.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from semmap.errors import SemmapError, SettingsError
from semmap.geometry import Array
from semmap.trajectory import Trajectory
from tools.bench.odometry_cache import Recorded
from tools.bench.odometry_errors import Consistency, Errors, consistency, drift_profile, errors, up_to
from tools.bench.odometry_ours import settings_of
from tools.bench.odometry_recordings import PLANS, recorded
from tools.bench.odometry_run import OURS, is_ours
from tools.bench.peers import PEERS
from tools.files import write_text
from tools.metrics import associate
from tools.progress import progress_bar
from tools.tables import text_table

ROOT = Path(__file__).resolve().parents[2]
DEFAULT_SYSTEMS = f"{OURS},rko-lio,rko-lio:mine,genz-lio:mine,dlio:mine,kiss-icp:mine"
FIRST_STRETCH_M = 945.0
SHORTEST_M = 2.0
PROFILE_ROWS = 20
AXES = ("along", "across", "up")


@dataclass(frozen=True, slots=True)
class Row:
    """One system on one recording; ``first`` and ``whole`` are None where it gave no poses to speak of.

    scans : handed over. scan_ms, imu_ms, cpu_ms : medians a scan, see `odometry_run.driven`; p95: 95th percentiles.
    km_ms : median of the scan's milliseconds by kilometre flown.
    memory_mb : peak; start_memory_mb : of it before the first scan.
    """

    system: str
    failure: str
    scans: int = 0
    scan_ms: float = np.nan
    scan_p95_ms: float = np.nan
    imu_ms: float = np.nan
    cpu_ms: float = np.nan
    cpu_p95_ms: float = np.nan
    km_ms: tuple[float, ...] = ()
    memory_mb: float = np.nan
    start_memory_mb: float = np.nan
    first: Errors | None = None
    whole: Errors | None = None
    consistency: Consistency | None = None
    profile: tuple[dict[str, float], ...] = ()


def main() -> None:
    options = arguments()
    console = Console(width=170)
    try:
        systems = known_systems(options.systems)
        with progress_bar("simulating") as progress:
            recording = recorded(
                options.recording, options.cache, mesh=options.mesh, route=options.route, metres=options.metres,
                seed=options.seed, progress=progress,
            )  # fmt: skip
    except SemmapError as reason:
        console.print(f"error: {reason}", markup=False)
        sys.exit(2)
    options.out.mkdir(parents=True, exist_ok=True)
    console.print(f"{recording.directory.name}: {len(recording.stamps_ns)} scans", markup=False)
    rows = []
    for system in systems:
        rows.append(measured(system, recording, options))
        console.print(one_line(rows[-1]), markup=False)
        write_text(options.out / "odometry.json", json.dumps(report(recording, rows, options), indent=1) + "\n")
    for table in (errors_table(rows), cost_table(rows), *profile_tables(rows)):
        console.print(table)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recording", default="rough", choices=PLANS)
    parser.add_argument("--mesh", type=Path, help="a mesh file in place of the recording's own mine")
    parser.add_argument("--route", type=Path, help="CSV of floor points through the mesh")
    parser.add_argument("--metres", type=float, help="record only so many metres")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--systems",
        default=DEFAULT_SYSTEMS,
        help=f"{OURS}, {', '.join(PEERS)}; each also as name:mine, {OURS} as {OURS}:setting=value+setting=value",
    )
    parser.add_argument("--cores", type=int, default=0, help="cores a system may use; 0: all")
    parser.add_argument("--peers-python", type=Path, default=Path(sys.executable))
    parser.add_argument("--cache", type=Path, default=Path("bench_recordings"))
    parser.add_argument("--out", type=Path, default=Path("bench_odometry"))
    return parser.parse_args()


def known_systems(text: str) -> list[str]:
    """The systems of a comma-separated list. Raises `SettingsError` for a name nobody has."""
    names = [f"{name}:{chosen}" for name, peer in PEERS.items() for chosen in peer.settings]
    known = {OURS, *PEERS, *names}
    for system in (wanted := text.split(",")):
        if is_ours(system):
            settings_of(system.partition(":")[2])
        elif system not in known:
            raise SettingsError(
                f"does not know `{system}`", field="--systems", mend=f"known: {', '.join(sorted(known))}"
            )
    return wanted


def measured(system: str, recording: Recorded, options: argparse.Namespace) -> Row:
    """Run a system and compare it with the truth; its poses go to a TUM file, what it prints to a log."""
    stem = options.out / system.replace(":", "-")
    result, log = stem.with_suffix(".npz"), stem.with_suffix(".log")
    result.unlink(missing_ok=True)
    command = [sys.executable if is_ours(system) else options.peers_python, "-m", "tools.bench.odometry_run"]
    command += [
        recording.directory.resolve(),
        "--system",
        system,
        "--cores",
        str(options.cores),
        "--out",
        result.resolve(),
    ]
    with log.open("w") as said:
        code = subprocess.run(
            command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=said, stderr=said, check=False
        ).returncode
    if code or not result.is_file():
        last = log.read_text(errors="replace").strip().splitlines()[-1:] or ["nothing said"]
        return Row(system, f"exit {code}: {last[0]}")
    return row_of(system, dict(np.load(result)), recording, stem.with_suffix(".tum"))


def row_of(system: str, result: dict[str, Any], recording: Recorded, tum: Path) -> Row:
    """What came out of one run."""
    estimate, covariances = trajectory_of(result)
    truth = Trajectory("map", *recording.truth())
    costs, cpu = result["scan_ms"], result["cpu_ms"]
    row = Row(
        system,
        "no poses",
        scans=len(costs),
        scan_ms=float(np.median(costs)),
        scan_p95_ms=float(np.percentile(costs, 95)),
        imu_ms=float(np.median(result["imu_ms"])),
        cpu_ms=float(np.median(cpu)),
        cpu_p95_ms=float(np.percentile(cpu, 95)),
        km_ms=by_kilometre(costs, truth.at(recording.stamps_ns[: len(costs)])),
        memory_mb=float(result["memory_mb"][1]),
        start_memory_mb=float(result["memory_mb"][0]),
    )
    if not len(estimate):
        return row
    estimate.save_tum(tum)
    pairs = associate(estimate, truth)
    flown = pairs.distance_flown()
    if flown[-1] < SHORTEST_M:
        return row
    known = None if covariances is None else covariances[np.isin(estimate.stamps_ns, pairs.stamps_ns)]
    return replace(
        row,
        failure="",
        first=errors(up_to(pairs, FIRST_STRETCH_M)),
        whole=errors(pairs),
        profile=tuple(drift_profile(pairs, max(10.0, flown[-1] / PROFILE_ROWS))),
        consistency=None if known is None else consistency(pairs, known),
    )


def trajectory_of(result: dict[str, Any]) -> tuple[Trajectory, Array | None]:
    """The estimated trajectory, up to where it stops being finite, and its covariances if the system gave any."""
    stamps, poses = result["stamps_ns"], result["poses"]
    finite = np.logical_and.accumulate(np.isfinite(poses).all(axis=(1, 2)))
    later = np.concatenate([[True], np.diff(np.maximum.accumulate(stamps)) > 0])[: len(stamps)]
    use = finite & later
    covariances = result["covariances"][use] if len(result["covariances"]) == len(stamps) and len(stamps) else None
    return Trajectory("odom", stamps[use], poses[use]), covariances


def by_kilometre(costs: Array, poses: Array) -> tuple[float, ...]:
    """Median cost (ms) of the scans (n,) in each kilometre of the true way (n, 4, 4)."""
    flown = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1))])
    kilometre = (flown / 1000.0).astype(int)
    return tuple(float(np.median(costs[kilometre == k])) for k in range(kilometre.max() + 1))


def report(recording: Recorded, rows: list[Row], options: argparse.Namespace) -> dict[str, Any]:
    """Everything measured, for ``odometry.json``."""
    return {
        "recording": recording.about,
        "scans": len(recording.stamps_ns),
        "cores": options.cores or len(os.sched_getaffinity(0)),
        "machine": platform.processor() or platform.machine(),
        "settings": {name: {key: dict(value) for key, value in peer.settings.items()} for name, peer in PEERS.items()},
        "systems": [asdict(row) for row in rows],
    }


def one_line(row: Row) -> str:
    """A system's result as soon as it is there."""
    if row.whole is None:
        return f"{row.system}: {row.failure}"
    return f"{row.system}: {row.whole.ape_rmse:.3f} m over {row.whole.metres:.0f} m, {row.scan_ms:.1f} ms"


def errors_table(rows: list[Row]) -> Table:
    """Errors over the first stretch, and over the whole where it is longer; every figure's meaning is in `Errors`."""
    figures = {
        "APE RMSE": "ape_rmse",
        "max": "ape_max",
        "attitude": "attitude_rmse",
        "drift RMSE": "drift_rmse",
        "end": "drift_end",
        "tilt": "tilt_end",
        "yaw": "yaw_end",
        "start": "start_m",
        "start deg": "start_deg",
        "% of 10 m": "percent_10m",
        "100 m": "percent_100m",
    }
    lines = [
        [row.system, f"{one.metres:.0f}", str(one.poses), *(_figure(getattr(one, name)) for name in figures.values())]
        for row in rows
        for one in _stretches(row)
    ]
    title = "Errors [m, deg]: APE after the SE(3) fit; drift from the pose at the first metre; start: up to there"
    return text_table(("system", "metres", "poses", *figures), lines, title=title)


def _stretches(row: Row) -> list[Errors]:
    if row.first is None or row.whole is None:
        return []
    return [row.first] if row.whole.metres <= FIRST_STRETCH_M + 1.0 else [row.first, row.whole]


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


def cost_table(rows: list[Row]) -> Table:
    """What a scan costs, and failures."""
    head = ("system", "ms a scan", "p95", "imu", "processor", "p95", "by km", "peak MB", "at start", "remarks")
    lines = []
    for row in rows:
        figures = [f"{x:.2f}" for x in (row.scan_ms, row.scan_p95_ms, row.imu_ms, row.cpu_ms, row.cpu_p95_ms)]
        kilometres = " ".join(f"{ms:.1f}" for ms in row.km_ms)
        honest = "" if row.consistency is None else _honest(row.consistency)
        memory = [f"{row.memory_mb:.0f}", f"{row.start_memory_mb:.0f}"]
        lines.append([row.system, *figures, kilometres, *memory, row.failure or honest])
    return text_table(
        head, lines, title="Cost: medians a scan, wall time in the scan's call; processor: all threads, IMU and scan"
    )


def _honest(one: Consistency) -> str:
    sigmas = ", ".join(f"{value:.1f} {axis}" for axis, value in zip(AXES, (one.along, one.across, one.up), strict=True))
    return f"{100 * one.inside:.0f} % inside 95 %; error/sigma {sigmas}"


def profile_tables(rows: list[Row]) -> list[Table]:
    """Where our own error arises."""
    return [
        text_table(
            tuple(row.profile[0]),
            [[f"{line['metres']:.0f}", *(f"{value:.3f}" for value in list(line.values())[1:])] for line in row.profile],
            title=f"{row.system}: drift from the pose at the first metre [m, deg]",
            left=0,
        )
        for row in rows
        if is_ours(row.system) and row.profile
    ]


if __name__ == "__main__":
    main()
