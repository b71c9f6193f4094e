"""Loops by Scan Context on somebody's odometry: the usual back end, as a row beside ours in `tools.bench.edgar`.

    python -m tools.bench.scan_context_loops RECORDING_DIRECTORY --odometry loam.npz --out loam_sc.npz

As in SC-LeGO-LOAM and SC-A-LOAM: a keyframe every metre, those of the last 50 m left out, the context nearest of ten by
ring key and below 0.2, ICP from there against the keyframes around the match, accepted below a mean squared distance of
0.3 m², a pose graph with the same noise for all links and a robust loss on the loops.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from descriptors.scan_context import context_distance, ring_key, scan_context
from localize.graph import PoseGraph
from localize.settings import GraphSettings
from localize.smoothing import smoothed
from localize.voxel_map import voxel_means
from semmap.geometry import Array, inverse, rotation_between, se3, transform, yaw_rotation
from semmap.trajectory import Trajectory
from tools.bench.odometry_cache import Recorded

Rows = NDArray[np.int64]

STEP_M, RECENT, CANDIDATES, AROUND = 1.0, 50, 10, 10
MOST_DISTANCE, MOST_SQUARED_M2 = 0.2, 0.3
VOXEL_M = 0.4
_LINK = np.diag(np.repeat([0.002, 0.01], 3) ** 2)
_LOOP = np.diag(np.repeat([0.01, 0.1], 3) ** 2)


@dataclass(frozen=True, slots=True)
class Loop:
    """Keyframe ``later`` saw what keyframe ``earlier`` had seen, from ``T_earlier_later`` (4, 4)."""

    earlier: int
    later: int
    T_earlier_later: Array


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--odometry", type=Path, required=True, help="what `tools.bench.odometry_run` wrote")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    found = np.load(options.odometry)
    odometry = Trajectory("odom", found["stamps_ns"], found["poses"])
    rows = keyframes_of(odometry)
    clouds = clouds_of(Recorded.open(options.recording), odometry, rows)
    loops = loops_of(odometry.poses[rows], clouds)
    closed = corrected(odometry, rows, loops)
    pairs = np.array([(loop.earlier, loop.later) for loop in loops]).reshape(-1, 2)
    np.savez(options.out, stamps_ns=closed.stamps_ns, poses=closed.poses, loops=len(loops), pairs=rows[pairs])


def keyframes_of(odometry: Trajectory) -> Rows:
    """Rows (k,) of the odometry a metre apart."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(odometry.positions, axis=0), axis=1))])
    rows: Rows = np.unique(np.searchsorted(way, np.arange(0.0, way[-1], STEP_M)))
    return rows


def clouds_of(recorded: Recorded, odometry: Trajectory, rows: Rows) -> list[Array]:
    """Each keyframe's points (n, 3) in its imu frame, deskewed by the odometry, thinned."""
    clouds: list[Array] = []
    for _, scan in recorded.in_order():
        if len(clouds) == len(rows):
            break
        stamp_ns = int(odometry.stamps_ns[rows[len(clouds)]])
        if not scan.stamp_ns <= stamp_ns <= scan.end_ns:
            continue
        stamps = np.clip(scan.stamp_ns + scan.offsets_ns, odometry.stamps_ns[0], odometry.stamps_ns[-1])
        T = inverse(odometry.poses[rows[len(clouds)]]) @ odometry.at(stamps) @ recorded.T_imu_lidar
        points = np.einsum("cij,bcj->bci", T[:, :3, :3], scan.cloud()) + T[:, :3, 3]
        clouds.append(voxel_means(points[scan.ranges > 0.0], VOXEL_M))
    return clouds


def loops_of(poses: Array, clouds: list[Array]) -> list[Loop]:
    """What looks like a keyframe of long ago and registers to it."""
    upright = [_upright(T) for T in poses]
    contexts = [scan_context(cloud @ R.T) for R, cloud in zip(upright, clouds, strict=False)]
    keys = np.array([ring_key(context) for context in contexts])
    loops = []
    for later in range(RECENT, len(contexts)):
        off = np.linalg.norm(keys[: later - RECENT + 1] - keys[later], axis=1)
        rows = np.argsort(off, kind="stable")[:CANDIDATES]
        best = min((*context_distance(contexts[later], contexts[row]), int(row)) for row in rows)
        distance, yaw, earlier = best
        if distance > MOST_DISTANCE:
            continue
        start = se3(upright[earlier].T @ yaw_rotation(yaw) @ upright[later], np.zeros(3))
        T = registered(clouds[later], _submap(poses, clouds, earlier), start)
        if T is not None:
            loops.append(Loop(earlier, later, T))
    return loops


def _upright(T: Array) -> Array:
    """Rotation (3, 3) that levels a pose and keeps its heading, by the odometry's vertical."""
    return rotation_between(T[:3, :3].T @ np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]))


def _submap(poses: Array, clouds: list[Array], row: int) -> Array:
    """Points (n, 3) of the keyframes around one, in its frame."""
    near = range(max(0, row - AROUND), min(len(clouds), row + AROUND + 1))
    back = inverse(poses[row])
    return voxel_means(np.concatenate([transform(back @ poses[k], clouds[k]) for k in near]), VOXEL_M)


def registered(points: Array, submap: Array, start: Array) -> Array | None:
    """Where (4, 4) ICP leads; None where it does not fit."""
    result = small_gicp.align(
        submap, points, init_T_target_source=start, registration_type="PLANE_ICP",
        max_correspondence_distance=2.0, downsampling_resolution=VOXEL_M / 2.0, num_threads=1,
    )  # fmt: skip
    T = np.array(result.T_target_source)
    distances, _ = cKDTree(submap).query(transform(T, points))
    return T if result.converged and float(np.mean(distances**2)) < MOST_SQUARED_M2 else None


def corrected(odometry: Trajectory, rows: Rows, loops: list[Loop]) -> Trajectory:
    """The odometry with its loops closed; its verticals are its own."""
    graph = PoseGraph(GraphSettings(vertical_std=10.0))
    poses = odometry.poses[rows]
    for before, T in zip([poses[0], *poses[:-1]], poses, strict=True):
        graph.add_keyframe(T, np.array([0.0, 0.0, 1.0]), inverse(before) @ T, _LINK)
    graph.anchor(np.eye(4), known=True)
    graph.solve()
    for earlier in sorted({loop.earlier for loop in loops}):
        graph.add_intersection(earlier, earlier, np.eye(4), 1e-8 * np.eye(6))
    for loop in loops:
        T = graph.intersection(loop.earlier)
        graph.pin_intersection(loop.later, loop.earlier, T, T @ loop.T_earlier_later, _LOOP)
    graph.solve(steps=20)
    return smoothed(odometry, odometry.stamps_ns[rows], graph.poses())


if __name__ == "__main__":
    main()
