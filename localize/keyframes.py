"""Keyframes: which scans are kept, and the stack of the last ones (paper 004 Eq. 8, 9, 20)."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localize.odometry import OdometryPose
from localize.settings import KeyframeSettings
from localize.voxel_map import voxel_means
from semmap.geometry import Array, inverse, rotation_between, se3, transform, yaw_rotation

_KEPT = 60
"""Keyframes kept: those of a passage of one intersection."""


@dataclass(frozen=True, slots=True)
class Keyframe:
    """A scan that was kept.

    index : number from 0. T_odom_imu : (4, 4), one motion on top of the other: ranges, or the end of a smooth drift,
    move the filter's odom, but not this. up_odom : (3,) unit vector against gravity.
    points : (n, 3) float32, deskewed and thinned, in the imu frame.
    p_imu_sensor : (3,) where the lidar was. way_std : of the way from the keyframe before [m].
    """

    index: int
    stamp_ns: int
    T_odom_imu: Array
    up_odom: Array
    points: NDArray[np.float32]
    p_imu_sensor: Array
    way_std: float


@dataclass(frozen=True, slots=True)
class Stack:
    """Keyframes in the gravity-aligned frame of the last one: z up, origin at its imu, heading of odom.

    T_odom_local : (4, 4). clouds : for each keyframe its points (n, 3). sensors : (k, 3) where each was seen from.
    """

    T_odom_local: Array
    clouds: tuple[NDArray[np.float32], ...]
    sensors: Array

    @property
    def points(self) -> NDArray[np.float32]:
        """All points (n, 3)."""
        return np.concatenate(self.clouds)


class Keyframes:
    """The last keyframes."""

    def __init__(self, settings: KeyframeSettings) -> None:
        self.settings = settings
        self.count = 0
        self._last: deque[Keyframe] = deque(maxlen=max(settings.stacked, _KEPT))

    def add(self, pose: OdometryPose, T_odom_imu: Array) -> Keyframe:
        """Keep a scan; ``T_odom_imu`` (4, 4) is its place in an odom that nothing ever moved."""
        keyframe = Keyframe(
            self.count,
            pose.stamp_ns,
            T_odom_imu,
            T_odom_imu[:3, :3] @ pose.up_imu,
            voxel_means(pose.points, self.settings.voxel).astype(np.float32),
            pose.state.T_imu_lidar[:3, 3],
            float(np.sqrt(np.trace(pose.since_keyframe[3:, 3:]))),
        )
        self.count += 1
        self._last.append(keyframe)
        return keyframe

    def forget(self) -> None:
        """The odometry begins anew: those before are in another frame."""
        self._last.clear()

    @property
    def kept(self) -> tuple[Keyframe, ...]:
        """All that are kept, oldest first."""
        return tuple(self._last)

    @property
    def last(self) -> tuple[Keyframe, ...]:
        """Those that are stacked, oldest first (paper 004 Eq. 20): as far back as the way is known well enough."""
        return well_known(self.kept[-self.settings.stacked :], self.settings.stacked_std)


def well_known(keyframes: Sequence[Keyframe], std: float) -> tuple[Keyframe, ...]:
    """The last of some keyframes: as far back as the way to the last is known to ``std`` [m]."""
    back = np.cumsum([0.0, *(keyframe.way_std for keyframe in reversed(keyframes))])[: len(keyframes)]
    known = int(np.searchsorted(back, std, side="right"))
    return tuple(keyframes[-known:])


def stacked(keyframes: Sequence[Keyframe], yaw: float = 0.0) -> Stack:
    """Keyframes in the gravity-aligned frame of the last (paper 004 Eq. 20), turned by ``yaw`` [rad] against odom."""
    newest = keyframes[-1]
    R_local_odom = yaw_rotation(yaw) @ rotation_between(newest.up_odom, [0.0, 0.0, 1.0])
    T_odom_local = se3(R_local_odom.T, newest.T_odom_imu[:3, 3])
    T_local_odom = inverse(T_odom_local)
    clouds, sensors = [], []
    for keyframe in keyframes:
        T_local_imu = T_local_odom @ keyframe.T_odom_imu
        clouds.append(transform(T_local_imu, keyframe.points).astype(np.float32))
        sensors.append(transform(T_local_imu, keyframe.p_imu_sensor[None])[0])
    return Stack(T_odom_local, tuple(clouds), np.array(sensors))
