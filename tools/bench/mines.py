"""The main job on many procedural mines: is it right, is it silent where it has no map, what does a scan cost?

    python -m tools.bench.mines --seconds 90 --seeds 2

A row a flight: localized with its own mine's map, then with another mine's, where any pose would be a wrong one.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from localize import LocalizationResult, Localizer
from maps.build import build_semantic_map
from maps.prior_map import PriorMap
from semmap.intersections import SemanticMap
from semmap.measurements import Measurement
from semmap.rig import Rig
from semmap.trajectory import Trajectory
from tools.run import stream
from tools.simulator import Mine, SimulationSettings, fly, scenario, simulate_measurements

NAMES = ("demo", "ramp", "drift", "random", "grid")
START_S = (0.0, 15.0)
"""Recordings begin at rest and in motion by turns."""


@dataclass(frozen=True, slots=True)
class Row:
    """One flight: errors [m] without alignment, first place [s], cost [ms]; n is the poses published in real time."""

    rmse: float
    realtime_max: float
    first_s: float
    n: int
    recognised: int
    ms: float
    p95_ms: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--without", nargs="*", default=[], help="sensors to leave out: wheel")
    options = parser.parse_args()
    mines = {(name, seed): scenario(name, seed=seed) for name in NAMES for seed in range(1, options.seeds + 1)}
    maps = {key: map_of(mine, key[1]) for key, mine in mines.items()}
    print("mine       found/plan   RMSE   realtime max   first place   known   recognised   ms (p95)   other map")
    wrong = 0
    for number, (key, mine) in enumerate(mines.items()):
        settings = SimulationSettings(start_s=START_S[number % 2], duration_s=options.seconds)
        flight = fly(mine, settings=settings, seed=key[1])
        measurements = list(simulate_measurements(flight))
        rig = flight.rig.without(*options.without)
        row = row_of(*localized(rig, measurements, maps[key]), flight.truth())
        other = next(k for k in [*list(mines)[number + 1 :], *mines] if k[0] != key[0])
        stray = len(localized(rig, measurements, maps[other])[0].realtime)
        wrong += stray > 0
        plan = sum(junction.branches >= 3 for junction in mine.junctions)
        found = sum(len(one.branch_bearings) >= 3 for one in maps[key].intersections)
        print(
            f"{key[0]:7s}{key[1]:3d} {found:6d}/{plan:<4d} {row.rmse:9.3f} {row.realtime_max:11.3f}"
            f" {row.first_s:12.1f} s {row.n:8d} {row.recognised:9d} {row.ms:10.1f} ({row.p95_ms:.0f})"
            f" {'WRONG' if stray else 'silent':>9s}",
            flush=True,
        )
    print(f"{len(mines)} flights, {wrong} placed in a map that is not theirs")


def map_of(mine: Mine, seed: int) -> SemanticMap:
    """The mine's database, from points on its rock 0.1 m apart."""
    points = mine.sample(spacing=0.1, noise=0.01, seed=seed)
    origin = 1000.0 * np.round(points.mean(axis=0) / 1000.0)
    return build_semantic_map(PriorMap((points - origin).astype(np.float32), origin))


def localized(rig: Rig, measurements: list[Measurement], there: SemanticMap) -> tuple[LocalizationResult, list[float]]:
    """The result, and what each scan cost [ms]."""
    localizer = Localizer(rig, there)
    costs = stream(localizer, measurements)
    return localizer.finish(), costs


def row_of(result: LocalizationResult, costs: list[float], truth: Trajectory) -> Row:
    """Errors against the truth; NaN where it never found its place."""
    first = (result.realtime.stamps_ns[:1] - result.odometry.stamps_ns[0]) * 1e-9
    final, live = errors(result.trajectory, truth), errors(result.realtime, truth)
    return Row(
        rmse=float(np.sqrt(np.mean(final**2))) if len(final) else np.nan,
        realtime_max=float(live.max(initial=0.0)) if len(live) else np.nan,
        first_s=float(first[0]) if len(first) else np.nan,
        n=len(live),
        recognised=len(result.summary["intersections_recognised"]),
        ms=float(np.median(costs)),
        p95_ms=float(np.percentile(costs, 95)),
    )


def errors(trajectory: Trajectory, truth: Trajectory) -> np.ndarray:
    """Position errors (n,) [m], no alignment."""
    if not len(trajectory):
        return np.zeros(0)
    return np.linalg.norm(trajectory.positions - truth.at(trajectory.stamps_ns)[:, :3, 3], axis=1)


if __name__ == "__main__":
    main()
