"""UWB ranges: with line of sight, through rock with an excess, and now and then nonsense."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from semmap.geometry import Array
from semmap.measurements import UwbRange
from semmap.rig import UwbBlock
from tools.simulator.flight import Flight, Stamps

RATE_HZ = 10.0
_SENSOR, _DETOURS = 4, 6
_REACH = 60.0
"""[m] of the radio where the rig sets no ``max_range``."""
_ROCK_DEPTH = 4.0
"""[m] behind the first rock at which 37 % of the ranges still arrive."""


def uwb_ranges(flight: Flight) -> Iterator[UwbRange]:
    """Ranges in time order: the rig's rate for each anchor, the anchors one after another."""
    block = flight.rig.uwb
    if block is None:
        return
    rng, detours = flight.rng(_SENSOR), flight.rng(_DETOURS)
    found = [
        reading
        for index, (anchor, p_map) in enumerate(block.anchor_positions().items())
        for reading in _ranges_to(flight, block, anchor, p_map, index / len(block.anchors), rng, detours)
    ]
    yield from sorted(found, key=lambda reading: reading.stamp_ns)


def _ranges_to(
    flight: Flight,
    block: UwbBlock,
    anchor: int,
    p_map: Array,
    phase: float,
    rng: np.random.Generator,
    detours: np.random.Generator,
) -> list[UwbRange]:
    faults = flight.faults
    stamps = flight.stamps(block.rate_hz or RATE_HZ, phase=phase)
    tag = flight.motion(flight.times(stamps)).point(np.array(block.p_imu_tag))
    distance = np.linalg.norm(tag - p_map, axis=1)
    behind = distance - flight.mine.raycaster.free_way(tag, np.broadcast_to(p_map, tag.shape))
    hidden = behind > 0.0
    arrives = ~hidden | (rng.uniform(size=len(tag)) < np.exp(-np.maximum(behind, 0.0) / _ROCK_DEPTH))
    excess = np.where(hidden, rng.exponential(faults.uwb_nlos_bias, len(tag)), 0.0)
    detour = detours.uniform(size=len(tag)) < faults.uwb_nlos_rate
    excess += np.where(detour, detours.exponential(faults.uwb_nlos_bias, len(tag)), 0.0)
    reading = distance + excess + faults.noise * block.range_std * rng.normal(size=len(tag))
    nonsense = rng.uniform(size=len(tag)) < faults.uwb_outlier_rate
    reading = np.where(nonsense, rng.uniform(0.0, 2.0 * (block.max_range or _REACH), len(tag)), reading)
    kept = arrives & _in_reach(tag, distance, block) & _answers(flight, anchor, stamps) & (reading > 0.0)
    pairs = zip(stamps[kept].tolist(), reading[kept].tolist(), strict=True)
    return [UwbRange(stamp, anchor, metres) for stamp, metres in pairs]


def _in_reach(tag: Array, distance: Array, block: UwbBlock) -> NDArray[np.bool_]:
    """Whether the tag (n, 3) is in the system's sphere (paper 000, Eq. 18), or, without a centre, near the anchor."""
    reach = block.max_range or _REACH
    if block.center is None:
        return np.asarray(distance <= reach)
    return np.asarray(np.linalg.norm(tag - block.center, axis=1) <= reach)


def _answers(flight: Flight, anchor: int, stamps: Stamps) -> NDArray[np.bool_]:
    """Whether the anchor is alive (n,) at these stamps."""
    faults, t = flight.faults, flight.times(stamps)
    begin, end = faults.uwb_silent_s or (np.inf, np.inf)
    return np.asarray((anchor not in faults.uwb_dead) & ((t < begin) | (t >= end)))
