"""The rig: which sensors there are, where they sit on the IMU, and how noisy they are.

A rig file is YAML with one block a sensor; `Rig.from_yaml` validates it, and an unknown key fails with the
nearest known name. Blocks that are absent are sensors the robot does not have.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    NonNegativeFloat,
    PositiveFloat,
    PositiveInt,
    model_validator,
)

from semmap.errors import RigError
from semmap.geometry import Array, rotation_of_quaternion, se3
from semmap.settings import load_yaml, validate

STANDARD_GRAVITY = 9.80665
"""[m/s²], the unit of `accel_unit: g`."""


def _non_zero(q: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    length = float(np.linalg.norm(q))
    if abs(length - 1.0) > 0.01:
        raise ValueError(f"is not a unit quaternion x y z w (length {length:.4g})")
    return q


Vector3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Quaternion = Annotated[tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat], AfterValidator(_non_zero)]
_IDENTITY: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)


class SensorBlock(BaseModel):
    """What every sensor has: a topic and a clock offset.

    ``time_offset_s`` is added to the sensor's stamps to bring them onto the IMU's clock.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    topic: str
    time_offset_s: FiniteFloat = 0.0
    rate_hz: PositiveFloat | None = None


class ImuBlock(SensorBlock):
    """IMU noise: white densities [rad/s/√Hz, m/s²/√Hz], bias walks [rad/s²/√Hz, m/s³/√Hz], turn-on bias 1σ.

    ``gyro_noise`` and ``accel_noise`` are the densities; the standard deviation of one sample is the density
    times the square root of the rate. ``engines``: the robot is a machine whose engines shake the IMU (roadheader,
    drill, loader), and their tones are to be taken out of its samples.
    """

    gyro_noise: PositiveFloat = 3e-4
    accel_noise: PositiveFloat = 4e-3
    gyro_bias_walk: PositiveFloat = 2e-5
    accel_bias_walk: PositiveFloat = 3e-4
    gyro_bias_std: PositiveFloat = 0.01
    accel_bias_std: PositiveFloat = 0.1
    accel_unit: Literal["m/s2", "g"] = "m/s2"
    engines: bool = False


class LidarBlock(SensorBlock):
    """LiDAR: ranges outside [min_range, max_range] are dropped; beams, columns and fov serve the simulator.

    ``time_field``, ``time_unit`` and ``time_reference`` override what the reader finds out about the points'
    time stamps: ``time_field: none`` means the clouds are deskewed; times count ``relative`` to the header
    stamp, ``absolute`` on its clock, or on the sensor's own clock with the ``first`` point at the stamp.
    """

    p_imu_lidar: Vector3
    q_imu_lidar_xyzw: Quaternion = _IDENTITY
    beams: PositiveInt = 16
    columns: PositiveInt = 900
    fov_deg: tuple[FiniteFloat, FiniteFloat] = (-15.0, 15.0)
    min_range: PositiveFloat = 0.6
    max_range: PositiveFloat = 80.0
    range_std: PositiveFloat = 0.02
    time_field: str | None = None
    time_unit: Literal["s", "ms", "us", "ns"] | None = None
    time_reference: Literal["relative", "absolute", "first"] | None = None

    @model_validator(mode="after")
    def _limits_are_ordered(self) -> Self:
        if self.min_range >= self.max_range:
            raise ValueError(f"min_range {self.min_range:g} is not below max_range {self.max_range:g}")
        return self

    @property
    def T_imu_lidar(self) -> Array:
        return se3(rotation_of_quaternion(self.q_imu_lidar_xyzw), self.p_imu_lidar)


class WheelBlock(SensorBlock):
    """Wheel speed along x of the wheel frame; ``speed_std`` [m/s] of one reading."""

    p_imu_wheel: Vector3
    q_imu_wheel_xyzw: Quaternion = _IDENTITY
    speed_std: PositiveFloat = 0.02

    @property
    def T_imu_wheel(self) -> Array:
        return se3(rotation_of_quaternion(self.q_imu_wheel_xyzw), self.p_imu_wheel)


class UwbBlock(SensorBlock):
    """UWB tag and its anchors (map frame) by id; ``center``, ``max_range`` as in paper 000, Eq. 18.

    ``range_std`` [m] of one reading; beside it, each anchor may read too long by ``bias_std`` [m], and all of them by
    the share ``scale_std``: how well the radios are calibrated. 0 takes them to be.
    """

    range_std: PositiveFloat = 0.1
    bias_std: NonNegativeFloat = 0.03
    scale_std: NonNegativeFloat = 0.0
    p_imu_tag: Vector3
    q_imu_tag_xyzw: Quaternion = _IDENTITY
    anchors: dict[int, Vector3] = Field(min_length=1)
    center: Vector3 | None = None
    max_range: PositiveFloat | None = None

    def anchor_positions(self) -> dict[int, Array]:
        """Anchor id -> position (3,) in the map frame."""
        return {anchor: np.array(p) for anchor, p in self.anchors.items()}


class TotalStationBlock(SensorBlock):
    """Total station that tracks a prism; its ``position`` in map, ``point_std`` [m] per axis.

    Without a ``topic`` its fixes come from a file beside the recording. ``time_offset_std`` [s]: how well its clock,
    with ``time_offset_s``, is known to go with the IMU's; the rest is estimated on the way, 0 takes it at its word.
    """

    topic: str = ""
    position: Vector3
    point_std: PositiveFloat = 0.002
    time_offset_std: NonNegativeFloat = 0.1
    p_imu_prism: Vector3
    q_imu_prism_xyzw: Quaternion = _IDENTITY


class EarthBlock(BaseModel):
    """Where the mine is, for IMUs that feel the earth turn.

    ``latitude_deg``: north is positive. ``grid_bearing_deg``: direction of the map's +y, clockwise from true north.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    latitude_deg: FiniteFloat = Field(ge=-89.0, le=89.0)
    grid_bearing_deg: FiniteFloat = 0.0


class Rig(BaseModel):
    """The sensors of one robot. The IMU is the body frame and must be there."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    frame: str = "map"
    imu: ImuBlock
    lidar: LidarBlock | None = None
    wheel: WheelBlock | None = None
    uwb: UwbBlock | None = None
    total_station: TotalStationBlock | None = None
    earth: EarthBlock | None = None

    @classmethod
    def from_yaml(cls, path: str | Path) -> Self:
        """Read a rig file. Raises `RigError` with file, key and mend."""
        return validate(cls, load_yaml(path, RigError), file=path, error=RigError)

    def without(self, *sensors: str) -> Rig:
        """The same rig less some of ``lidar, wheel, uwb, prism, inertial-enhancement`` (other names are ignored)."""
        fields = {"prism": "total_station"}
        gone = {fields.get(sensor, sensor) for sensor in sensors} & {"lidar", "wheel", "uwb", "total_station"}
        update: dict[str, SensorBlock | None] = dict.fromkeys(gone)
        if "inertial-enhancement" in sensors:
            update["imu"] = self.imu.model_copy(update={"engines": False})
        return self.model_copy(update=update)
