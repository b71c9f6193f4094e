"""What localization gives back: an update a scan, and everything at the end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from semmap.geometry import Array
from semmap.trajectory import Trajectory

State = Literal["unknown", "tracking", "suspect"]
Event = dict[str, Any]
"""Plain data for one line of `events.jsonl`: at least ``stamp_ns`` and ``kind``."""


@dataclass(frozen=True, slots=True)
class Update:
    """What was known when a scan was done.

    stamp_ns : end of the scan. T_odom_imu : (4, 4) of the filter.
    T_map_imu : (4, 4), or None while the place in the map is not known or in doubt.
    covariance : (6, 6) of ``T_map_imu`` (rotation first, perturbed on the right), None with it.
    state : ``unknown`` before the first proof, ``tracking``, or ``suspect`` when proofs contradict one another.
    """

    stamp_ns: int
    T_odom_imu: Array
    T_map_imu: Array | None
    covariance: Array | None
    state: State


@dataclass(frozen=True, slots=True)
class LocalizationResult:
    """A whole run.

    trajectory : final smoothed poses, in ``map``; empty where a map was asked for and never found.
    realtime : what was known when each scan was done. odometry : the filter alone, in ``odom``.
    events : in order of time. summary : counts.
    """

    trajectory: Trajectory
    realtime: Trajectory
    odometry: Trajectory
    events: tuple[Event, ...]
    summary: dict[str, Any]
