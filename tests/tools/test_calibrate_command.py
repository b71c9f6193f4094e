"""`semmap calibrate-imu`: from a recording into a rig file, or one line that says why not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from semmap.measurements import ImuSample
from semmap.recordings import RecordingWriter
from semmap.rig import ImuBlock, Rig
from tools import cli
from tools.simulator.imu import imu_errors
from tools.simulator.vibration import oil_pumps, standing_imu

RATE = 200.0
RIG = """\
imu:
  topic: /imu/data  # strapped to the boom
  rate_hz: 200
  gyro_noise: 0.001
"""
TRUE = ImuBlock(topic="/imu/data", gyro_noise=4e-4, accel_noise=3e-3, gyro_bias_std=2e-3, accel_bias_std=0.02)


def recorded(directory: Path, seconds: float) -> tuple[Path, Path]:
    """A recording of an IMU on a machine with its pumps on, and its rig file."""
    rig = directory / "rig.yaml"
    rig.write_text(RIG)
    t = np.arange(round(seconds * RATE)) / RATE
    gyro, accel = standing_imu(
        t, np.eye(3), earth_rate=np.zeros(3), gravity=9.80665, vibration=oil_pumps(1, gyro_rms=0.005, accel_rms=0.3)
    )
    errors = imu_errors(TRUE, len(t), RATE, 1.0, np.random.default_rng(5))
    with RecordingWriter(directory / "bag", Rig.from_yaml(rig)) as writer:
        for stamp, w, f in zip(
            np.round(t * 1e9).astype(np.int64).tolist(), gyro + errors[0], accel + errors[1], strict=True
        ):
            writer.write(ImuSample(stamp + 1_000_000_000, w, f))
    return directory / "bag", rig


def test_the_noise_goes_into_the_rig_file(tmp_path, capsys) -> None:
    bag, rig = recorded(tmp_path, 70.0)
    assert cli.run(["calibrate-imu", str(bag), "--rig", str(rig)]) == 0
    said = capsys.readouterr().out
    assert "s at rest" in said
    assert "±" in said
    assert "# strapped to the boom" in rig.read_text()
    imu = Rig.from_yaml(rig).imu
    assert imu.gyro_noise == pytest.approx(TRUE.gyro_noise, rel=0.25)
    assert imu.accel_noise == pytest.approx(TRUE.accel_noise, rel=0.25)
    assert imu.gyro_bias_std < 0.01


def test_another_file_leaves_the_rig_alone_and_two_runs_agree(tmp_path) -> None:
    bag, rig = recorded(tmp_path, 70.0)
    out = tmp_path / "other.yaml"
    assert cli.run(["calibrate-imu", str(bag), "--rig", str(rig), "--out", str(out)]) == 0
    assert rig.read_text() == RIG
    assert cli.run(["calibrate-imu", str(bag), "--rig", str(rig)]) == 0
    assert rig.read_bytes() == out.read_bytes() != RIG.encode()


def test_a_short_recording_is_refused_in_one_line(tmp_path, capsys) -> None:
    bag, rig = recorded(tmp_path, 20.0)
    assert cli.run(["calibrate-imu", str(bag), "--rig", str(rig)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "bag: /imu/data: stands still for 19 s" in error
    assert rig.read_text() == RIG
