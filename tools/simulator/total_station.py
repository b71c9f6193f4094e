"""The total station: fixes of the prism wherever the instrument sees it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from semmap.measurements import PrismFix
from tools.simulator.flight import Flight

RATE_HZ = 5.0
_SENSOR = 5


def prism_fixes(flight: Flight) -> Iterator[PrismFix]:
    """Fixes at the rig's rate while the line from the instrument to the prism is free."""
    block = flight.rig.total_station
    if block is None:
        return
    stamps = flight.stamps(block.rate_hz or RATE_HZ)
    prism = flight.motion(flight.times(stamps)).point(np.array(block.p_imu_prism))
    station = np.broadcast_to(np.array(block.position), prism.shape)
    faults, rng = flight.faults, flight.rng(_SENSOR)
    seen = np.isinf(flight.mine.raycaster.free_way(prism, station))
    if faults.prism_hidden_s is not None:
        begin, end = faults.prism_hidden_s
        seen &= (flight.times(stamps) < begin) | (flight.times(stamps) >= end)
    fixes = prism + faults.noise * block.point_std * rng.normal(size=prism.shape)
    wrong = rng.uniform(size=len(fixes)) < faults.prism_outlier_rate
    fixes[wrong] += rng.uniform(-1.0, 1.0, size=(int(wrong.sum()), 3))
    stamps = stamps + round(faults.prism_clock_s * 1e9)
    for stamp, fix in zip(stamps[seen].tolist(), fixes[seen], strict=True):
        yield PrismFix(stamp, fix)
