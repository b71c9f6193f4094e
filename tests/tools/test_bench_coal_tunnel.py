"""The coal tunnel's benchmark: what it feeds, how it places and measures trajectories, what it reads of our events."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from localize.results import Uncertainty
from semmap.errors import SettingsError
from semmap.geometry import inverse, se3, so3_exp, so3_log
from semmap.trajectory import Trajectory
from tools.bench.coal_events import axis_errors_deg, boundaries
from tools.bench.coal_extrinsics import OFF_DEG, OFF_M, put_off
from tools.bench.coal_figures import figures
from tools.bench.coal_runs import FAULTS, OURS, accuracy, outer_alignment
from tools.bench.coal_tunnel import Drive, errors_table, fault_table, known_systems, verdicts
from tools.metrics import associate
from tools.run import uncertainty_csv
from tools.simulator import SensorFaults
from tools.simulator.coal_tunnel import coal_rig


def drive_of(offset: np.ndarray | None = None) -> Trajectory:
    """75 m along x from the paper's start, at 0.3 m/s and 10 poses a second, nodding a little."""
    x = 11.49 + 0.03 * np.arange(2500)
    p = np.column_stack([x, np.zeros_like(x), np.full_like(x, 0.97)])
    R = so3_exp(np.column_stack([0.01 * np.sin(x), 0.02 * np.cos(x), np.zeros_like(x)]))
    return Trajectory("map", np.int64(1e8) * np.arange(2500), se3(R, p if offset is None else p + offset))


@pytest.mark.parametrize("seed", range(3))
def test_a_trajectory_of_any_frame_is_placed_by_the_outer_tunnel(seed: int) -> None:
    rng, truth = np.random.default_rng(seed), drive_of()
    T = se3(so3_exp(rng.normal(size=3)), 20.0 * rng.normal(size=3))
    estimate = Trajectory("odom", truth.stamps_ns, inverse(T) @ truth.poses)
    assert_allclose(outer_alignment(associate(estimate, truth)), T, atol=1e-9)
    one = accuracy(estimate, truth)
    assert one.placed == "by the truth" and one.compared == 15
    assert_allclose([one.avg_err, one.max, one.from_truth], 0.0, atol=1e-6)


