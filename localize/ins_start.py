"""How the INS/total-station filter begins: a machine that stands, and one fix of its prism; or some on the way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from localize.earth import Earth
from localize.ins_total_station import ACCEL_BIAS, DIM, GYRO_BIAS, POSITION, ROTATION, VELOCITY, InsState
from localize.static_alignment import StaticAlignment
from semmap.geometry import Array, rotation_between, skew, so3_exp, yaw_rotation
from semmap.measurements import PrismFix
from semmap.rig import ImuBlock, TotalStationBlock

_SHAKE_STD = 0.005
"""Of the velocity of a machine at rest with its engines on [m/s]."""
_SURE_HEADING = 0.1
_LEAN_STD, _SPEED_STD = 0.002, 0.05
"""Of what fixes on the way tell of the vertical [rad] and the velocity [m/s], beside their own noise."""


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


def moving_start(
    fixes: Sequence[PrismFix],
    gyro: Array,
    accel: Array,
    heading: float,
    heading_std: float,
    imu: ImuBlock,
    station: TotalStationBlock,
    earth: Earth,
) -> tuple[InsState, Array]:
    """State and covariance (15, 15) at the last of some fixes on the way, with a heading [rad] that is supposed.

    gyro, accel : (3,) in the mean over the fixes. They tell velocity and acceleration of the prism, by a parabola, and
    what the accelerometer felt beside that points up.
    """
    t = np.array([(fix.stamp_ns - fixes[-1].stamp_ns) * 1e-9 for fix in fixes])
    half_a, v, p = np.polyfit(t, np.array([fix.p_map for fix in fixes]), 2)
    from_heading, lever, span_s = yaw_rotation(heading), np.array(station.p_imu_prism), -t[0]
    up = 2.0 * half_a + np.array([0.0, 0.0, earth.gravity])
    # felt in the mean over the fixes, that is at their middle
    R = from_heading @ rotation_between(accel, from_heading.T @ up) @ so3_exp(0.5 * span_s * gyro)
    state = InsState(R, p - R @ lever, v - R @ np.cross(gyro, lever), np.zeros(3), np.zeros(3))
    # of a parabola through evenly spaced points, at its end
    p_std, v_std, a_std = station.point_std * np.array([3.0, 14.0 / span_s, 27.0 / span_s**2]) / np.sqrt(len(t))
    lean_std = np.sqrt(_LEAN_STD**2 + (a_std / earth.gravity) ** 2 + (0.5 * span_s * imu.gyro_bias_std) ** 2)
    # a lean that the accelerometer's bias makes is none of the force: it must not be taken for one in another heading
    rotation = np.hstack([
        heading_std * R[2][:, None], imu.accel_bias_std * skew(R[2]) / earth.gravity, lean_std * R[:2].T,
    ])  # fmt: skip
    first = np.zeros((DIM, 6))
    first[ROTATION], first[POSITION] = rotation, R @ skew(lever) @ rotation
    first[ACCEL_BIAS, 1:4] = imu.accel_bias_std * np.eye(3)
    P = first @ first.T
    P[POSITION, POSITION] += p_std**2 * np.eye(3)
    P[VELOCITY, VELOCITY] += np.hypot(_SPEED_STD, v_std) ** 2 * np.eye(3)
    P[GYRO_BIAS, GYRO_BIAS] += (imu.gyro_bias_std**2 + float(np.sum(earth.rate[:2] ** 2))) * np.eye(3)
    return state, P
