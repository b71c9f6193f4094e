"""The INS/total-station filter of paper 002 by itself over a drive of the roadheader: IMU and prism alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from localize.denoise import enhance
from localize.earth import Earth
from localize.ins_start import standing_start
from localize.ins_total_station import InsTotalStationFilter
from localize.settings import DenoiseSettings
from localize.static_alignment import align_static
from semmap.geometry import Array
from semmap.measurements import ImuSample, Measurement, PrismFix
from semmap.rig import Rig
from semmap.trajectory import Trajectory


def ins_track(rig: Rig, measurements: Sequence[Measurement], started_ns: int) -> Trajectory:
    """Poses at the IMU's samples from a start at rest, before ``started_ns``, on: each as known at its time.

    The IMU is enhanced as a whole recording; there is no LiDAR.
    """
    assert rig.total_station is not None
    samples = [m for m in measurements if isinstance(m, ImuSample)]
    fixes = [m for m in measurements if isinstance(m, PrismFix)]
    stamps = np.array([sample.stamp_ns for sample in samples], np.int64)
    gyro, accel = (np.array([getattr(sample, name) for sample in samples]) for name in ("gyro", "accel"))
    if rig.imu.engines:
        clean = enhance(stamps, gyro, accel, DenoiseSettings())
        gyro, accel = clean.gyro, clean.accel
    earth, resting = Earth.of(rig.earth), stamps < started_ns
    alignment = align_static(stamps[resting], gyro[resting], accel[resting], rig.imu, earth)
    first = [fix for fix in fixes if fix.stamp_ns < started_ns]
    start = PrismFix(first[-1].stamp_ns, np.mean([fix.p_map for fix in first], axis=0))
    state, P = standing_start(alignment, start, rig.imu, rig.total_station, earth)
    filter = InsTotalStationFilter(state, P, start.stamp_ns, rig.imu, rig.total_station, earth)
    known_ns: list[np.ndarray] = []
    poses: list[Array] = []
    for fix in [fix for fix in fixes if fix.stamp_ns >= started_ns]:
        at = stamps[(stamps > filter.stamp_ns) & (stamps < fix.stamp_ns)]
        at = np.concatenate([[filter.stamp_ns], at, [fix.stamp_ns]]).astype(np.int64)
        seconds, known = (at - stamps[0]) * 1e-9, (stamps - stamps[0]) * 1e-9
        rate, force = (
            np.column_stack([np.interp(seconds, known, axis) for axis in signal.T]) for signal in (gyro, accel)
        )
        track = filter.predict(at, rate, force)
        filter.update(fix)
        known_ns.append(at[1:])
        poses.append(track.poses[1:])
    return Trajectory("map", np.concatenate(known_ns), np.concatenate(poses))
