"""Other people's odometries in the roadheader's dust: the same samples and scans, by `tools.bench.odometry_run`."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import numpy as np

from semmap.trajectory import Trajectory
from tools.bench.odometry import ROOT, trajectory_of
from tools.bench.odometry_recordings import simulate
from tools.simulator.flight import Flight


def peer_track(system: str, flight: Flight, recording: Path, python: Path) -> Trajectory:
    """Poses of the IMU in the system's own frame; empty where it gave none.

    recording : directory that the flight is recorded to, if it is not there. python : of the environment that has the
    system.
    """
    if not recording.exists():
        simulate(flight, recording, {"recording": recording.name}, lambda done, of: None)
    result = recording.parent / f"{recording.name}-{system.replace(':', '-')}.npz"
    command = [str(python), "-m", "tools.bench.odometry_run", str(recording.resolve()), "--system", system]
    with result.with_suffix(".log").open("w") as said:
        code = subprocess.run(
            [*command, "--out", str(result.resolve())], cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=said, stderr=said, check=False,
        ).returncode  # fmt: skip
    if code or not result.is_file():
        return Trajectory("odom", np.zeros(0, np.int64), np.zeros((0, 4, 4)))
    return trajectory_of(dict(np.load(result)))[0]
