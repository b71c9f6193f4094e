"""`semmap calibrate-imu`: the noise of a recording's IMU, written into its rig file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from localize.earth import Earth
from localize.imu_calibration import ImuCalibration, calibrate
from localize.imu_noise import Level
from semmap.errors import RecordingError, RigError
from semmap.measurements import ImuSample
from semmap.recordings import read_recording
from semmap.rig import Rig
from semmap.yaml_edit import with_values
from tools.files import writable_file, write_text
from tools.progress import Advance

_UNITS = {"gyro": "rad/s", "accel": "m/s²"}


def calibrate_recording(
    recording: Path, rig_file: Path, out: Path, *, progress: Advance | None = None
) -> ImuCalibration:
    """Calibrate the IMU of ``recording`` and write ``rig_file`` with the noise found to ``out``.

    Comments and all other keys stay. Raises the errors of rig and recording, and `RecordingError` where nothing of it
    is at rest for a minute; nothing is written then.
    """
    writable_file(out)
    rig = Rig.from_yaml(rig_file)
    samples = [
        sample
        for sample in read_recording(recording, rig.without("lidar", "wheel", "uwb", "prism"), progress=progress)
        if isinstance(sample, ImuSample)
    ]
    stamps = np.array([sample.stamp_ns for sample in samples], np.int64)
    if (np.diff(stamps) <= 0).any():
        what = "stamps do not increase"
        raise RecordingError(what, file=recording, field=rig.imu.topic, mend="record with the sensor's own clock")
    gyro, accel = (np.array([getattr(sample, name) for sample in samples]).reshape(-1, 3) for name in _UNITS)
    try:
        found = calibrate(stamps, gyro, accel, rig.imu, Earth.of(rig.earth))
    except RecordingError as error:
        raise RecordingError(error.what, file=recording, field=error.field, mend=error.mend) from None
    try:
        text = with_values(rig_file.read_text(encoding="utf-8"), "imu", found.noise_block)
    except ValueError as reason:
        raise RigError(str(reason), file=rig_file, mend="write the block out, without anchors or aliases") from None
    write_text(out, text)
    return found


def report_lines(found: ImuCalibration) -> Iterator[str]:
    """What was found and how sure it is, for people."""
    stretch = found.stretch
    yield f"{stretch.duration_s:.0f} s at rest, samples {stretch.begin} to {stretch.end}"
    yield f"greatest change from second to second: {100.0 * stretch.unrest:.0f} % of what would be motion"
    for sensor, noise in (("gyro", found.gyro), ("accel", found.accel)):
        unit, written = _UNITS[sensor], found.noise_block[f"{sensor}_bias_walk"]
        yield f"{sensor}_noise       {_said(noise.white)} {unit}/√Hz"
        yield f"{sensor}_bias_walk   {_said(noise.walk)} {unit}/s/√Hz; written: {written:.2g}"
        yield f"{sensor} instability {_said(noise.instability)} {unit}"
    bias = ", ".join(f"{value:.2g}" for value in found.gyro_bias)
    yield f"turn-on: rate {bias} rad/s, specific force {found.force_error:+.2g} m/s² off gravity"


def _said(level: Level) -> str:
    if not level.seen:
        return f"not seen, at most {level.bound:.2g}"
    return f"{level.value:.3g} ± {100.0 * level.std / level.value:.0f} %"
