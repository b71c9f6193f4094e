"""A total station whose clock is off the robot's: where that puts flights that start in motion, and what they say.

    python -m tools.bench.prism_clock --seconds 40

A row a flight and offset: odometry and fixes alone, no database. The prism is in sight all the way, as of
one instrument after another. NEES is that of the pose in the map, 6 degrees of freedom. ``--std 0`` takes the clock at
its word.
"""

from __future__ import annotations

import argparse
import heapq
from collections.abc import Sequence

import numpy as np

from localize import Localizer
from localize.results import Update
from semmap.geometry import Array, so3_log
from semmap.measurements import Measurement, PrismFix
from semmap.rig import Rig
from semmap.trajectory import Trajectory
from tools.simulator import SimulationSettings, default_rig, fly, scenario, simulate_measurements, with_total_station
from tools.simulator.flight import Flight
from tools.simulator.measurements import arrival_ns

FLIGHTS = (("random", 1), ("ramp", 2), ("drift", 1), ("grid", 3))
OFFSETS_S = (-0.3, -0.1, 0.0, 0.1, 0.3)
START_S, SETTLED_S, FIRST = 15.0, 10.0, 20
"""Recordings begin in motion; what is off so long after the first pose is told apart, and NEES of the first poses."""
RATE_HZ = 5.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--std", type=float, default=0.1, help="time_offset_std of the rig [s]")
    options = parser.parse_args()
    print("mine       offset   first pose  off [m]: most  RMS  most after 10 s  final RMS  NEES: first, all  found [s]")
    for name, seed in FLIGHTS:
        mine = scenario(name, seed)
        rig = with_total_station(default_rig(), mine.scenario.route_floor()[0])
        assert rig.total_station is not None
        station = rig.total_station.model_copy(update={"time_offset_std": options.std})
        rig = rig.model_copy(update={"total_station": station})
        settings = SimulationSettings(start_s=START_S, duration_s=options.seconds)
        flight = fly(mine, rig=rig.without("prism"), settings=settings, seed=seed)
        others, fixes = list(simulate_measurements(flight)), fixes_all_the_way(flight, rig)
        for offset_s in OFFSETS_S:
            late = [PrismFix(fix.stamp_ns - round(offset_s * 1e9), fix.p_map) for fix in fixes]
            seen = heapq.merge(others, late, key=arrival_ns)
            print(f"{name:7s}{seed:3d} {offset_s:+8.1f} {row(rig, list(seen), flight.truth())}", flush=True)


def fixes_all_the_way(flight: Flight, rig: Rig) -> list[PrismFix]:
    """Fixes with the rig's noise, whatever rock there is between."""
    assert rig.total_station is not None
    stamps = flight.stamps(RATE_HZ)
    prism = flight.motion(flight.times(stamps)).point(np.array(rig.total_station.p_imu_prism))
    noisy = prism + rig.total_station.point_std * np.random.default_rng([flight.seed, 41]).normal(size=prism.shape)
    return [PrismFix(stamp, fix) for stamp, fix in zip(stamps.tolist(), noisy, strict=True)]


def row(rig: Rig, measurements: Sequence[Measurement], truth: Trajectory) -> str:
    """The figures of one run."""
    localizer = Localizer(rig)
    updates = [u for m in measurements if (u := localizer.add(m)) is not None and u.T_map_imu is not None]
    result = localizer.finish()
    if not updates:
        return "no place in the map"
    errors = np.array([_error(u, truth) for u in updates])
    nees = np.array([e @ np.linalg.solve(u.covariance, e) for u, e in zip(updates, errors, strict=True)])
    off, t = np.linalg.norm(errors[:, 3:], axis=1), np.array([u.stamp_ns - truth.stamps_ns[0] for u in updates]) * 1e-9
    final = result.trajectory.positions - truth.at(result.trajectory.stamps_ns)[:, :3, 3]
    clock = result.summary["prism_clock_offset"]
    return (
        f"{t[0]:10.1f} s {off.max():15.3f} {_rms(off):7.4f} {off[t > t[0] + SETTLED_S].max():13.3f}"
        f" {_rms(np.linalg.norm(final, axis=1)):12.4f} {nees[:FIRST].mean():12.1f} {nees.mean():5.1f}"
        f"   {clock['offset_s']:+.4f} ± {clock['std_s']:.4f}"
    )


def _error(update: Update, truth: Trajectory) -> Array:
    """Of the pose (6,), rotation first, perturbed on the right."""
    assert update.T_map_imu is not None
    true, R = truth.at(np.array([update.stamp_ns]))[0], update.T_map_imu[:3, :3]
    return np.concatenate([so3_log(true[:3, :3].T @ R), R.T @ (update.T_map_imu[:3, 3] - true[:3, 3])])


def _rms(off: Array) -> float:
    return float(np.sqrt(np.mean(off**2)))


if __name__ == "__main__":
    main()
