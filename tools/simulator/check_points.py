"""Check points along a way, as a total station takes them while the robot passes (paper 000, section VI)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semmap.files import written_whole
from semmap.trajectory import Trajectory

COUNT = 15
_RESOLUTION = 1e-6
"""[m] by which the last point may be missed: it is where the robot stops."""


def check_stamps(truth: Trajectory, count: int = COUNT) -> NDArray[np.int64]:
    """Stamps (count,) of poses at equal distances along the way; the last is the first at the way's end."""
    steps = np.linalg.norm(np.diff(truth.positions, axis=0), axis=1)
    flown = np.concatenate([[0.0], np.cumsum(steps)])
    at = flown[-1] * np.arange(1, count + 1) / count - _RESOLUTION
    return np.asarray(truth.stamps_ns[np.searchsorted(flown, at)])


def save_check_points(path: str | Path, truth: Trajectory, count: int = COUNT) -> None:
    """Write ``name,time,x,y,z`` lines: positions of the IMU in the map [m] at times [s]."""
    stamps = check_stamps(truth, count)
    with written_whole(path) as temporary, temporary.open("w", encoding="utf-8") as out:
        out.write("name,time,x,y,z\n")
        for number, (stamp, (x, y, z)) in enumerate(zip(stamps.tolist(), truth.at(stamps)[:, :3, 3], strict=True), 1):
            out.write(f"{number},{stamp // 10**9}.{stamp % 10**9:09d},{x:.4f},{y:.4f},{z:.4f}\n")
