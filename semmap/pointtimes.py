"""What the time stamps of a cloud's points mean: which field, which unit, counted from where.

There is no standard, so the numbers of the first clouds are held against the rate of the scans and the
header stamps. Where they do not tell, an error names the rig keys that do: nothing is guessed silently.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from semmap.errors import CloudError, RecordingError
from semmap.pointcloud2 import find_column
from semmap.rig import LidarBlock

Unit: TypeAlias = Literal["s", "ms", "us", "ns"]
Reference: TypeAlias = Literal["relative", "absolute", "first"]

TIME_FIELDS = (
    "time",
    "t",
    "timestamp",
    "offset_time",
    "time_stamp",
    "timestamps",
    "time_offset",
    "offsettime",
    "t_offset",
    "point_time",
    "point_time_offset",
    "relative_time",
    "stamp",
)
NO_TIME = "none"
"""`lidar.time_field: none` in the rig: the points carry no time because the clouds are deskewed."""

_UNIT_NS: dict[Unit, int] = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
_MAX_OFFSET_NS = 10_000_000_000
_COARSEST_NS = 50_000.0
_MEND = "set `time_field`, `time_unit` and `time_reference` in the rig's lidar block"


@dataclass(frozen=True, slots=True)
class PointTimeFormat:
    """How to read the time of a point.

    field : the column, or None where every point has the time of the header (deskewed clouds).
    unit : of its numbers.
    reference : ``relative`` to the header stamp, ``absolute`` on the header's clock, or counted on a clock of
        the sensor's own where the ``first`` (earliest) point has the time of the header.
    """

    field: str | None
    unit: Unit = "ns"
    reference: Reference = "relative"

    def __str__(self) -> str:
        return f"{self.field} [{self.unit}], {self.reference}" if self.field else "none: clouds are deskewed"

    def offsets_ns(self, table: NDArray[Any], header_ns: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Offsets (n,) from the header stamp [ns], and a mask (n,): false where not finite or absurd."""
        if self.field is None:
            return np.zeros(len(table), np.int64), np.ones(len(table), np.bool_)
        if self.field not in (table.dtype.names or ()):
            raise CloudError("is missing", field=self.field, mend=_MEND)
        return _offsets(table[self.field], self.unit, self.reference, header_ns)


class TimeSample(NamedTuple):
    """The valid points (n,) of one cloud as a structured array, and the cloud's header stamp."""

    header_ns: int
    table: NDArray[Any]