def test_slides_count_as_what_they_are_and_offsets_only_where_nobody_places_it() -> None:
    truth = drive_of()
    slide = np.zeros((2500, 3))
    slide[1250:, 0] = -4.0
    slid = accuracy(Trajectory("odom", truth.stamps_ns, drive_of(slide).poses), truth)
    assert slid.max == pytest.approx(4.0)
    assert slid.avg_err == pytest.approx(4.0 * 8 / 15)
    assert slid.total_err == pytest.approx(15 * slid.avg_err)
    assert slid.percent == pytest.approx(100 * slid.avg_err / truth.length())
    off = accuracy(drive_of(np.array([0.0, 0.2, 0.0])), truth, drive_of(np.array([0.0, 0.3, 0.0])))
    assert off.placed == "by itself"
    assert_allclose([off.avg_err, off.realtime_err, off.from_truth], [0.2, 0.3, 0.0], atol=1e-6)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run directory whose odom is turned by a quarter about the vertical."""
    truth = drive_of()
    T_odom_map = se3(so3_exp([0.0, 0.0, np.pi / 2]), [3.0, 4.0, 5.0])
    Trajectory("odom", truth.stamps_ns, T_odom_map @ truth.poses).save_tum(tmp_path / "semmap" / "odometry.tum")
    truth.save_tum(tmp_path / "semmap" / "trajectory.tum")
    events = [
        {"stamp_ns": 1_000_000_000, "kind": "mode", "before": "LIO", "after": "LIU"},
        {"stamp_ns": 2_000_000_000, "kind": "degenerate", "of": "scan", "direction_odom": [0.0, 1.0, 0.0]},
        {"stamp_ns": 2_000_000_000, "kind": "degenerate", "of": "scan", "direction_odom": [0.6, -0.8, 0.0]},
        {"stamp_ns": 2_000_000_000, "kind": "degenerate", "of": "rotation", "axis_imu": [1.0, 0.0, 0.0]},
    ]
    (tmp_path / "semmap" / "events.jsonl").write_text("".join(json.dumps(event) + "\n" for event in events))
    known = (False, 0.01, 0.01, 0.001, np.full(3, 1e-3), 0.01 * np.eye(3), 0.01 * np.eye(3))
    rows = [Uncertainty(100_000_000 * i, "LIU", *known) for i in range(2500)]
    (tmp_path / "semmap" / "uncertainty.csv").write_text(uncertainty_csv(rows))
    return tmp_path / "semmap"


def test_what_a_run_said_of_itself_is_told_in_the_map(run: Path) -> None:
    (change,) = boundaries(run, drive_of())
    assert (change.before, change.after, change.seconds) == ("LIO", "LIU", 1.0)
    assert change.x == pytest.approx(11.79)
    assert_allclose(list(axis_errors_deg(run, drive_of())), [0.0, np.degrees(np.arccos(0.8))], atol=1e-4)


def test_the_figures_are_drawn(run: Path) -> None:
    drive_of(np.array([0.0, 0.0, 1.0])).save_tum(run.parent / "peer.tum")
    figures(run.parent, drive_of(), {"peer": run.parent / "peer.tum"})
    for name in ("tracks.png", "variances.png"):
        assert (run.parent / name).read_bytes().startswith(b"\x89PNG")


def test_the_faults_are_those_of_the_paper_and_leave_the_others_as_they_are() -> None:
    assert FAULTS["none"] == SensorFaults()
    for name, faults in FAULTS.items():
        assert len(faults.model_dump(exclude_unset=True)) == {"none": 0, "slip": 2}.get(name, 1)


def test_systems_are_known_by_name() -> None:
    assert known_systems("semmap,semmap-without-both,dlio,rko-lio:mine")[:2] == ["semmap", "semmap without both"]
    with pytest.raises(SettingsError, match="semmap-without-wheel"):
        known_systems("semmap-without-wheels")


def test_the_tables_tell_means_growth_and_failures() -> None:
    truth = drive_of()
    near, far = (accuracy(drive_of(np.array([0.0, y, 0.0])), truth) for y in (0.1, 0.3))
    drives = [
        Drive("semmap", 1, "none", accuracy=near),
        Drive("semmap", 2, "none", accuracy=far),
        Drive("semmap", 1, "dead", accuracy=replace(near, avg_err=0.15)),
        Drive("semmap", 2, "dead", failure="never found its place in the map"),
        Drive("dlio", 1, "none", accuracy=replace(far, avg_err=2.0)),
        Drive("kiss-icp", 1, "none", failure="exit 1: no module"),
    ]
    text = [list(column.cells) for column in errors_table(drives).columns]
    assert text[1] == ["2 of 2", "1 of 1", "0"]
    assert text[2] == ["0.200", "2.000", "–"]
    assert list(fault_table(drives).columns[3].cells) == ["1.50"]
    assert verdicts(drives) == ["dlio: 10.0 times the full system's"]
    assert next(iter(OURS)) == "semmap"


@pytest.mark.parametrize("seed", range(3))
def test_mountings_are_put_off_by_what_is_said(seed: int) -> None:
    rig, off = coal_rig(), put_off(coal_rig(), seed)
    for true, moved in ((rig.lidar.T_imu_lidar, off.lidar.T_imu_lidar), (rig.wheel.T_imu_wheel, off.wheel.T_imu_wheel)):
        assert np.linalg.norm(moved[:3, 3] - true[:3, 3]) == pytest.approx(OFF_M)
        assert np.degrees(np.linalg.norm(so3_log(true[:3, :3].T @ moved[:3, :3]))) == pytest.approx(OFF_DEG)
    assert np.linalg.norm(np.subtract(off.uwb.p_imu_tag, rig.uwb.p_imu_tag)) == pytest.approx(OFF_M)
    assert off.uwb.anchors == rig.uwb.anchors
