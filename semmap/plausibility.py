"""Whether a recording and its rig speak of the same things: clocks, units, clouds with points in them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from semmap.errors import CloudError, RecordingError
from semmap.messages import decode_imu, header_ns
from semmap.pointcloud2 import coordinates, point_table, within_range
from semmap.pointtimes import TimeSample
from semmap.rig import STANDARD_GRAVITY, ImuBlock, LidarBlock

_TIME_SAMPLES = 8


def check_clocks(first_stamps: Mapping[str, int], duration_s: float) -> None:
    """Raise `RecordingError` where two topics' first stamps lie further apart than the recording is long."""
    by_stamp = sorted(first_stamps.items(), key=lambda item: item[1])
    if not by_stamp:
        return
    (early, low), (late, high) = by_stamp[0], by_stamp[-1]
    if (high - low) * 1e-9 > duration_s + 1.0:
        apart = f"{(high - low) * 1e-9:.3g} s apart in {duration_s:.3g} s of recording"
        raise RecordingError(
            f"header stamps of {early} and {late} are {apart}",
            field=late,
            mend="set `time_offset_s` in the rig, or record with one clock",
        )


def check_imu(messages: Iterable[tuple[str, Any]], block: ImuBlock) -> None:
    """Raise `RecordingError` where the first samples are not finite, stand still, or in another unit."""
    samples = [sample for _, message in messages if (sample := decode_imu(message, block)) is not None]
    if not samples:
        raise RecordingError("none of the first samples is finite", field=block.topic, mend="check the IMU driver")
    if len(samples) > 1 and samples[0].stamp_ns == samples[-1].stamp_ns:
        raise RecordingError("header stamps stand still", field=block.topic, mend="have the driver fill them in")
    accel = float(np.median([np.linalg.norm(sample.accel) for sample in samples]))
    _check_accel_unit(accel, block)


def _check_accel_unit(accel: float, block: ImuBlock) -> None:
    """``accel``: median length of the specific force [m/s²] as the rig's unit has it, near g at work."""
    in_unit = accel / STANDARD_GRAVITY if block.accel_unit == "g" else accel
    read = f"specific force is {in_unit:.3g} {block.accel_unit} at the start"
    if block.accel_unit == "m/s2" and 0.8 < accel < 1.2:
        raise RecordingError(
            f"{read}, which looks like g", field=block.topic, mend="set `accel_unit: g` in the rig's imu"
        )
    if block.accel_unit == "g" and 0.8 * STANDARD_GRAVITY < in_unit < 1.2 * STANDARD_GRAVITY:
        raise RecordingError(
            f"{read}, which looks like m/s2",
            field=block.topic,
            mend="set `accel_unit: m/s2` in the rig's imu",
        )
    if not 0.3 * STANDARD_GRAVITY < accel < 3.0 * STANDARD_GRAVITY:
        raise RecordingError(
            f"{read}, which is not gravity in m/s2 or g",
            field=block.topic,
            mend="check `accel_unit`, and record the accelerometer with gravity left in",
        )


def time_samples(clouds: Iterable[Any], block: LidarBlock) -> list[TimeSample]:
    """The valid points of the first clouds that have any.

    Raises `CloudError` where none has, `RecordingError` where the header stamps stand still.
    """
    samples: list[TimeSample] = []
    n_clouds = n_points = 0
    for cloud in clouds:
        table = point_table(cloud)
        valid = within_range(coordinates(table), block.min_range, block.max_range)
        n_clouds, n_points = n_clouds + 1, n_points + len(table)
        if valid.any():
            samples.append(TimeSample(header_ns(cloud), table[valid]))
        if len(samples) == _TIME_SAMPLES:
            break
    if not samples:
        limits = f"{block.min_range:g} to {block.max_range:g} m away"
        raise CloudError(
            f"none of {n_points} points in {n_clouds} clouds is finite and {limits}",
            field=block.topic,
            mend="check the driver, `min_range` and `max_range` in the rig, and that coordinates are metres",
        )
    if len(samples) > 1 and len({sample.header_ns for sample in samples}) == 1:
        raise RecordingError("header stamps stand still", field=block.topic, mend="have the driver fill them in")
    return samples
