"""One system over one cached recording, in a process of its own; `tools.bench.odometry` starts it.

    python -m tools.bench.odometry_run RECORDING_DIRECTORY --system rko-lio:mine --out result.npz

NumPy and the standard library only, so that it runs in the peers' environment too.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from tools.bench.odometry_cache import OrganisedScan, Recorded
from tools.bench.peers import PEERS, Estimate, System

OURS = "semmap"


def is_ours(system: str) -> bool:
    """Whether it is semmap's own, whatever its settings."""
    return system.partition(":")[0] == OURS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--system", required=True)
    parser.add_argument("--cores", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    if options.cores:
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-options.cores :])
    recorded = Recorded.open(options.recording)
    np.savez(options.out, **driven(made(options.system, recorded), recorded))


def made(name: str, recorded: Recorded) -> System:
    """A system by name: ``name`` or ``name:set`` of settings, `shipped` if no set is named; ours with its own,
    ``semmap:voxel_size=0.45+scan_voxel=0.5``."""
    name, _, chosen = name.partition(":")
    if name == OURS:
        from tools.bench.odometry_ours import Ours, settings_of

        return Ours(recorded, settings_of(chosen))
    return PEERS[name].make(recorded, PEERS[name].settings[chosen or "shipped"])


def driven(system: System, recorded: Recorded) -> dict[str, Any]:
    """Feed everything; estimates, and what each scan took.

    Returns ``stamps_ns`` (n,), ``poses`` (n, 4, 4), ``covariances`` (n, 6, 6) or (0,) of the estimates; ``scan_ms``,
    ``imu_ms``, ``cpu_ms`` (k,) of the k scans: wall time inside the scan's call, inside the calls for the IMU
    samples before it, and processor time of all threads in both; ``memory_mb`` (2,), the peak before the first
    scan and at the end.
    """
    costs, estimates, memory = [], [], [peak_mb()]
    for rows, scan in recorded.in_order():
        costs.append(_step(system, recorded, rows, scan))
        estimates += system.estimates()
    memory.append(peak_mb())
    scan_ms, imu_ms, cpu_ms = np.array(costs).T
    return {
        **_columns(estimates),
        "scan_ms": scan_ms,
        "imu_ms": imu_ms,
        "cpu_ms": cpu_ms,
        "memory_mb": np.array(memory),
    }


def _step(system: System, recorded: Recorded, rows: slice, scan: OrganisedScan) -> tuple[float, float, float]:
    """The IMU samples and the scan after them: milliseconds of the scan, of the samples, and of the processor."""
    samples = list(zip(recorded.imu_ns[rows].tolist(), recorded.gyro[rows], recorded.accel[rows], strict=True))
    cpu, wall = [time.process_time()], [time.perf_counter()]
    for stamp_ns, gyro, accel in samples:
        system.imu(stamp_ns, gyro, accel)
    wall.append(time.perf_counter())
    cpu.append(time.process_time())
    prepared = system.prepare(scan)
    cpu.append(time.process_time())
    wall.append(time.perf_counter())
    system.scan(prepared)
    wall.append(time.perf_counter())
    cpu.append(time.process_time())
    return 1e3 * (wall[3] - wall[2]), 1e3 * (wall[1] - wall[0]), 1e3 * (cpu[3] - cpu[2] + cpu[1] - cpu[0])


def _columns(estimates: list[Estimate]) -> dict[str, Any]:
    return {
        "stamps_ns": np.array([one.stamp_ns for one in estimates], np.int64),
        "poses": np.array([one.pose for one in estimates]).reshape(-1, 4, 4),
        "covariances": np.array([one.covariance for one in estimates if one.covariance is not None]),
    }


def peak_mb() -> float:
    """Peak memory of this process [MB]; getrusage would count the process that started it as well."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(status.split("VmHWM:")[1].split()[0]) / 1024.0


if __name__ == "__main__":
    main()
