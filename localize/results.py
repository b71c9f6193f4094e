"""What localization gives back: an update a scan, and everything at the end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from semmap.geometry import Array
from semmap.trajectory import Trajectory

State = Literal["unknown", "tracking", "suspect", "lost"]
Event = dict[str, Any]
"""Plain data for one line of `events.jsonl`: at least ``stamp_ns`` and ``kind``."""


@dataclass(frozen=True, slots=True)
class Update:
    """What was known when a scan was done.

    stamp_ns : end of the scan. T_odom_imu : (4, 4) of the filter.
    T_map_imu : (4, 4), or None while the place in the map is not known or in doubt.
    covariance : (6, 6) of ``T_map_imu`` (rotation first, perturbed on the right), None with it.
    T_own_imu : (4, 4) in a run without a map that closes loops: in its own frame, which is odom corrected; None while
    the odometry is broken off, and in other runs.
    state : ``unknown`` before the first proof, ``tracking``, ``suspect`` while what is seen contradicts
    the track, ``lost`` once the track is refuted or broken off and the place is not found again.
    """

    stamp_ns: int
    T_odom_imu: Array
    T_map_imu: Array | None
    covariance: Array | None
    state: State
    T_own_imu: Array | None = None


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """How well the pose was known when a scan was done, and what held it.

    mode : `localize.modes`. degenerate : whether the pose was, by any of the three degrees. scan_degree : standard
    deviation [m] with which the scan alone placed the robot in its weakest direction; translation_degree and
    rotation_degree : paper 000's, [m] and [rad] a metre (see `localize.degeneracy`); NaN while not known.
    rotation_std : (3,) [rad] about the imu's axes; position_odom : (3, 3) [m²] in the axes of odom, of the filter.
    position_map : (3, 3) [m²] of the published pose in the axes of the map, or None without one.
    """

    stamp_ns: int
    mode: str
    degenerate: bool
    scan_degree: float
    translation_degree: float
    rotation_degree: float
    rotation_std: Array
    position_odom: Array
    position_map: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class Overlay:
    """What a keyframe saw of an intersection, as the ICP check laid it into the map: for people to look at.

    An ``intersection`` event says which is its own: ``overlay`` counts from 0.
    id : the intersection that it was laid onto. T_map_imu : (4, 4) where the keyframe is by it.
    points : (n, 3) float32, those compared, in the imu frame of the keyframe [m].
    """

    id: int
    T_map_imu: Array
    points: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class LocalizationResult:
    """A whole run.

    trajectory : final smoothed poses, in ``map``; empty where a map was asked for and never found. Without one, in
    ``odom``: corrected by loops, and without what came after a break, unless a loop joined it.
    realtime : what was known when each scan was done. odometry : the filter alone, in ``odom``.
    events : in order of time. summary : counts. uncertainty : one a scan. overlays : one an ICP check.
    smoothed : stamps of the keyframes that have a place in the map, with the covariance (6, 6) that their poses in
    ``trajectory`` have (rotation first, perturbed on the right).
    """

    trajectory: Trajectory
    realtime: Trajectory
    odometry: Trajectory
    events: tuple[Event, ...]
    summary: dict[str, Any]
    uncertainty: tuple[Uncertainty, ...]
    overlays: tuple[Overlay, ...] = ()
    smoothed: tuple[tuple[int, Array], ...] = ()
