"""The wheel: forward speed at the wheel's point, with a scale error and episodes of slip."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from semmap.geometry import Array
from semmap.measurements import WheelSpeed
from semmap.rig import WheelBlock
from tools.simulator.flight import Flight
from tools.simulator.motion import MotionState

RATE_HZ = 50.0
_SENSOR = 3
_SLIP_S = (0.4, 1.6)


def wheel_speeds(flight: Flight) -> Iterator[WheelSpeed]:
    """Speeds at the rig's rate."""
    block = flight.rig.wheel
    if block is None:
        return
    faults, rng = flight.faults, flight.rng(_SENSOR)
    stamps = flight.stamps(block.rate_hz or RATE_HZ)
    t = flight.times(stamps)
    scale = 1.0 + faults.wheel_scale_std * rng.normal()
    slip = 1.0 + slip_excess(t, faults.wheel_slips_per_min, faults.wheel_slip, rng)
    if faults.wheel_slip_s is not None:
        begin, end = faults.wheel_slip_s
        slip[(t >= begin) & (t < end)] = 1.0 + faults.wheel_slip
    noise = faults.noise * block.speed_std * rng.normal(size=len(t))
    readings = scale * slip * true_wheel_speed(flight.motion(t), block) + noise
    for stamp, speed in zip(stamps.tolist(), readings.tolist(), strict=True):
        yield WheelSpeed(stamp, speed)


def true_wheel_speed(state: MotionState, block: WheelBlock) -> Array:
    """Speed (n,) [m/s] along the wheel's x, ``R_iw^T (R^T v + ω x p_iw)``, paper 000 Eq. 10."""
    forward = block.T_imu_wheel[:3, 0]
    return np.asarray(state.point_velocity(np.array(block.p_imu_wheel)) @ forward)


def slip_excess(t: Array, per_minute: float, mean: float, rng: np.random.Generator) -> Array:
    """Relative excess (n,) of the wheel's speed at times ``t`` (n,): zero but for random episodes."""
    excess = np.zeros(len(t))
    for _ in range(rng.poisson(per_minute * (t[-1] - t[0]) / 60.0)):
        start, length = rng.uniform(t[0], t[-1]), rng.uniform(*_SLIP_S)
        excess[(t >= start) & (t < start + length)] = rng.exponential(mean)
    return excess
