"""The IMU: exact body rates and specific force, plus turn-on bias, bias random walk and white noise."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from localize.earth import Earth
from semmap.geometry import Array
from semmap.measurements import ImuSample
from semmap.rig import ImuBlock
from tools.simulator.flight import Flight

RATE_HZ = 200.0
_SENSOR = 1


def imu_samples(flight: Flight) -> Iterator[ImuSample]:
    """Samples at the rig's rate, instantaneous values at their stamps."""
    block = flight.rig.imu
    rate = block.rate_hz or RATE_HZ
    stamps = flight.stamps(rate)
    state = flight.motion(flight.times(stamps))
    gyro_error, accel_error = imu_errors(block, len(stamps), rate, flight.faults.noise, flight.rng(_SENSOR))
    rate, force = state.felt(Earth.of(flight.rig.earth))
    gyro, accel = rate + gyro_error, force + accel_error
    for index, stamp in enumerate(stamps.tolist()):
        yield ImuSample(stamp, gyro[index], accel[index])


def imu_biases(flight: Flight) -> tuple[Array, Array]:
    """True biases (n, 3) of gyroscope [rad/s] and accelerometer [m/s²] at the samples of `imu_samples`."""
    rate = flight.rig.imu.rate_hz or RATE_HZ
    gyro, accel = _parts(flight.rig.imu, len(flight.stamps(rate)), rate, flight.rng(_SENSOR))
    return flight.faults.noise * gyro[0], flight.faults.noise * accel[0]


def imu_errors(
    block: ImuBlock, count: int, rate_hz: float, scale: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Errors (count, 3) of gyroscope [rad/s] and accelerometer [m/s²].

    One sample's white noise is the density times the square root of the rate; the bias walk's step is its
    density divided by it.
    """
    gyro, accel = _parts(block, count, rate_hz, rng)
    return scale * (gyro[0] + gyro[1]), scale * (accel[0] + accel[1])


def _parts(
    block: ImuBlock, count: int, rate_hz: float, rng: np.random.Generator
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Bias and white noise (count, 3) of the gyroscope, and of the accelerometer."""
    return (
        _bias_and_noise(block.gyro_bias_std, block.gyro_bias_walk, block.gyro_noise, count, rate_hz, rng),
        _bias_and_noise(block.accel_bias_std, block.accel_bias_walk, block.accel_noise, count, rate_hz, rng),
    )


def _bias_and_noise(
    turn_on: float, walk: float, density: float, count: int, rate_hz: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    bias = turn_on * rng.normal(size=3) + np.cumsum(walk / np.sqrt(rate_hz) * rng.normal(size=(count, 3)), axis=0)
    return bias, density * np.sqrt(rate_hz) * rng.normal(size=(count, 3))
