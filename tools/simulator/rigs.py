"""Rigs for simulated robots: the benchmark's, and beacons put where a mine has room for them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from numpy.typing import ArrayLike

from semmap.errors import RigError
from semmap.files import written_whole
from semmap.geometry import Array
from semmap.rig import ImuBlock, LidarBlock, Rig, TotalStationBlock, UwbBlock, WheelBlock

if TYPE_CHECKING:
    from tools.simulator.mine import Mine

_ANCHOR_IDS = 100
_OFF_THE_WALL = 0.3
"""[m] between a beacon and the rock behind it."""


def default_rig() -> Rig:
    """The benchmark's rig: a 16-beam LiDAR, an IMU at 200 Hz and a wheel."""
    return Rig(
        frame="map",
        imu=ImuBlock(
            topic="/imu/data",
            rate_hz=200,
            gyro_noise=3e-4,
            accel_noise=4e-3,
            gyro_bias_walk=2e-5,
            accel_bias_walk=3e-4,
            gyro_bias_std=0.002,
            accel_bias_std=0.03,
        ),
        lidar=LidarBlock(
            topic="/lidar/points",
            beams=16,
            columns=900,
            rate_hz=10,
            fov_deg=(-15.0, 15.0),
            min_range=0.6,
            max_range=80.0,
            range_std=0.02,
            p_imu_lidar=(0.05, 0.0, 0.12),
        ),
        wheel=WheelBlock(topic="/wheel/twist", rate_hz=50, speed_std=0.02, p_imu_wheel=(-0.1, 0.0, -0.35)),
    )


def with_uwb(rig: Rig, mine: Mine, p_map: ArrayLike, *, anchors: int = 4, max_range: float = 21.0) -> Rig:
    """The rig with a calibrated UWB tag, and anchors on the rock round a point ``p_map`` (3,) in a roadway.

    Raises `RigError` where fewer than ``anchors`` directions meet rock within the range.
    """
    p = np.asarray(p_map, dtype=np.float64)
    angle = 2.0 * np.pi * np.arange(8 * anchors) / (8 * anchors)
    # by turns a little up and a little down, so that the anchors do not lie in one plane with the robot
    rise = np.where(np.arange(len(angle)) % 2, 0.25, -0.05)
    directions = np.column_stack([np.cos(angle), np.sin(angle), rise])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    distances = mine.raycaster.cast(np.broadcast_to(p, directions.shape), directions).distances
    usable = np.flatnonzero(distances < 0.8 * max_range)
    if len(usable) < anchors:
        raise RigError("has no rock near enough for the anchors", field="uwb", mend="choose a point in a roadway")
    chosen = usable[np.linspace(0, len(usable), anchors, endpoint=False).astype(int)]
    at = p + (distances[chosen] - _OFF_THE_WALL)[:, None] * directions[chosen]
    return rig.model_copy(update={"uwb": _calibrated(at, max_range, _triple(p))})


def with_uwb_along(
    rig: Rig, mine: Mine, route: ArrayLike, *, spacing: float = 6.0, height: float = 1.3, max_range: float = 20.0
) -> Rig:
    """The rig with a calibrated UWB tag, and an anchor on the rock every ``spacing`` [m] of a ``route`` (n, 3) of floor
    points, by turns left and right, high and low.

    height : of the robot above the route [m]. max_range : of each anchor's radio [m].
    """
    floor = np.asarray(route, dtype=np.float64)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(floor, axis=0), axis=1))])
    at = np.arange(0.5 * spacing, way[-1], spacing)
    p, ahead = (
        np.column_stack([np.interp(at + step, way, floor[:, axis]) for axis in range(3)]) for step in (0.0, 0.5)
    )
    aside = np.cross([0.0, 0.0, 1.0], ahead - p)
    aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-9)
    k = np.arange(len(at))[:, None]
    directions = np.where(k % 2, 1.0, -1.0) * aside + np.where(k // 2 % 2, 0.5, -0.3) * np.array([0.0, 0.0, 1.0])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    p = p + [0.0, 0.0, height]
    distances = mine.raycaster.cast(p, directions).distances
    met = np.flatnonzero(np.isfinite(distances) & (distances < max_range))
    anchors = p[met] + (distances[met, None] - _OFF_THE_WALL) * directions[met]
    return rig.model_copy(update={"uwb": _calibrated(anchors, max_range, None)})


def _calibrated(anchors: Array, max_range: float, center: tuple[float, float, float] | None) -> UwbBlock:
    return UwbBlock(
        topic="/uwb/range",
        rate_hz=10,
        range_std=0.06,
        bias_std=0.0,
        p_imu_tag=(0.0, 0.0, 0.25),
        anchors={_ANCHOR_IDS + index: _triple(position) for index, position in enumerate(anchors)},
        center=center,
        max_range=max_range,
    )


def with_total_station(rig: Rig, position: ArrayLike) -> Rig:
    """The rig with a prism, and a total station at ``position`` (3,) in the map frame."""
    block = TotalStationBlock(
        topic="/total_station/prism",
        rate_hz=5,
        position=_triple(np.asarray(position, dtype=np.float64)),
        point_std=0.002,
        p_imu_prism=(0.0, 0.0, 0.3),
    )
    return rig.model_copy(update={"total_station": block})


def as_recorded(rig: Rig) -> Rig:
    """The rig less what its owner said about the point times of another recording: ours say it themselves."""
    if rig.lidar is None:
        return rig
    said = rig.lidar.model_dump(exclude_unset=True, exclude={"time_field", "time_unit", "time_reference"})
    return rig.model_copy(update={"lidar": LidarBlock(**said)})


def save_rig(path: str | Path, rig: Rig) -> None:
    """Write a rig file with the keys that were set; `Rig.from_yaml` reads the same rig."""
    with written_whole(path) as temporary:
        text = yaml.safe_dump(_plain(rig.model_dump(exclude_unset=True)), sort_keys=False, default_flow_style=None)
        temporary.write_text(text, encoding="utf-8")


def _triple(p: Array) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 3) for value in p)
    return x, y, z


def _plain(value: Any) -> Any:
    """Tuples as lists, all the way down: YAML knows no tuples."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple) else value