def _offsets(
    values: NDArray[Any], unit: Unit, reference: Reference, header_ns: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    scale = _UNIT_NS[unit]
    origin_ns = _origin_ns(values, unit, reference, header_ns)
    if values.dtype.kind in "iu":
        offsets = values.astype(np.int64) * scale - origin_ns
        return offsets, np.abs(offsets) <= _MAX_OFFSET_NS
    # Whole units first: an epoch in nanoseconds has more digits than a float64, its difference has not.
    whole, rest = divmod(origin_ns, scale)
    with np.errstate(invalid="ignore"):
        offsets_float = (values.astype(np.float64) - whole) * scale - rest
        good = np.abs(offsets_float) <= _MAX_OFFSET_NS
    return np.rint(np.where(good, offsets_float, 0.0)).astype(np.int64), good


def _origin_ns(values: NDArray[Any], unit: Unit, reference: Reference, header_ns: int) -> int:
    """What the numbers say [ns] at the time of the header. Drivers give zero to points without return."""
    if reference != "first":
        return header_ns if reference == "absolute" else 0
    told = values[np.isfinite(values) & (values != 0)]
    return round(told.min().item() * _UNIT_NS[unit]) if len(told) else 0


def classify_point_times(samples: Sequence[TimeSample], block: LidarBlock) -> PointTimeFormat:
    """What the points' times mean, from the first clouds of a recording.

    The span of the numbers within a cloud, held against the time between clouds, tells the unit; their
    distance from zero and from the header stamps, and whether they move on with the stamps, tells the
    reference. What the rig gives (``time_field``, ``time_unit``, ``time_reference``) is taken as given.

    Raises
    ------
    RecordingError
        Where there is no such field, its numbers fit no reading or more than one, or are too coarse.
    """
    if block.time_field is not None and block.time_field.lower() == NO_TIME:
        return PointTimeFormat(None)
    names = samples[0].table.dtype.names or ()
    fields = _candidate_fields(names, block)
    problems: list[RecordingError] = []
    for field in fields:
        try:
            return _classify_field(field, samples, block)
        except RecordingError as problem:
            problems.append(problem)
    raise problems[0]


def _candidate_fields(names: Sequence[str], block: LidarBlock) -> list[str]:
    wanted = TIME_FIELDS if block.time_field is None else (block.time_field.lower(),)
    found = [name for field in wanted if (name := find_column(names, (field,)))]
    if found:
        return found
    what = "points have no time field" if block.time_field is None else f"points have no field `{block.time_field}`"
    raise RecordingError(
        f"{what}; fields are {', '.join(names)}",
        field=block.topic,
        mend=f"set `time_field` in the rig's lidar block, to `{NO_TIME}` if the clouds are deskewed",
    )


def _classify_field(field: str, samples: Sequence[TimeSample], block: LidarBlock) -> PointTimeFormat:
    columns = [column for column in (_Column.of(sample, field) for sample in samples) if column is not None]
    if not columns:
        raise _unclear(block, field, "holds no finite number")
    if block.time_unit and block.time_reference:
        given = PointTimeFormat(field, block.time_unit, block.time_reference)
        _refuse_coarse(columns, given, block)
        return given
    period_ns = _scan_period_ns(samples, block)
    units = [unit for unit in _UNIT_NS if block.time_unit in (None, unit) and _span_fits(columns, unit, period_ns)]
    readings = [
        PointTimeFormat(field, unit, reference)
        for unit in units
        for reference in _references(columns, unit, period_ns)
        if block.time_reference in (None, reference)
    ]
    if len(readings) == 1:
        _refuse_coarse(columns, readings[0], block)
        return readings[0]
    _refuse_lost_digits(columns, field, block)
    if len(readings) > 1:
        raise _unclear(block, field, f"can be read as {' or '.join(map(str, readings))}")
    raise _unclear(block, field, _why_unreadable(columns, units))


class _Column(NamedTuple):
    """Least and greatest time of a cloud in the field's own numbers, its type, and the header stamp."""

    header_ns: int
    low: float
    high: float
    dtype: np.dtype[Any]

    @classmethod
    def of(cls, sample: TimeSample, field: str) -> _Column | None:
        values = sample.table[field]
        finite = values[np.isfinite(values)]
        if not len(finite):
            return None
        return cls(sample.header_ns, float(finite.min()), float(finite.max()), values.dtype)

    def resolution_ns(self, unit: Unit) -> float:
        """Step between neighbouring numbers of this size and type [ns]."""
        if self.dtype.kind in "iu":
            return float(_UNIT_NS[unit])
        largest = max(abs(self.low), abs(self.high))
        return float(np.spacing(self.dtype.type(largest))) * _UNIT_NS[unit]


def _scan_period_ns(samples: Sequence[TimeSample], block: LidarBlock) -> float | None:
    """Time between scans by their header stamps, else by the rig's rate."""
    steps = np.diff([sample.header_ns for sample in samples])
    steps = steps[steps > 0]
    if len(steps):
        return float(np.median(steps))
    return None if block.rate_hz is None else 1e9 / block.rate_hz


def _span_fits(columns: Sequence[_Column], unit: Unit, period_ns: float | None) -> bool:
    """Whether a cloud spreads over about one scan. The limits are less than 1000 apart, so one unit fits."""
    shortest, longest = (2e6, 1.5e9) if period_ns is None else (period_ns / 25.0, period_ns * 2.5)
    span = max(column.high - column.low for column in columns) * _UNIT_NS[unit]
    return shortest <= span <= longest


def _references(columns: Sequence[_Column], unit: Unit, period_ns: float | None) -> list[Reference]:
    """Readings of where the numbers count from that all clouds allow."""
    scale = _UNIT_NS[unit]
    near = 2.5 * (period_ns or 1e9)
    lows = np.array([column.low * scale for column in columns])
    highs = np.array([column.high * scale for column in columns])
    stamps = np.array([column.header_ns for column in columns], dtype=np.float64)
    relative = bool((np.maximum(np.abs(lows), np.abs(highs)) <= near).all())
    absolute = bool((np.maximum(np.abs(lows - stamps), np.abs(highs - stamps)) <= near).all())
    if relative and absolute and np.ptp(stamps) > 0:
        # Both near zero, as in a simulation that starts there: absolute times move on with the stamps.
        moves = abs(float(np.polyfit(stamps - stamps[0], lows, 1)[0])) > 0.5
        return ["absolute"] if moves else ["relative"]
    readings: tuple[tuple[Reference, bool], ...] = (("relative", relative), ("absolute", absolute))
    return [reference for reference, fits in readings if fits]


def _refuse_coarse(columns: Sequence[_Column], reading: PointTimeFormat, block: LidarBlock) -> None:
    coarsest = max(column.resolution_ns(reading.unit) for column in columns)
    if columns[0].dtype.kind == "f" and coarsest > _COARSEST_NS:
        raise _too_coarse(block, str(reading.field), columns[0].dtype, coarsest)


def _refuse_lost_digits(columns: Sequence[_Column], field: str, block: LidarBlock) -> None:
    """Say so where the numbers are absolute times squeezed into too short a float."""
    first = columns[0]
    for unit, scale in _UNIT_NS.items():
        step_ns = first.resolution_ns(unit)
        near_stamp = abs(first.high * scale - first.header_ns) <= 2.0 * step_ns + 1e9
        if first.dtype.kind == "f" and near_stamp and first.header_ns > 1e10 and step_ns > _COARSEST_NS:
            raise _too_coarse(block, field, first.dtype, step_ns)


def _too_coarse(block: LidarBlock, field: str, dtype: np.dtype[Any], step_ns: float) -> RecordingError:
    return RecordingError(
        f"point times in `{field}` ({dtype.name}) go in steps of {step_ns * 1e-9:.2g} s: digits are lost",
        field=block.topic,
        mend=f"record times from the scan's start or in float64, or set `time_field: {NO_TIME}` if deskewed",
    )


def _why_unreadable(columns: Sequence[_Column], units: Sequence[Unit]) -> str:
    low, high = columns[0].low, columns[0].high
    if all(column.low == column.high for column in columns):
        return f"holds one and the same number ({low:.10g}) for all points of a cloud"
    seen = f"runs from {low:.10g} to {high:.10g} in the first cloud"
    if not units:
        return f"{seen}, which is no scan's duration in s, ms, us or ns"
    return f"{seen}, near neither zero nor the header stamp ({columns[0].header_ns} ns)"


def _unclear(block: LidarBlock, field: str, what: str) -> RecordingError:
    mend = f"{_MEND} (`time_field: {NO_TIME}` if the clouds are deskewed)"
    return RecordingError(f"point times in `{field}` are unclear: it {what}", field=block.topic, mend=mend)
