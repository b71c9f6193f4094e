"""Table II of paper 000 rebuilt: our four configurations and other odometries through the coal tunnel.

    python -m tools.bench.coal_tunnel --length 75 --seeds 10 --peers-python peers/bin/python --out bench_coal
    python -m tools.bench.coal_tunnel --length 75 --seeds 10 --faults --systems semmap --out bench_coal_faults

AvgErr, TotalErr are the mean and the sum of the errors at 15 check points. Systems without a global frame are put onto
the truth over the outer tunnel, which gives them a start without error; "from the truth" does that for all. The run
directories are kept for `semmap report`, with ``tracks.png`` and ``variances.png`` (the paper's Fig. 6 and 8) of each
seed. (The paper's own 4.9 m is from a real mine and is not this measurement.)
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from localize import LocalizeSettings
from semmap.errors import SemmapError, SettingsError
from semmap.trajectory import Trajectory
from tools.bench.coal_events import Boundary, axis_errors_deg, boundaries
from tools.bench.coal_figures import figures
from tools.bench.coal_runs import FAULTS, OURS, Accuracy, Tunnel, accuracy, accuracy_of_run, localized, tunnel
from tools.bench.odometry import measured
from tools.bench.peers import PEERS
from tools.files import write_text
from tools.progress import progress_bar
from tools.tables import text_table

FULL = next(iter(OURS))
DEFAULT_PEERS = ("rko-lio:mine", "dlio:mine", "genz-lio:mine", "kiss-icp:mine")
LENGTHS = (75.0, 1000.0)


@dataclass(frozen=True, slots=True)
class Drive:
    """One system through one seed's tunnel; ``accuracy`` is None where it gave no poses to speak of.

    fault : of `coal_runs.FAULTS`. boundaries : where its mode changed. axis_deg : angles between the degenerate
    directions it told and the tunnel's axis. ms : a scan, median.
    """

    system: str
    seed: int
    fault: str
    failure: str = ""
    accuracy: Accuracy | None = None
    boundaries: tuple[Boundary, ...] = ()
    axis_deg: tuple[float, ...] = ()
    ms: float = np.nan
    wheel_slips: int = 0


def main() -> None:
    options = arguments()
    console = Console(width=150)
    try:
        systems = known_systems(options.systems)
        drives = [drive for seed in options.seeds for drive in through(seed, systems, options, console.print)]
    except SemmapError as reason:
        console.print(f"error: {reason}", markup=False)
        sys.exit(2)
    write_text(options.out / "coal_tunnel.json", json.dumps(report(drives, options.length), indent=1) + "\n")
    for table in (errors_table(drives), fault_table(drives), mode_table(drives)):
        if table.row_count:
            console.print(table)
    for line in verdicts(drives):
        console.print(line, markup=False)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--length", type=float, default=LENGTHS[0], choices=LENGTHS, help="of the inner tunnel [m]")
    parser.add_argument("--seeds", type=_seeds, default=range(1, 11), help="how many, or first-last")
    parser.add_argument("--faults", action="store_true", help="every fault too, for our configurations")
    parser.add_argument("--systems", default=",".join((*OURS, *DEFAULT_PEERS)).replace(" ", "-"))
    parser.add_argument("--config", type=Path, help="settings of our runs (YAML, as for semmap)")
    parser.add_argument("--cores", type=int, default=0, help="cores a peer may use; 0: all")
    parser.add_argument("--peers-python", type=Path, default=Path(sys.executable))
    parser.add_argument("--cache", type=Path, default=Path("bench_recordings"))
    parser.add_argument("--out", type=Path, default=Path("bench_coal"))
    return parser.parse_args()


def _seeds(text: str) -> range:
    first, _, last = text.rpartition("-")
    return range(int(first or 1), int(last) + 1)


def known_systems(text: str) -> list[str]:
    """The systems of a comma-separated list. Raises `SettingsError` for a name nobody has."""
    ours = {name.replace(" ", "-"): name for name in OURS}
    peers = {name for one, peer in PEERS.items() for name in (one, *(f"{one}:{chosen}" for chosen in peer.settings))}
    for wanted in text.split(","):
        if wanted not in ours and wanted not in peers:
            mend = f"known: {', '.join([*ours, *sorted(peers)])}"
            raise SettingsError(f"does not know `{wanted}`", field="--systems", mend=mend)
    return [ours.get(wanted, wanted) for wanted in text.split(",")]


def through(
    seed: int, systems: Sequence[str], options: argparse.Namespace, say: Callable[[str], None]
) -> Iterable[Drive]:
    """Every system through one seed's tunnel, a line said of each; the figures of all at the end."""
    with progress_bar("simulating") as progress:
        one = tunnel(options.length, seed, options.cache, progress)
    for system in systems:
        for fault in FAULTS if options.faults and system in OURS else ("none",):
            drive = our_drive(system, seed, fault, one, options) if system in OURS else peer(system, seed, one, options)
            say(one_line(drive))
            yield drive
    directory = options.out / f"seed-{seed}"
    tums = {name: (directory / name.replace(":", "-")).with_suffix(".tum") for name in systems if name not in OURS}
    figures(directory, one.truth, {name: path for name, path in tums.items() if path.is_file()})


