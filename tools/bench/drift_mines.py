"""Pins where odometry fails: look-alike crossings joined by long smooth drifts, a LiDAR that sees 30 m.

    python -m tools.bench.drift_mines --seeds 3

Along such a drift nothing tells the way but the IMU, and the wheel if there is one. Printed per mine [m]: how far the
odometry is off at the worst, the errors in real time, how far the pose is off within two seconds after each crossing's
first pin, the smoothed track, and false pins; and how errors agree with their covariance (normalised error squared over
its dimension), in real time and of the smoothed track.
"""

from __future__ import annotations

import argparse
from dataclasses import astuple, dataclass

import numpy as np
from rich.console import Console

from localize import LocalizationResult, Localizer
from semmap.geometry import Array
from semmap.intersections import SemanticMap
from semmap.rig import LidarBlock, Rig
from semmap.trajectory import Trajectory
from tools.bench.edgar import FALSE_M, passes
from tools.bench.mines import errors, map_of
from tools.run import stream
from tools.simulator import SimulationSettings, default_rig, dig, fly, simulate_measurements
from tools.simulator.roadways import MineScenario, Roadway
from tools.tables import text_table

MAX_RANGE_M = 30.0


@dataclass(frozen=True, slots=True)
class Row:
    """One flight [m]. after_pin : greatest error in real time within two seconds after a crossing's first pin."""

    odometry_max: float
    realtime_rmse: float
    nees: float
    after_pin: float
    final_rmse: float
    final_max: float
    final_nees: float
    passes: int
    constrained: int
    false: int


def drifts(seed: int, crossings: int = 3) -> MineScenario:
    """Crossings of one plan in a row, 150 to 300 m of smooth drift between them; each has rock of its own."""
    rng = np.random.default_rng([seed, 7])
    x = np.concatenate([[0.0], np.cumsum(rng.uniform(150.0, 300.0, crossings - 1))])
    nodes = {"start": (-30.0, 0.0, 0.0), "end": (float(x[-1]) + 30.0, 0.0, 0.0)}
    roadways: list[Roadway] = []
    for k, at in enumerate(x.tolist()):
        nodes |= {f"c{k}": (at, 0.0, 0.0), f"n{k}": (at, 26.0, 0.0), f"s{k}": (at, -26.0, 0.0)}
        roadways += [
            Roadway(f"c{k}", f"n{k}", 4.6, 3.2, roughness=0.08),
            Roadway(f"c{k}", f"s{k}", 4.6, 3.2, roughness=0.08),
        ]
    roadways += [
        Roadway("start", "c0", 4.6, 3.2, roughness=0.08),
        Roadway(f"c{crossings - 1}", "end", 4.6, 3.2, roughness=0.08),
    ]
    roadways += [Roadway(f"c{k}", f"c{k + 1}", 4.6, 3.2, roughness=0.0) for k in range(crossings - 1)]
    route = ("start", *(f"c{k}" for k in range(crossings)), "end")
    return MineScenario("drifts", nodes, tuple(roadways), route, relief=0.0, seed=seed)


def row_of(result: LocalizationResult, there: SemanticMap, truth: Trajectory) -> Row:
    """Figures of one flight, in the map frame without alignment but for the odometry, which starts on the truth."""
    start = truth.at(result.odometry.stamps_ns[:1])[0] @ np.linalg.inv(result.odometry.poses[0])
    odometry = errors(Trajectory("map", result.odometry.stamps_ns, start @ result.odometry.poses), truth)
    live, final = errors(result.realtime, truth), errors(result.trajectory, truth)
    first: dict[int, int] = {}
    for event in result.events:
        for pin in event.get("pins", []):
            first.setdefault(pin["id"], event["stamp_ns"])
    stamps = result.realtime.stamps_ns
    after = np.concatenate(
        [live[(stamps >= at) & (stamps < at + 2 * 10**9)] for at in first.values()] or [np.full(1, np.nan)]
    )
    told = passes(result, there, truth)
    return Row(
        float(odometry.max()), _rms(live), _live_nees(result, truth), float(after.max()), _rms(final),
        float(final.max(initial=0.0)), _final_nees(result, truth), told.passes, told.constrained, told.false,
    )  # fmt: skip


def _live_nees(result: LocalizationResult, truth: Trajectory) -> float:
    """Mean over the poses in real time of the position's normalised error squared, by its dimension."""
    P = {row.stamp_ns: row.position_map for row in result.uncertainty if row.position_map is not None}
    off = result.realtime.positions - truth.at(result.realtime.stamps_ns)[:, :3, 3]
    return _nees(off, [P[stamp] for stamp in result.realtime.stamps_ns.tolist()])


def _final_nees(result: LocalizationResult, truth: Trajectory) -> float:
    """The same of the smoothed keyframes."""
    stamps = np.array([stamp for stamp, _ in result.smoothed], np.int64)
    poses = result.trajectory.at(stamps)
    # covariances are in the axes of the imu
    off = np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3] - truth.at(stamps)[:, :3, 3])
    return _nees(off, [covariance[3:, 3:] for _, covariance in result.smoothed])


def _nees(off: Array, covariances: list[Array]) -> float:
    squared = [e @ np.linalg.solve(P, e) / 3.0 for e, P in zip(off, covariances, strict=True)]
    return float(np.mean(squared)) if squared else float("nan")


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    rows = []
    for seed in range(1, options.seeds + 1):
        mine = dig(drifts(seed))
        there = map_of(mine, seed)
        flight = fly(mine, rig=drift_rig(), settings=SimulationSettings(), seed=seed)
        measurements = list(simulate_measurements(flight))
        for without in ((), ("wheel",)):
            localizer = Localizer(flight.rig.without(*without), there)
            stream(localizer, measurements)
            row = row_of(localizer.finish(), there, flight.truth())
            told = (f"{row.constrained}/{row.passes}", str(row.false))
            name = f"{seed} without wheel" if without else f"{seed} with wheel"
            rows.append([name, *(f"{figure:.3f}" for figure in astuple(row)[:7]), *told])
            print(rows[-1], flush=True)
    head = (
        "mine",
        "odometry max",
        "real time RMSE",
        "NEES",
        "after a pin max",
        "RMSE",
        "max",
        "NEES",
        "constrained",
        f"false (> {FALSE_M} m)",
    )
    Console().print(text_table(head, rows))


def drift_rig() -> Rig:
    """The default rig with a LiDAR that sees `MAX_RANGE_M`."""
    rig = default_rig()
    assert rig.lidar is not None
    lidar = LidarBlock(**{**rig.lidar.model_dump(exclude_unset=True), "max_range": MAX_RANGE_M})
    return rig.model_copy(update={"lidar": lidar})


if __name__ == "__main__":
    main()
