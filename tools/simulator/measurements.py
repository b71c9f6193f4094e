"""All sensors of a flight as one stream."""

from __future__ import annotations

import heapq
from collections.abc import Iterator

from semmap.measurements import Measurement, Scan
from tools.simulator.flight import Flight
from tools.simulator.imu import imu_samples
from tools.simulator.lidar import scans
from tools.simulator.total_station import prism_fixes
from tools.simulator.uwb import uwb_ranges
from tools.simulator.wheel import wheel_speeds


def simulate_measurements(flight: Flight) -> Iterator[Measurement]:
    """Measurements in the order of arrival: a scan when its last point is measured, the rest at once.

    The same flight gives the same measurements, to the bit.
    """
    streams: tuple[Iterator[Measurement], ...] = (
        imu_samples(flight),
        wheel_speeds(flight),
        uwb_ranges(flight),
        prism_fixes(flight),
        scans(flight),
    )
    yield from heapq.merge(*streams, key=arrival_ns)


def arrival_ns(measurement: Measurement) -> int:
    """When a measurement is known."""
    return measurement.end_ns if isinstance(measurement, Scan) else measurement.stamp_ns
