"""Prism fixes from a file into a run: brought onto the robot's clock, and in between its own measurements."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from localize import Localizer, LocalizeSettings
from localize.clock_offset import ClockOffset, estimate_clock_offset
from semmap.errors import InputFileError, MeasurementError, RigError
from semmap.measurements import Measurement, PrismFix, Scan
from semmap.prism_files import read_prism_file
from semmap.rig import Rig

_FEWEST = 10
_MOST_OFF_M = 0.15
"""Where fixes and odometry differ by more, one of them is wrong, and so is what they tell of the clocks."""

Reread = Callable[[], Iterable[Measurement]]
"""Gives the measurements of the recording, from the beginning each time."""


def fixes_of_file(
    path: Path, rig: Rig, reread: Reread, settings: LocalizeSettings
) -> tuple[tuple[PrismFix, ...], ClockOffset | None]:
    """Fixes of a file on the robot's clock, and what was between the clocks.

    Where the rig sets ``total_station.time_offset_s`` that is added, and there is nothing to estimate. Else the
    recording is run through once by LiDAR and IMU alone, and how the prism moved by them is compared with the fixes.

    Raises
    ------
    RigError
        Where the rig has no `total_station`.
    InputFileError
        With the line of the file at fault; or where motion does not tell the clock offset.
    """
    fixes = read_prism_file(path)
    station = rig.total_station
    if station is None:
        raise RigError("has no total_station", field="total_station", mend="give position and p_imu_prism")
    if "time_offset_s" in station.model_fields_set:
        known = ClockOffset(station.time_offset_s, 0.0, 0.0)
        return tuple(known.applied(fix) for fix in fixes), None
    if len(fixes) < _FEWEST:
        mend = "track the prism for a while in motion; or set total_station.time_offset_s"
        raise InputFileError(f"has {len(fixes)} fixes, too few to tell the clock offset", file=path, mend=mend)
    localizer = Localizer(rig.without("prism", "uwb"), None, settings.without_loops())
    for measurement in reread():
        localizer.add(measurement)
    track, lever = localizer.finish().odometry, np.array(station.p_imu_prism)
    try:
        offset = estimate_clock_offset(track, fixes, lever, point_std=station.point_std)
    except MeasurementError as error:
        mend = f"{error.mend}; or set total_station.time_offset_s"
        raise InputFileError(error.what, file=path, mend=mend) from None
    if offset.residual_m > _MOST_OFF_M:
        what = f"fits what LiDAR and IMU tell of the motion to {offset.residual_m:.2g} m only"
        raise InputFileError(what, file=path, mend="set total_station.time_offset_s")
    return tuple(offset.applied(fix) for fix in fixes), offset


def merged(measurements: Iterable[Measurement], fixes: Iterable[PrismFix]) -> Iterator[Measurement]:
    """Measurements of a recording with the fixes among them, each when it would have arrived."""
    return heapq.merge(measurements, fixes, key=_arrival_ns)


def _arrival_ns(measurement: Measurement) -> int:
    return measurement.end_ns if isinstance(measurement, Scan) else measurement.stamp_ns
