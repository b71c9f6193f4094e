"""How fast the robot goes in its first scans, from registering one to another, before any filter runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import small_gicp

from localize.dust import Air
from semmap.geometry import Array, inverse
from semmap.measurements import Scan

_APART_S = 0.15
"""Scans this far apart show a walking pace clearly, and a few metres per second still overlap [s]."""
_PAIRS = 3
_VOXEL_M = 0.25
_FASTEST_MPS = 10.0
"""What two scans of one place may be apart is this speed's way between them."""
_LEAST_POINTS = 500


def first_velocity(scans: Sequence[Scan], T_imu_lidar: Array) -> Array | None:
    """Velocity (3,) of the imu in its own axes during the first scans [m/s]; None where they do not tell.

    scans : in order of time, as measured: two scans that follow one another are distorted alike.

    A filter that begins with a guess metres per second off matches its second scan to the wrong rock. Generalized ICP
    has no prior and a wide reach; the median of a few pairs is what goes on to the filter, as the start of its own
    estimate. Along a drift without structure it tells nothing, and neither does anything else.
    """
    found: list[Array] = []
    for begin, scan in enumerate(scans):
        later = next((other for other in scans[begin + 1 :] if _seconds(scan, other) >= _APART_S), None)
        if later is None or len(found) == _PAIRS:
            break
        velocity = _velocity_between(scan, later, T_imu_lidar)
        if velocity is not None:
            found.append(velocity)
    return np.median(found, axis=0) if found else None


def _seconds(scan: Scan, later: Scan) -> float:
    return (later.end_ns - scan.end_ns) * 1e-9


def _velocity_between(scan: Scan, later: Scan, T_imu_lidar: Array) -> Array | None:
    target, source = (one.points[Air(one.points).clear].astype(np.float64) for one in (scan, later))
    if min(len(target), len(source)) < _LEAST_POINTS:
        return None
    seconds = _seconds(scan, later)
    result = small_gicp.align(
        target, source, downsampling_resolution=_VOXEL_M, max_correspondence_distance=_FASTEST_MPS * seconds,
        num_threads=1,
    )  # fmt: skip
    if not result.converged:
        return None
    T = T_imu_lidar @ result.T_target_source @ inverse(T_imu_lidar)
    return np.asarray(T[:3, 3] / seconds)
