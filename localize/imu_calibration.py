"""The noise block of an IMU from a stretch at rest that is found in a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localize.earth import Earth
from localize.imu_noise import SensorNoise, sensor_noise
from semmap.errors import RecordingError
from semmap.geometry import Array
from semmap.rig import ImuBlock

MIN_STATIC_S = 60.0
_WINDOW_S = 1.0
_LAGS = (1, 5)
"""The means of windows this far apart must agree."""
_FLOOR = np.repeat([2e-3, 0.03], 3)
"""Least change of the mean rate [rad/s] and specific force [m/s²] between windows that counts as motion."""
_SIGMAS = 8.0
_MOST_RATE, _MOST_FORCE_ERROR = 0.1, 1.0
"""A mean rate [rad/s], or a length of the specific force off g [m/s²], beyond this is no bias."""
_MAX_GAP_S = 0.1


@dataclass(frozen=True, slots=True)
class StaticStretch:
    """Samples ``begin`` to ``end`` at rest, ``duration_s`` long.

    unrest : greatest change between its windows over what would count as motion, 0 to 1; the less, the surer.
    """

    begin: int
    end: int
    duration_s: float
    unrest: float


@dataclass(frozen=True, slots=True, eq=False)
class ImuCalibration:
    """What a stretch at rest tells of an IMU.

    noise_block : the keys of the rig's ``imu`` block with their values; gyro, accel : the fits behind them.
    gyro_bias : mean rate (3,) [rad/s] with the earth's in it; force_error : length of the specific force off g [m/s²].
    """

    stretch: StaticStretch
    noise_block: dict[str, float]
    gyro: SensorNoise
    accel: SensorNoise
    gyro_bias: Array
    force_error: float


def calibrate(stamps_ns: NDArray[np.int64], gyro: Array, accel: Array, imu: ImuBlock, earth: Earth) -> ImuCalibration:
    """Noise of an IMU from the longest stretch at rest among samples (n,), (n, 3), (n, 3).

    Densities and walks are fits to the Allan variance. A walk that the stretch is too short to show stays as the rig
    has it, or becomes what it is at the most, whichever is less. A bias instability enters as the walk that reaches
    it at the longest averaging time. One stretch shows one turn-on: its bias, root mean square over the axes, is the
    standard deviation written down; of the accelerometer only the length of gravity can be told, and the rig's value
    stays unless that is off by more.

    Raises
    ------
    RecordingError
        Where nothing of it is at rest for a minute, or a vibration below some hertz hides the white noise.
    """
    stretch = find_static(stamps_ns, gyro, accel, earth.gravity)
    if stretch is None or stretch.duration_s < MIN_STATIC_S:
        longest = stretch.duration_s if stretch is not None else 0.0
        total = float(stamps_ns[-1] - stamps_ns[0]) * 1e-9 if len(stamps_ns) else 0.0
        what = f"stands still for {longest:.0f} s at the longest, of {total:.0f} s"
        mend = "record more than a minute without motion, better ten; engines may run"
        raise RecordingError(what, field=imu.topic, mend=mend)
    part = slice(stretch.begin, stretch.end)
    rate_hz = (stretch.end - stretch.begin - 1) / stretch.duration_s
    fits = sensor_noise(gyro[part], rate_hz), sensor_noise(accel[part], rate_hz)
    for name, fit in zip(("gyroscope", "accelerometer"), fits, strict=True):
        if not fit.white.seen:
            what = f"a slow vibration hides the white noise of the {name}"
            raise RecordingError(what, field=imu.topic, mend="record it with the engines off")
    bias, force = gyro[part].mean(axis=0), accel[part].mean(axis=0)
    force_error = float(np.linalg.norm(force)) - earth.gravity
    block = {
        "gyro_noise": fits[0].white.value,
        "accel_noise": fits[1].white.value,
        "gyro_bias_walk": _walk(fits[0], imu.gyro_bias_walk),
        "accel_bias_walk": _walk(fits[1], imu.accel_bias_walk),
        "gyro_bias_std": _turn_on_rate(bias, force, earth),
        "accel_bias_std": max(imu.accel_bias_std, abs(force_error)),
    }
    return ImuCalibration(stretch, block, *fits, bias, force_error)


def find_static(stamps_ns: NDArray[np.int64], gyro: Array, accel: Array, gravity: float) -> StaticStretch | None:
    """The longest stretch whose mean rate and specific force, second by second, stay as they are.

    Vibration averages out within a second and motion does not. A second counts as motion too where the rate is more
    than any bias, the specific force is not gravity's, or samples are missing.
    """
    if len(stamps_ns) < 2:
        return None
    seconds = (stamps_ns - stamps_ns[0]) * 1e-9
    edges = np.searchsorted(seconds, np.arange(0.0, seconds[-1] + 1e-6, _WINDOW_S))
    if len(edges) < 2 or (np.diff(edges) < 2).any():
        return None
    signals, counts = np.hstack([gyro, accel]), np.diff(edges)
    means = np.add.reduceat(signals[: edges[-1]], edges[:-1]) / counts[:, None]
    squares = np.add.reduceat(signals[: edges[-1]] ** 2, edges[:-1]) / counts[:, None]
    noise = np.sqrt(np.maximum(squares - means**2, 0.0) / counts[:, None])
    # the quiet windows tell how well a mean is known
    tolerance = np.maximum(_FLOOR, _SIGMAS * np.quantile(noise, 0.2, axis=0))
    change = np.zeros(len(means))
    for lag in _LAGS:
        step = (np.abs(means[lag:] - means[:-lag]) / tolerance).max(axis=1)
        change[lag:] = np.maximum(change[lag:], step)
        change[:-lag] = np.maximum(change[:-lag], step)
    resting = np.linalg.norm(means[:, :3], axis=1) < _MOST_RATE
    resting &= np.abs(np.linalg.norm(means[:, 3:], axis=1) - gravity) < _MOST_FORCE_ERROR
    gaps = np.flatnonzero(np.diff(seconds) > _MAX_GAP_S)
    resting[np.clip(np.searchsorted(edges, gaps, side="right") - 1, 0, len(resting) - 1)] = False
    first, last = _longest_run(resting & (change < 1.0))
    if first == last:
        return None
    begin, end = int(edges[first]), int(edges[last])
    duration_s = float(seconds[end - 1] - seconds[begin])
    return StaticStretch(begin, end, duration_s, float(change[first:last].max()))


def _longest_run(still: NDArray[np.bool_]) -> tuple[int, int]:
    """First and one past the last index of the longest run of true; the same where there is none."""
    bounds = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]])))
    if not len(bounds):
        return 0, 0
    starts, ends = bounds[::2], bounds[1::2]
    k = int(np.argmax(ends - starts))
    return int(starts[k]), int(ends[k])


def _walk(noise: SensorNoise, known: float) -> float:
    """The bias walk for the rig, at least the one that looks like the bias instability at the longest τ."""
    walk = noise.walk.value if noise.walk.seen else min(known, noise.walk.bound)
    floor = noise.instability.value if noise.instability.seen else 0.0
    return float(np.hypot(walk, np.sqrt(6.0 * np.log(2.0) / np.pi / noise.tau_s[-1]) * floor))


def _turn_on_rate(rate: Array, force: Array, earth: Earth) -> float:
    """1σ of the turn-on bias [rad/s] from one: the mean rate, less what of it is the earth's for sure."""
    if not earth.rate.any():
        return float(np.sqrt(np.mean(rate**2)))
    up = force / np.linalg.norm(force)
    vertical = rate @ up
    off = [vertical - earth.rate[2], np.linalg.norm(rate - vertical * up) - np.linalg.norm(earth.rate[:2])]
    return float(np.sqrt(np.mean(np.square(off))))