def our_drive(system: str, seed: int, fault: str, one: Tunnel, options: argparse.Namespace) -> Drive:
    """One of our configurations, its run directory kept."""
    settings = LocalizeSettings() if options.config is None else _localize_settings(options.config)
    out = options.out / f"seed-{seed}" / "-".join([system.replace(" ", "-"), *([fault] if fault != "none" else [])])
    summary = localized(one, out, without=OURS[system], faults=FAULTS[fault], settings=settings)
    if not len(Trajectory.load_tum(out / "trajectory.tum")):
        return Drive(system, seed, fault, failure="never found its place in the map")
    return Drive(
        system,
        seed,
        fault,
        accuracy=accuracy_of_run(out, one.truth),
        boundaries=tuple(boundaries(out, one.truth)),
        axis_deg=tuple(axis_errors_deg(out, one.truth)),
        ms=summary["ms_per_scan_median"],
        wheel_slips=summary["wheel_slips"],
    )


def _localize_settings(path: Path) -> LocalizeSettings:
    from tools.settings import load_settings

    return load_settings(path, None).localize


def peer(system: str, seed: int, one: Tunnel, options: argparse.Namespace) -> Drive:
    """Another odometry, in a process of its own; its poses and its log are kept."""
    out = options.out / f"seed-{seed}"
    out.mkdir(parents=True, exist_ok=True)
    row = measured(system, one.recording, argparse.Namespace(**{**vars(options), "out": out}))
    if row.failure:
        return Drive(system, seed, "none", failure=row.failure)
    poses = Trajectory.load_tum((out / system.replace(":", "-")).with_suffix(".tum"))
    estimate = Trajectory("odom", poses.stamps_ns, poses.poses)
    return Drive(system, seed, "none", accuracy=accuracy(estimate, one.truth), ms=row.scan_ms)


def one_line(drive: Drive) -> str:
    """A drive's result as soon as it is there."""
    name = f"seed {drive.seed} {drive.system}" + (f" ({drive.fault})" if drive.fault != "none" else "")
    if drive.accuracy is None:
        return f"{name}: {drive.failure}"
    a = drive.accuracy
    return f"{name}: AvgErr {a.avg_err:.3f} m, from the truth {a.from_truth:.3f}, max {a.max:.3f}, {drive.ms:.1f} ms"


def report(drives: Sequence[Drive], length: float) -> dict[str, Any]:
    """Everything measured, for ``coal_tunnel.json``."""
    return {
        "length_m": length,
        "faults": {name: faults.model_dump(exclude_unset=True) for name, faults in FAULTS.items()},
        "drives": [asdict(drive) for drive in drives],
    }


