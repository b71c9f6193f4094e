"""The IMU: exact body rates and specific force, plus turn-on bias, bias random walk and white noise."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

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
    gyro, accel = state.angular_velocity + gyro_error, state.specific_force() + accel_error
    for index, stamp in enumerate(stamps.tolist()):
        yield ImuSample(stamp, gyro[index], accel[index])


def imu_errors(
    block: ImuBlock, count: int, rate_hz: float, scale: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Errors (count, 3) of gyroscope [rad/s] and accelerometer [m/s²].

    One sample's white noise is the density times the square root of the rate; the bias walk's step is its
    density divided by it.
    """
    return (
        scale * _errors(block.gyro_bias_std, block.gyro_bias_walk, block.gyro_noise, count, rate_hz, rng),
        scale * _errors(block.accel_bias_std, block.accel_bias_walk, block.accel_noise, count, rate_hz, rng),
    )


def _errors(turn_on: float, walk: float, density: float, count: int, rate_hz: float, rng: np.random.Generator) -> Array:
    bias = turn_on * rng.normal(size=3) + np.cumsum(walk / np.sqrt(rate_hz) * rng.normal(size=(count, 3)), axis=0)
    return np.asarray(bias + density * np.sqrt(rate_hz) * rng.normal(size=(count, 3)))
