"""Attitude of a machine that stands: level from gravity, heading from the earth's rotation; and its upkeep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal.windows import tukey

from localize.earth import Earth
from semmap.errors import MeasurementError
from semmap.geometry import Array, rotation_between, so3_exp, so3_log, yaw_of, yaw_rotation
from semmap.rig import ImuBlock

_UP = np.array([0.0, 0.0, 1.0])
_TAPER = 0.3
"""Share of the stretch over which its samples fade in and out: tones cut anywhere have no mean then."""
_MIN_S = 1.0
_UNKNOWN_HEADING = float(np.pi / np.sqrt(3.0))
"""Standard deviation of a heading that may be anything [rad]."""
_SURE_HEADING = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class StaticAlignment:
    """Attitude and biases of a standing IMU.

    R_map_imu : (3, 3). gyro_bias : (3,) [rad/s]. tilt_std, heading_std : [rad]. duration_s : of the stretch.
    """

    R_map_imu: Array
    gyro_bias: Array
    tilt_std: float
    heading_std: float
    duration_s: float

    def sure(self, *, heading_std: float) -> bool:
        """Whether the heading is known this well [rad]; it is not without a latitude, or with a coarse gyroscope."""
        return self.heading_std < heading_std


def align_static(
    stamps_ns: NDArray[np.int64],
    gyro: Array,
    accel: Array,
    imu: ImuBlock,
    earth: Earth,
    *,
    heading: float | None = None,
    heading_std: float = 0.0,
    tapered: bool = True,
) -> StaticAlignment:
    """Attitude from a stretch at rest, stamps (n,), gyro (n, 3) [rad/s], accel (n, 3) [m/s²] in the imu frame.

    The mean specific force points up; the horizontal part of the mean rate points north (gyro-compassing, for
    gyroscopes whose bias is well below the earth's rate). What that is worth follows from the noise block and stands in
    ``heading_std``. Under vibration hand in what `localize.denoise.enhance` makes of the samples, and end the stretch
    well before motion: a turn smeared over the filter's margin outweighs the earth's rate.

    Parameters
    ----------
    heading, heading_std : of the imu's x axis in the map [rad], counter-clockwise from +x, where it is known otherwise.
    tapered : the ends of the stretch fade, against tones that it cuts; where nothing shakes the plain mean is better.

    Raises
    ------
    MeasurementError
        Where the stretch is shorter than a second.
    """
    duration_s = float(stamps_ns[-1] - stamps_ns[0]) * 1e-9 if len(stamps_ns) else 0.0
    if duration_s < _MIN_S:
        what = f"has {duration_s:.2g} s at rest"
        raise MeasurementError(what, field="align_static", mend=f"stand for {_MIN_S:g} s at the least")
    weights = tukey(len(stamps_ns) + 2, _TAPER if tapered else 0.0)[1:-1]
    rate, force = (weights @ signal / weights.sum() for signal in (gyro, accel))
    up = force / np.linalg.norm(force)
    tilt_std = float(np.hypot(imu.accel_bias_std, imu.accel_noise / np.sqrt(duration_s)) / earth.gravity)
    if heading is None:
        R, heading_std = _compassed(rate, up, earth), _heading_std(imu, earth, tilt_std, duration_s)
    else:
        level = rotation_between(up, _UP)
        R = yaw_rotation(heading - yaw_of(level)) @ level
    # the vertical part of the earth's rate needs no heading
    known = earth.rate if heading_std < _SURE_HEADING else earth.rate * _UP
    return StaticAlignment(R, rate - R.T @ known, tilt_std, heading_std, duration_s)


def _compassed(rate: Array, up: Array, earth: Earth) -> Array:
    """``R_map_imu`` that takes ``up`` to +z and the horizontal part of ``rate`` to that of the earth's rate."""
    north = np.array([earth.rate[0], earth.rate[1], 0.0])
    ahead = rate - (rate @ up) * up
    if not north.any() or not ahead.any():
        return rotation_between(up, _UP)
    in_map, in_imu = (np.column_stack([x, np.cross(z, x), z]) for x, z in ((_unit(north), _UP), (_unit(ahead), up)))
    return np.asarray(in_map @ in_imu.T)


def _unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v))


def _heading_std(imu: ImuBlock, earth: Earth, tilt_std: float, duration_s: float) -> float:
    """Standard deviation [rad]: east gyroscope error over the horizontal rate, and the lean times the vertical one."""
    horizontal = float(np.hypot(earth.rate[0], earth.rate[1]))
    if horizontal == 0.0:
        return _UNKNOWN_HEADING
    east = np.hypot(imu.gyro_bias_std, imu.gyro_noise / np.sqrt(duration_s))
    return min(float(np.hypot(east, tilt_std * earth.rate[2]) / horizontal), _UNKNOWN_HEADING)


def tilt_gain(accel: Array, gravity: float) -> float:
    """How far the specific force (3,) [m/s²] is believed to point up, 0 to 0.991 (paper 002 Eq. 13, 14).

    Eq. 14 as printed is -1 at rest. With ``e_m = | |f| - g | / g``, as in the orientation filter that the paper cites,
    Eq. 13 falls to its half at e_m = 0.148, which is what the text says.
    """
    e_m = abs(float(np.linalg.norm(accel)) - gravity) / gravity
    # beyond this the exponential overflows and the gain is nothing
    exponent = min((2500.0 * e_m - 370.0) / 40.0, 700.0)
    return float(0.991 / (1.0 + np.exp(exponent)))


def corrected_tilt(R_map_imu: Array, accel: Array, gravity: float, *, dt: float = 1.0, time_s: float = 0.0) -> Array:
    """Attitude (3, 3) turned so that the specific force (3,) points up, as far as it is believed (paper 002 Eq. 15).

    The turn is about a horizontal axis; heading stays. ``time_s`` > 0 spreads the correction over that many seconds of
    steps ``dt``, for accelerometers with vibration or noise; 0 is the paper's.
    """
    share = tilt_gain(accel, gravity) * (1.0 if time_s == 0.0 else -np.expm1(-dt / time_s))
    # (R Δ) f points up where Δ takes f to R^T up, both in the imu frame
    full = so3_log(rotation_between(accel, R_map_imu.T @ _UP))
    return np.asarray(R_map_imu @ so3_exp(share * full))
