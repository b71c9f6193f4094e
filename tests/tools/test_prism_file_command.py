"""`semmap localize --prism FILE`: fixes from a file, on another clock, in a recording that has no topic for them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from semmap.measurements import PrismFix
from semmap.recordings import RecordingWriter
from semmap.rig import WheelBlock
from semmap.trajectory import Trajectory
from tools import cli
from tools.simulator import SensorFaults, SimulationSettings, fly, scenario, simulate_measurements
from tools.simulator.rigs import save_rig
from tools.simulator.settings import MotionSettings

BRISK = MotionSettings(
    speed=1.0, max_accel=0.6, still_s=3.0, wobble_deg=0.4, pumps=True, vibration_accel=0.3, vibration_gyro=0.005,
    schedule=((4.0, 2.5), (1.0, 1.0), (5.5, 3.0), (2.5, 0.5)),
)  # fmt: skip


@pytest.fixture(scope="module")
def flight():
    """The roadheader in a hurry, with few beams and a track encoder."""
    mine = scenario("roadway-consumer", 1)
    rig = mine.scenario.robot.rig
    rig = rig.model_copy(
        update={
            "wheel": WheelBlock(topic="/wheel", rate_hz=20, speed_std=0.02, p_imu_wheel=(0.0, 0.0, -1.5)),
            "lidar": rig.lidar.model_copy(update={"columns": 360}),
        }
    )
    settings = SimulationSettings(motion=BRISK, faults=SensorFaults(prism_clock_s=-1.7))
    return fly(mine, None, rig, settings=settings, seed=1)


@pytest.fixture(scope="module")
def files(flight, tmp_path_factory) -> Path:
    """Recording without the prism, rig file without its topic, and the fixes as a CSV on the instrument's clock."""
    directory = tmp_path_factory.mktemp("prism")
    with RecordingWriter(directory / "bag", flight.rig.without("prism")) as writer:
        for measurement in simulate_measurements(replace(flight, rig=flight.rig.without("prism"))):
            writer.write(measurement)
    fixes = [
        m for m in simulate_measurements(replace(flight, rig=flight.rig.without("lidar"))) if isinstance(m, PrismFix)
    ]
    rows = [f"{fix.stamp_ns * 1e-9:.9f},{','.join(f'{x:.4f}' for x in fix.p_map)}" for fix in fixes]
    (directory / "fixes.csv").write_text("\n".join(["time,x,y,z", *rows]) + "\n")
    station = flight.rig.total_station.model_dump(exclude_unset=True, exclude={"topic"})
    rig = flight.rig.model_copy(update={"total_station": type(flight.rig.total_station)(**station)})
    save_rig(directory / "rig.yaml", rig)
    return directory


def localize(files: Path, out: Path, *more: str, rig: str = "rig.yaml") -> int:
    return cli.run(["localize", str(files / "bag"), "--rig", str(files / rig), "--out", str(out), *more])


def test_the_file_places_the_machine_though_its_clock_is_wrong(files, flight, tmp_path) -> None:
    assert localize(files, tmp_path / "run", "--prism", str(files / "fixes.csv")) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["prism_clock"]["offset_s"] == pytest.approx(1.7, abs=0.03)
    assert summary["prism_fixes"] > 100
    found = Trajectory.load_tum(tmp_path / "run" / "trajectory.tum")
    off = found.positions - flight.truth().at(found.stamps_ns)[:, :3, 3]
    assert found.frame == "map"
    # at 1 m/s what is left of the clocks' difference is some millimetres more
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 0.04


@pytest.mark.slow
def test_a_known_offset_is_taken_as_it_is(files, tmp_path) -> None:
    text = (files / "rig.yaml").read_text()
    (files / "timed.yaml").write_text(text.replace("total_station:\n", "total_station:\n  time_offset_s: 1.7\n"))
    assert localize(files, tmp_path / "run", "--prism", str(files / "fixes.csv"), rig="timed.yaml") == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["prism_clock"] is None
    assert summary["anchored"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time,x,y,z\n1.0,2.0,3.0\n", "line 2"),
        ("time,x,y,z\n1.0,2.0,nan,3.0\n", "line 2"),
        ("stamp,east,north\n", "has no column x"),
        ("", "has no column"),
    ],
)
def test_a_bad_file_is_one_line(files, tmp_path, capsys, text, said) -> None:
    bad = tmp_path / "bad.csv"
    bad.write_text(text)
    assert localize(files, tmp_path / "run", "--prism", str(bad)) == cli.USER_ERROR
    complaint = capsys.readouterr().err
    assert said in complaint
    assert complaint.count("\n") == 1
    assert not (tmp_path / "run" / "trajectory.tum").exists()


def test_a_few_fixes_do_not_tell_the_clock(files, tmp_path, capsys) -> None:
    few = tmp_path / "few.csv"
    few.write_text("time,x,y,z\n1000.0,8.0,0.0,1.5\n")
    assert localize(files, tmp_path / "run", "--prism", str(few)) == cli.USER_ERROR
    assert "time_offset_s" in capsys.readouterr().err


def test_a_total_station_without_a_topic_needs_a_file(files, tmp_path, capsys) -> None:
    assert localize(files, tmp_path / "run") == cli.USER_ERROR
    assert "--prism FILE" in capsys.readouterr().err


def test_prism_and_without_prism_contradict(files, tmp_path, capsys) -> None:
    more = ("--prism", str(files / "fixes.csv"), "--without", "prism")
    assert localize(files, tmp_path / "run", *more) == cli.USER_ERROR
    assert "--without" in capsys.readouterr().err
