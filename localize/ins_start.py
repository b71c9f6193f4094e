"""How the INS/total-station filter begins: a machine that stands, and one fix of its prism."""

from __future__ import annotations

import numpy as np

from localize.earth import Earth
from localize.ins_total_station import ACCEL_BIAS, DIM, GYRO_BIAS, POSITION, ROTATION, VELOCITY, InsState
from localize.static_alignment import StaticAlignment
from semmap.geometry import Array, skew
from semmap.measurements import PrismFix
from semmap.rig import ImuBlock, TotalStationBlock

_SHAKE_STD = 0.005
"""Of the velocity of a machine at rest with its engines on [m/s]."""
_SURE_HEADING = 0.1


def standing_start(
    alignment: StaticAlignment, fix: PrismFix, imu: ImuBlock, station: TotalStationBlock, earth: Earth
) -> tuple[InsState, Array]:
    """State and covariance (15, 15) at a fix (or the mean of some) taken at rest.

    The errors hang together, and the covariance says so: the lean is the accelerometer's bias over gravity, the place
    of the imu behind the lever arm turns with the attitude, and the gyroscope's bias is what is left of the mean rate
    after the earth's rate, which comes through that attitude. The accelerometer's bias begins at zero.
    """
    R, lever = alignment.R_map_imu, np.array(station.p_imu_prism)
    state = InsState(R, fix.p_map - R @ lever, np.zeros(3), alignment.gyro_bias, np.zeros(3))
    up, root_s = R[2], np.sqrt(alignment.duration_s)
    lean = skew(up) / earth.gravity
    rotation = np.hstack([alignment.heading_std * up[:, None], imu.accel_bias_std * lean])
    rotation = np.hstack([rotation, imu.accel_noise / root_s * lean])
    # what is wrong, column by column: heading, accelerometer bias and noise; gyroscope noise, fix, velocity
    first = np.zeros((DIM, 7))
    first[ROTATION] = rotation
    first[POSITION] = R @ skew(lever) @ rotation
    first[GYRO_BIAS] = -skew(R.T @ earth.rate) @ rotation
    first[ACCEL_BIAS, 1:4] = imu.accel_bias_std * np.eye(3)
    P = first @ first.T
    P[POSITION, POSITION] += station.point_std**2 * np.eye(3)
    P[VELOCITY, VELOCITY] += _SHAKE_STD**2 * np.eye(3)
    P[GYRO_BIAS, GYRO_BIAS] += (imu.gyro_noise / root_s) ** 2 * np.eye(3)
    if not alignment.sure(heading_std=_SURE_HEADING):
        # the horizontal earth rate points anywhere, and went into the bias
        P[GYRO_BIAS, GYRO_BIAS] += float(np.sum(earth.rate[:2] ** 2)) * np.eye(3)
    return state, P
