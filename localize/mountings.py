"""What the filter has come to know of where its sensors sit on the robot."""

from __future__ import annotations

from typing import Any

import numpy as np

from localize.settings import ExtrinsicSettings, MountingSettings
from localize.state import LIDAR, TAG, WHEEL, NavState
from semmap.geometry import Array, quaternion_xyzw


def estimated_mountings(state: NavState, P: Array, settings: ExtrinsicSettings) -> dict[str, dict[str, Any]]:
    """The mountings that are estimated, by sensor, as a rig names them: ``p`` (3,) [m] and ``q_xyzw`` in the imu frame.

    ``p_std`` (3,) [m], per axis of the imu, and ``rotation_std`` (3,) [rad], per axis of the sensor, say what of them
    the motion has shown.
    """
    sensors: tuple[tuple[str, MountingSettings, Array, slice], ...] = (
        ("lidar", settings.lidar, state.T_imu_lidar, LIDAR),
        ("tag", settings.tag, state.T_imu_tag, TAG),
        ("wheel", settings.wheel, state.T_imu_wheel, WHEEL),
    )
    found = {}
    for sensor, mounting, T_imu_sensor, columns in sensors:
        if mounting.rotation_std or mounting.position_std:
            std = np.sqrt(np.diag(P)[columns])
            found[sensor] = {
                "p": T_imu_sensor[:3, 3].tolist(),
                "q_xyzw": quaternion_xyzw(T_imu_sensor[:3, :3]).tolist(),
                "p_std": std[3:].tolist(),
                "rotation_std": std[:3].tolist(),
            }
    return found
