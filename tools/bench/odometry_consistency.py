"""Does the odometry's covariance tell the truth? Errors of many flights against it, block by block.

    python -m tools.bench.odometry_consistency --mine random --seeds 20 --seconds 40

Every flight has its own mine, noise and biases. In the mean over the flights the normalised error squared of a block of
three must lie in the 95 % bounds that the chi-squared distribution gives for so many. LiDAR and IMU only.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.stats import chi2

from localize.odometry import OdometryPose
from localize.settings import KeyframeSettings, OdometrySettings
from localize.start import StartingOdometry
from localize.state import ACCEL_BIAS, GYRO_BIAS, POSITION, ROTATION, VELOCITY
from semmap.geometry import Array, inverse, so3_log
from semmap.rig import LidarBlock, Rig
from tools.bench.odometry_recordings import tunnel
from tools.files import write_text
from tools.simulator import Mine, SimulationSettings, default_rig, dig, fly, scenario, simulate_measurements
from tools.simulator.flight import Flight
from tools.simulator.imu import imu_biases
from tools.tables import text_table

BLOCKS = {
    "rotation": ROTATION,
    "position": POSITION,
    "velocity": VELOCITY,
    "gyro bias": GYRO_BIAS,
    "accel bias": ACCEL_BIAS,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mine", default="random", help="a built-in scenario, or `tunnel`")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--start", type=float, default=0.0, help="begin in motion, so many seconds into the flight")
    parser.add_argument("--range", type=float, help="of the LiDAR [m]")
    parser.add_argument("--out", type=Path, default=Path("bench_consistency"))
    options = parser.parse_args()
    rig = _rig(options.range)
    runs = []
    for seed in range(1, options.seeds + 1):
        flight = fly(
            _mine(options.mine, seed),
            rig=rig,
            settings=SimulationSettings(duration_s=options.seconds, start_s=options.start),
            seed=seed,
        )
        runs.append(normalised_errors(flight))
    options.out.mkdir(parents=True, exist_ok=True)
    rows = report(runs)
    write_text(options.out / "consistency.json", json.dumps(rows, indent=1) + "\n")
    low, high = chi2.ppf([0.025, 0.975], 3 * len(runs)) / len(runs)
    title = f"{options.mine}, {len(runs)} flights: mean normalised error squared of 3 (95 %: {low:.2f} to {high:.2f})"
    lines = [[f"{row['seconds']:.1f}", *(_cell(row, name) for name in BLOCKS)] for row in rows]
    Console(width=150).print(text_table(("s", *BLOCKS), lines, title=title))


def _rig(max_range: float | None) -> Rig:
    rig = default_rig().without("wheel")
    if max_range is None or rig.lidar is None:
        return rig
    lidar = LidarBlock(**{**rig.lidar.model_dump(exclude_unset=True), "max_range": max_range})
    return Rig(frame=rig.frame, imu=rig.imu, lidar=lidar)


def _mine(name: str, seed: int) -> Mine:
    return dig(tunnel(seed)) if name == "tunnel" else scenario(name, seed=seed)


def normalised_errors(flight: Flight) -> dict[str, Array]:
    """Of one flight, by scan: ``seconds`` (n,), and for each block the normalised error squared (n,), and
    ``error`` and ``sigma`` (n,), the roots of the sums of squares and of the variances."""
    odometry = StartingOdometry(flight.rig, OdometrySettings(), KeyframeSettings())
    poses = [pose for measurement in simulate_measurements(flight) for pose in odometry.add(measurement)]
    errors = _errors(flight, poses, odometry.T_odom_start)
    begin_ns = int(flight.stamps(flight.rig.imu.rate_hz or 200.0)[0])
    out = {"seconds": np.array([pose.stamp_ns - begin_ns for pose in poses]) * 1e-9}
    for name, block in BLOCKS.items():
        covariances = np.array([pose.covariance[block, block] for pose in poses]) + 1e-14 * np.eye(3)
        weighted = np.linalg.solve(covariances, errors[name][..., None])[..., 0]
        out[name] = np.einsum("ni,ni->n", errors[name], weighted)
        out[f"{name} error"] = np.linalg.norm(errors[name], axis=1)
        out[f"{name} sigma"] = np.sqrt(np.trace(covariances, axis1=1, axis2=2))
    return out


def _errors(flight: Flight, poses: list[OdometryPose], T_odom_start: Array) -> dict[str, Array]:
    """Errors (n, 3) of each block. Odom is where the robot was at the first IMU sample, turned as it was held to be."""
    stamps = np.array([pose.stamp_ns for pose in poses])
    imu_ns = flight.stamps(flight.rig.imu.rate_hz or 200.0)
    motion = flight.motion(flight.times(stamps))
    first = flight.motion(flight.times(imu_ns[:1])).poses()[0]
    T_odom_map = T_odom_start @ inverse(first)
    true = T_odom_map @ motion.poses()
    at = np.clip(np.searchsorted(imu_ns, stamps), 0, len(imu_ns) - 1)
    gyro_bias, accel_bias = imu_biases(flight)
    state: Callable[[str], Array] = lambda name: np.array([getattr(pose.state, name) for pose in poses])  # noqa: E731
    return {
        "rotation": so3_log(np.swapaxes(state("R"), 1, 2) @ true[:, :3, :3]),
        "position": true[:, :3, 3] - state("p"),
        "velocity": motion.velocity @ T_odom_map[:3, :3].T - state("v"),
        "gyro bias": gyro_bias[at] - state("gyro_bias"),
        "accel bias": accel_bias[at] - state("accel_bias"),
    }


def report(runs: list[dict[str, Array]], rows: int = 8) -> list[dict[str, float]]:
    """Means over the runs at a few moments: of each block, and its ``error`` and ``sigma`` (root mean squares)."""
    n = min(len(run["seconds"]) for run in runs)
    out = []
    for i in np.linspace(0.0, n - 1, rows + 1).astype(int)[1:]:
        row = {"seconds": float(runs[0]["seconds"][i])}
        for name in BLOCKS:
            row[name] = float(np.mean([run[name][i] for run in runs]))
            for what in ("error", "sigma"):
                row[f"{name} {what}"] = float(np.sqrt(np.mean([run[f"{name} {what}"][i] ** 2 for run in runs])))
        out.append(row)
    return out


def _cell(row: dict[str, float], name: str) -> str:
    return f"{row[name]:.2f} ({row[f'{name} error']:.2g} / {row[f'{name} sigma']:.2g})"


if __name__ == "__main__":
    main()
