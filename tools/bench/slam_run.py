"""KISS-SLAM over one cached recording, in a Python environment that has `kiss-slam`; `tools.bench.edgar` shows the row.

    python -m tools.bench.slam_run RECORDING_DIRECTORY --out kiss_slam.npz

NumPy and the standard library only beside it. Settings are its own but for what its documentation advises for narrow
places: half-metre voxels, local maps of 50 m. Poses are the final ones, optimised scan by scan, as its pipeline saves.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from tools.bench.odometry_cache import Array, Recorded


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    stamps_ns, poses, loops, scan_ms = kiss_slam(Recorded.open(options.recording))
    np.savez(options.out, stamps_ns=stamps_ns, poses=poses, loops=loops, scan_ms=scan_ms)


def kiss_slam(recorded: Recorded) -> tuple[Array, Array, int, Array]:
    """Stamps (n,) [ns] and poses (n, 4, 4) of the IMU, how many loops it closed, and what each scan cost [ms]."""
    from kiss_slam.config import load_config
    from kiss_slam.slam import KissSLAM

    config = load_config(None)
    lidar = recorded.about["rig"]["lidar"]
    config.odometry.preprocessing.min_range = lidar["min_range"]
    config.odometry.preprocessing.max_range = lidar["max_range"]
    config.odometry.preprocessing.deskew = True
    config.odometry.mapping.voxel_size = 0.5
    config.local_mapper.splitting_distance = 50.0
    slam, stamps, costs = KissSLAM(config), [], []
    for _, scan in recorded.in_order():
        points, offsets_ns, _ = scan.returns()
        began = time.process_time()
        slam.process_scan(points.astype(np.float64), offsets_ns / recorded.offsets_ns[-1])
        costs.append(1e3 * (time.process_time() - began))
        stamps.append(scan.end_ns)
    slam.generate_new_node()
    slam.local_map_graph.erase_last_local_map()
    poses, _ = slam.fine_grained_optimization()
    T_imu_lidar = recorded.T_imu_lidar
    moved = T_imu_lidar @ np.array(poses)[: len(stamps)] @ np.linalg.inv(T_imu_lidar)
    return np.array(stamps[: len(moved)]), moved, len(slam.get_closures()), np.array(costs)


if __name__ == "__main__":
    main()
