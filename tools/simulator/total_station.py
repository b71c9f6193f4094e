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
    seen = np.isinf(flight.mine.raycaster.free_way(prism, station))
    fixes = prism + flight.faults.noise * block.point_std * flight.rng(_SENSOR).normal(size=prism.shape)
    for stamp, fix in zip(stamps[seen].tolist(), fixes[seen], strict=True):
        yield PrismFix(stamp, fix)
