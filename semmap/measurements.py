"""What sensors say: one frozen type a sensor, validated when it is made."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import isfinite
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from semmap.errors import MeasurementError

_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


def _finite_vector(owner: str, name: str, value: object) -> NDArray[np.float64]:
    vector = np.asarray(value, dtype=np.float64)
    if vector.shape != (3,):
        where = f"{owner}.{name}"
        raise MeasurementError(f"has shape {vector.shape}", field=where, mend="give three numbers")
    if not all(map(isfinite, vector.tolist())):
        raise MeasurementError("is not finite", field=f"{owner}.{name}", mend="drop this sample")
    return vector


def _finite_number(owner: str, name: str, value: float) -> float:
    if not np.isfinite(value):
        raise MeasurementError("is not finite", field=f"{owner}.{name}", mend="drop this sample")
    return float(value)


def _phases(count: int) -> NDArray[np.float32]:
    """Multiples of the golden ratio modulo 1, (count,): any stretch of them, and any stride, is spread over [0, 1)."""
    return _table_of_phases(1 << (count - 1).bit_length())[:count]


@cache
def _table_of_phases(count: int) -> NDArray[np.float32]:
    return np.asarray(np.arange(count) * _GOLDEN % 1.0, dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One turn of the LiDAR.

    stamp_ns : reference time of the scan.
    points : (n, 3) float32, metres, in the lidar frame *at the time of each point* (not deskewed), finite.
    offsets_ns : (n,) int64, time of each point minus ``stamp_ns``.
    ring : (n,) beam number, or None.
    intensity : (n,) or None.
    """

    stamp_ns: int
    points: NDArray[np.float32]
    offsets_ns: NDArray[np.int64]
    ring: NDArray[np.uint16] | None = None
    intensity: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        points = np.ascontiguousarray(self.points, dtype=np.float32)
        offsets = np.ascontiguousarray(self.offsets_ns, dtype=np.int64)
        if points.ndim != 2 or points.shape[1] != 3:
            what = f"has shape {points.shape}"
            raise MeasurementError(what, field="Scan.points", mend="give an (n, 3) array")
        if not np.isfinite(points).all():
            raise MeasurementError("holds NaN or infinity", field="Scan.points", mend="remove those points")
        for name in ("offsets_ns", "ring", "intensity"):
            column = getattr(self, name)
            if column is not None and np.shape(column) != (len(points),):
                raise MeasurementError(
                    f"has shape {np.shape(column)} for {len(points)} points",
                    field=f"Scan.{name}",
                    mend="give one value a point",
                )
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "offsets_ns", offsets)

    @property
    def end_ns(self) -> int:
        """Time of the last point (``stamp_ns`` for an empty scan)."""
        return self.stamp_ns + int(self.offsets_ns.max(initial=0))

    def since(self, stamp_ns: int) -> Scan:
        """The part of the scan from ``stamp_ns`` on."""
        if self.stamp_ns + int(self.offsets_ns.min(initial=0)) >= stamp_ns:
            return self
        return self.part(self.offsets_ns >= stamp_ns - self.stamp_ns)

    def thinned(self, count: int) -> Scan:
        """About ``count`` of the points, evenly from all of the scan whatever its order; itself if it has no more."""
        if len(self.points) <= count:
            return self
        return self.part(_phases(len(self.points)) < count / len(self.points))

    def part(self, kept: NDArray[np.bool_]) -> Scan:
        """The points for which ``kept`` (n,) holds."""
        rows = np.flatnonzero(kept)
        return Scan(
            self.stamp_ns,
            self.points.take(rows, axis=0),
            self.offsets_ns.take(rows),
            None if self.ring is None else self.ring.take(rows),
            None if self.intensity is None else self.intensity.take(rows),
        )


@dataclass(frozen=True, slots=True, eq=False)
class ImuSample:
    """Angular rate ``gyro`` (3,) [rad/s] and specific force ``accel`` (3,) [m/s²] in the imu frame."""

    stamp_ns: int
    gyro: NDArray[np.float64]
    accel: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "gyro", _finite_vector("ImuSample", "gyro", self.gyro))
        object.__setattr__(self, "accel", _finite_vector("ImuSample", "accel", self.accel))


@dataclass(frozen=True, slots=True)
class WheelSpeed:
    """Forward ``speed`` [m/s] along x of the wheel frame."""

    stamp_ns: int
    speed: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "speed", _finite_number("WheelSpeed", "speed", self.speed))


@dataclass(frozen=True, slots=True)
class UwbRange:
    """``distance`` [m] from the tag to the anchor numbered ``anchor`` in the rig."""

    stamp_ns: int
    anchor: int
    distance: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "distance", _finite_number("UwbRange", "distance", self.distance))


@dataclass(frozen=True, slots=True, eq=False)
class PrismFix:
    """Position ``p_map`` (3,) [m] of the prism in the map frame, from a total station."""

    stamp_ns: int
    p_map: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "p_map", _finite_vector("PrismFix", "p_map", self.p_map))


Measurement: TypeAlias = Scan | ImuSample | WheelSpeed | UwbRange | PrismFix
