"""UWB ranges: with line of sight, through rock with an excess, and now and then nonsense."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from semmap.geometry import Array
from semmap.measurements import UwbRange
from semmap.rig import UwbBlock
from tools.simulator.flight import Flight

RATE_HZ = 10.0
_SENSOR = 4
_REACH = 60.0
"""[m] of the radio where the rig sets no ``max_range``."""
_ROCK_DEPTH = 4.0
"""[m] behind the first rock at which 37 % of the ranges still arrive."""


def uwb_ranges(flight: Flight) -> Iterator[UwbRange]:
    """Ranges in time order: the rig's rate for each anchor, the anchors one after another."""
    block = flight.rig.uwb
    if block is None:
        return
    rng = flight.rng(_SENSOR)
    found = [
        reading
        for index, (anchor, p_map) in enumerate(block.anchor_positions().items())
        for reading in _ranges_to(flight, block, anchor, p_map, index / len(block.anchors), rng)
    ]
    yield from sorted(found, key=lambda reading: reading.stamp_ns)


def _ranges_to(
    flight: Flight, block: UwbBlock, anchor: int, p_map: Array, phase: float, rng: np.random.Generator
) -> list[UwbRange]:
    faults = flight.faults
    stamps = flight.stamps(block.rate_hz or RATE_HZ, phase=phase)
    tag = flight.motion(flight.times(stamps)).point(np.array(block.p_imu_tag))
    distance = np.linalg.norm(tag - p_map, axis=1)
    behind = distance - flight.mine.raycaster.free_way(tag, np.broadcast_to(p_map, tag.shape))
    hidden = behind > 0.0
    arrives = ~hidden | (rng.uniform(size=len(tag)) < np.exp(-np.maximum(behind, 0.0) / _ROCK_DEPTH))
    reach = block.max_range or _REACH
    excess = np.where(hidden, rng.exponential(faults.uwb_nlos_bias, len(tag)), 0.0)
    reading = distance + excess + faults.noise * block.range_std * rng.normal(size=len(tag))
    nonsense = rng.uniform(size=len(tag)) < faults.uwb_outlier_rate
    reading = np.where(nonsense, rng.uniform(0.0, 2.0 * reach, len(tag)), reading)
    kept = arrives & (distance <= reach) & (reading > 0.0)
    pairs = zip(stamps[kept].tolist(), reading[kept].tolist(), strict=True)
    return [UwbRange(stamp, anchor, metres) for stamp, metres in pairs]
