"""ROS messages as measurements, and measurements as ROS messages. Needs neither ROS nor a bag library."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semmap.errors import RecordingError, SemmapError
from semmap.measurements import ImuSample, Measurement, PrismFix, Scan, UwbRange, WheelSpeed
from semmap.pointcloud2 import (
    INTENSITY_FIELDS,
    RING_FIELDS,
    coordinates,
    encode_scan,
    find_column,
    point_table,
    within_range,
)
from semmap.pointtimes import PointTimeFormat
from semmap.rig import STANDARD_GRAVITY, ImuBlock, LidarBlock, Rig, SensorBlock, TotalStationBlock, UwbBlock

MESSAGE_TYPES: Mapping[str, tuple[str, ...]] = {
    "imu": ("sensor_msgs/msg/Imu",),
    "lidar": ("sensor_msgs/msg/PointCloud2",),
    "wheel": (
        "geometry_msgs/msg/TwistStamped",
        "nav_msgs/msg/Odometry",
        "geometry_msgs/msg/TwistWithCovarianceStamped",
    ),
    "uwb": ("sensor_msgs/msg/Range",),
    "total_station": ("geometry_msgs/msg/PointStamped",),
}
"""Sensor block of the rig -> message types it is read from; the first is the one that is written."""

_ANCHOR = "anchor_"
_MAX_GYRO, _MAX_ACCEL = 200.0, 2000.0  # [rad/s], [m/s²]: no IMU measures more, what says so is a broken message


def sensor_blocks(rig: Rig) -> dict[str, SensorBlock]:
    """The blocks of a rig that have a topic, by their key in the rig file."""
    blocks = {name: getattr(rig, name) for name in MESSAGE_TYPES}
    return {name: block for name, block in blocks.items() if block is not None and block.topic}


def header_ns(message: Any) -> int:
    """Header stamp [ns] as it was sent."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def stamp_ns(message: Any, block: SensorBlock) -> int:
    """Header stamp [ns] on the IMU's clock, the block's time offset added."""
    return header_ns(message) + _offset_ns(block)


def _offset_ns(block: SensorBlock) -> int:
    return round(block.time_offset_s * 1e9)


# A decoder answers None for a message that says nothing (not finite, no point in range): the caller counts.


def decode_imu(message: Any, block: ImuBlock) -> ImuSample | None:
    """`sensor_msgs/Imu`; the accelerometer's unit is the rig's ``accel_unit``. Absurd values say nothing."""
    w, a = message.angular_velocity, message.linear_acceleration
    scale = STANDARD_GRAVITY if block.accel_unit == "g" else 1.0
    gyro, accel = (w.x, w.y, w.z), (scale * a.x, scale * a.y, scale * a.z)
    if not all(abs(x) < _MAX_GYRO for x in gyro) or not all(abs(x) < _MAX_ACCEL for x in accel):
        return None  # NaN is below nothing
    return ImuSample(stamp_ns(message, block), np.array(gyro), np.array(accel))


def decode_wheel(message: Any, block: SensorBlock) -> WheelSpeed | None:
    """Forward speed of `TwistStamped`, `TwistWithCovarianceStamped` or `Odometry` (its twist)."""
    twist = message.twist
    speed = (twist if "TwistStamped" in message.__msgtype__ else twist.twist).linear.x
    return WheelSpeed(stamp_ns(message, block), speed) if math.isfinite(speed) else None


def decode_uwb(message: Any, block: UwbBlock) -> UwbRange | None:
    """`sensor_msgs/Range` with frame_id ``anchor_<id>``; outside the message's limits it says nothing."""
    frame = str(message.header.frame_id)
    number = frame.removeprefix(_ANCHOR)
    if not frame.startswith(_ANCHOR) or not number.isdecimal():
        raise RecordingError(f"frame_id {frame!r} names no anchor", field=block.topic, mend=f"set `{_ANCHOR}<id>`")
    if int(number) not in block.anchors:
        known = ", ".join(map(str, sorted(block.anchors)))
        raise RecordingError(
            f"anchor {number} is not in the rig (known: {known})",
            field=block.topic,
            mend="add its position to `uwb.anchors`, or leave uwb out",
        )
    distance = float(message.range)
    limited = message.max_range > message.min_range
    if not math.isfinite(distance) or (limited and not message.min_range <= distance <= message.max_range):
        return None
    return UwbRange(stamp_ns(message, block), int(number), distance)


def decode_prism(message: Any, block: TotalStationBlock) -> PrismFix | None:
    """`geometry_msgs/PointStamped`, the prism in the map frame."""
    p = np.array([message.point.x, message.point.y, message.point.z], dtype=np.float64)
    return PrismFix(stamp_ns(message, block), p) if np.isfinite(p).all() else None