def errors_table(drives: Sequence[Drive]) -> Table:
    """Table II: means over the seeds, of AvgErr the range too."""
    measures = ("AvgErr", "least to most", "TotalErr", "RMSE", "max", "%", "real time", "from the truth")
    head = ("system", "seeds", *measures, "came into the map")
    rows = []
    for system in dict.fromkeys(drive.system for drive in drives):
        mine = [drive for drive in drives if drive.system == system and drive.fault == "none"]
        known = [drive.accuracy for drive in mine if drive.accuracy is not None]
        if not known:
            rows.append([system, "0", *["–"] * 8, mine[0].failure if mine else ""])
            continue
        avg = [a.avg_err for a in known]
        figures = [
            np.mean([getattr(a, name) for a in known])
            for name in ("total_err", "rmse", "max", "percent", "realtime_err", "from_truth")
        ]
        cells = [f"{np.mean(avg):.3f}", f"{min(avg):.3f} to {max(avg):.3f}", *(_figure(f) for f in figures)]
        rows.append([system, f"{len(known)} of {len(mine)}", *cells, known[0].placed])
    metres = next((drive.accuracy.metres for drive in drives if drive.accuracy is not None), 0.0)
    title = f"Errors at 15 check points over {metres:.0f} m [m]; %: AvgErr of the way"
    return text_table(head, rows, title=title)


def _figure(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.3f}"


def fault_table(drives: Sequence[Drive]) -> Table:
    """What each fault costs: mean AvgErr, and the growth against the same seed without it."""
    rows = []
    for system in OURS:
        sound = {d.seed: d.accuracy.avg_err for d in drives if d.system == system and d.fault == "none" and d.accuracy}
        for fault in (name for name in FAULTS if name != "none"):
            hurt = {d.seed: d for d in drives if d.system == system and d.fault == fault}
            known = {seed: d.accuracy for seed, d in hurt.items() if d.accuracy is not None and seed in sound}
            if not hurt:
                continue
            if not known:
                rows.append([system, fault, "–", "–", "–", "–", next(iter(hurt.values())).failure])
                continue
            mean, before = np.mean([a.avg_err for a in known.values()]), np.mean([sound[seed] for seed in known])
            most = max(a.avg_err / sound[seed] for seed, a in known.items())
            lost = f"{len(hurt) - len(known)} without a place" if len(known) < len(hurt) else ""
            worst = max(a.max for a in known.values())
            rows.append(
                [system, fault, f"{mean:.3f}", f"{mean / before:.2f}", f"{most:.2f}", f"{worst:.3f}", lost]
            )  # fmt: skip
    head = ("system", "fault", "AvgErr", "of the mean without", "of the same seed's, most", "largest error", "remarks")
    return text_table(head, rows, title="Faults [m]", left=2)


def mode_table(drives: Sequence[Drive]) -> Table:
    """Where our modes changed, along the tunnel, and how far off the axis the degenerate directions were."""
    rows = []
    for drive in drives:
        if drive.system in OURS and drive.accuracy is not None:
            ways = " ".join(f"{b.before or 'start'}→{b.after} {b.x:.1f}" for b in drive.boundaries)
            axis = f"{max(drive.axis_deg):.1f}" if drive.axis_deg else "–"
            rows.append([drive.system, str(drive.seed), drive.fault, str(drive.wheel_slips), axis, ways])
    head = ("system", "seed", "fault", "slips", "axis off [deg]", "mode changes, at x [m]")
    return text_table(head, rows, title="Modes (the inner tunnel begins at x = 20, UWB ends at 35)", left=6)


def verdicts(drives: Sequence[Drive]) -> list[str]:
    """The full system's mean AvgErr against the others'."""
    sound: dict[str, list[float]] = {}
    for drive in drives:
        if drive.fault == "none" and drive.accuracy is not None:
            sound.setdefault(drive.system, []).append(drive.accuracy.avg_err)
    mean = {system: float(np.mean(errors)) for system, errors in sound.items()}
    if FULL not in mean:
        return []
    return [
        f"{system}: {value / mean[FULL]:.1f} times the full system's"
        for system, value in mean.items()
        if system != FULL
    ]


if __name__ == "__main__":
    main()
