"""From smoothed keyframes to a smoothed pose for every scan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semmap.geometry import Array, inverse, se3, so3_exp, so3_log
from semmap.trajectory import Trajectory


def smoothed(odometry: Trajectory, keyframe_stamps_ns: NDArray[np.int64], T_map_keyframe: Array) -> Trajectory:
    """Every odometry pose carried into the map by the keyframes around it.

    The correction ``T_map_odom`` of each keyframe (n,), (n, 4, 4) is interpolated over time, taken about the scan's own
    place so that a small turn far from odom's origin does not become a jump.
    """
    T_odom_keyframe = odometry.at(keyframe_stamps_ns)
    after = np.clip(np.searchsorted(keyframe_stamps_ns, odometry.stamps_ns), 1, max(1, len(keyframe_stamps_ns) - 1))
    after = np.minimum(after, len(keyframe_stamps_ns) - 1)
    before = np.maximum(after - 1, 0)
    from_before = T_map_keyframe[before] @ inverse(T_odom_keyframe[before]) @ odometry.poses
    from_after = T_map_keyframe[after] @ inverse(T_odom_keyframe[after]) @ odometry.poses
    span = np.maximum(keyframe_stamps_ns[after] - keyframe_stamps_ns[before], 1)
    share = np.clip((odometry.stamps_ns - keyframe_stamps_ns[before]) / span, 0.0, 1.0)
    turn = so3_log(np.swapaxes(from_before[:, :3, :3], 1, 2) @ from_after[:, :3, :3])
    R = from_before[:, :3, :3] @ so3_exp(share[:, None] * turn)
    p = (1.0 - share[:, None]) * from_before[:, :3, 3] + share[:, None] * from_after[:, :3, 3]
    return Trajectory("map", odometry.stamps_ns, se3(R, p))