def decode_scan(message: Any, block: LidarBlock, times: PointTimeFormat) -> Scan | None:
    """`sensor_msgs/PointCloud2`: points that are not finite, out of range or without a time are left out."""
    table = point_table(message)
    points = coordinates(table)
    offsets, timed = times.offsets_ns(table, header_ns(message))
    keep = np.flatnonzero(within_range(points, block.min_range, block.max_range) & timed)
    if not len(keep):
        return None
    ring, intensity = _column(table, RING_FIELDS, np.uint16), _column(table, INTENSITY_FIELDS, np.float32)
    return Scan(
        stamp_ns(message, block),
        points[keep],
        offsets[keep],
        ring=None if ring is None else ring[keep],
        intensity=None if intensity is None else intensity[keep],
    )


def _column(table: NDArray[Any], wanted: tuple[str, ...], dtype: type) -> NDArray[Any] | None:
    name = find_column(table.dtype.names or (), wanted)
    with np.errstate(over="ignore", invalid="ignore"):
        return None if name is None else table[name].astype(dtype)


DECODERS: Mapping[str, Callable[..., Measurement | None]] = {
    "imu": decode_imu,
    "wheel": decode_wheel,
    "uwb": decode_uwb,
    "total_station": decode_prism,
}
"""Sensor block -> decoder of message and block; scans need to know the point times as well."""


class MessageMaker:
    """Makes ROS messages of measurements, in the rig's terms.

    Parameters
    ----------
    types : message type name -> class, of one ROS version.
    rig : clock offsets and the accelerometer's unit are undone, so that what is read equals what was written.
    """

    def __init__(self, types: Mapping[str, Callable[..., Any]], rig: Rig, *, ros1: bool) -> None:
        self._types, self._rig, self._ros1 = types, rig, ros1

    def sensor_of(self, measurement: Measurement) -> str:
        """Key of the rig block a measurement belongs to. Raises `RecordingError` where the rig lacks it."""
        kinds = {
            ImuSample: "imu",
            Scan: "lidar",
            WheelSpeed: "wheel",
            UwbRange: "uwb",
            PrismFix: "total_station",
        }
        sensor = kinds[type(measurement)]
        if getattr(self._rig, sensor) is None:
            raise RecordingError(f"the rig has no {sensor}", field=sensor, mend=f"add a `{sensor}` block to the rig")
        return sensor

    def make(self, measurement: Measurement) -> Any:
        """The message of a measurement."""
        block = getattr(self._rig, self.sensor_of(measurement))
        stamp = measurement.stamp_ns - _offset_ns(block)
        match measurement:
            case ImuSample():
                return self._imu(stamp, measurement)
            case Scan():
                return self._cloud(stamp, measurement)
            case WheelSpeed():
                return self._twist(stamp, measurement)
            case UwbRange():
                return self._range(stamp, measurement)
            case PrismFix():
                point = self._new("geometry_msgs/msg/Point", *measurement.p_map.tolist())
                return self._new("geometry_msgs/msg/PointStamped", self._header(stamp, self._rig.frame), point)

    def _new(self, name: str, *values: Any) -> Any:
        return self._types[name](*values)

    def _vector(self, x: float, y: float, z: float) -> Any:
        return self._new("geometry_msgs/msg/Vector3", float(x), float(y), float(z))

    def _header(self, stamp: int, frame: str) -> Any:
        if stamp < 0:
            raise SemmapError(f"stamp {stamp} ns is negative", field=frame, mend="ROS time starts at zero")
        time = self._new("builtin_interfaces/msg/Time", *divmod(stamp, 1_000_000_000))
        values = (0, time, frame) if self._ros1 else (time, frame)
        return self._new("std_msgs/msg/Header", *values)

    def _imu(self, stamp: int, sample: ImuSample) -> Any:
        scale = STANDARD_GRAVITY if self._rig.imu.accel_unit == "g" else 1.0
        unknown = np.zeros(9)
        no_orientation = np.array([-1.0, 0, 0, 0, 0, 0, 0, 0, 0])
        return self._new(
            "sensor_msgs/msg/Imu",
            self._header(stamp, "imu"),
            self._new("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0),
            no_orientation,
            self._vector(*sample.gyro),
            unknown,
            self._vector(*(sample.accel / scale)),
            unknown,
        )

    def _twist(self, stamp: int, wheel: WheelSpeed) -> Any:
        twist = self._new("geometry_msgs/msg/Twist", self._vector(wheel.speed, 0.0, 0.0), self._vector(0.0, 0.0, 0.0))
        return self._new("geometry_msgs/msg/TwistStamped", self._header(stamp, "wheel"), twist)

    def _range(self, stamp: int, uwb: UwbRange) -> Any:
        no_limits = (0.0, 0.0)
        return self._new(
            "sensor_msgs/msg/Range",
            self._header(stamp, f"{_ANCHOR}{uwb.anchor}"),
            1,
            0.0,
            *no_limits,
            float(uwb.distance),
        )

    def _cloud(self, stamp: int, scan: Scan) -> Any:
        layout, step, data = encode_scan(scan)
        fields = [self._new("sensor_msgs/msg/PointField", f.name, f.offset, f.datatype, 1) for f in layout]
        n = len(scan.points)
        return self._new(
            "sensor_msgs/msg/PointCloud2",
            self._header(stamp, "lidar"),
            1,
            n,
            fields,
            False,
            step,
            step * n,
            data,
            True,
        )
