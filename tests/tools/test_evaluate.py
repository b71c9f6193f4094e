"""Evaluation: errors that are known by construction come out as the figures say."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from semmap.errors import InputFileError, TrajectoryError
from semmap.geometry import se3, so3_exp
from semmap.trajectory import Trajectory
from tools import metrics
from tools.evaluate import coverage_line, evaluate_run, evaluation_table, read_check_points


def flight(n: int = 601, *, frame: str = "map", start_s: float = 1000.0) -> Trajectory:
    """A minute along a gentle helix at 10 Hz: 2 m/s, attitude along the track."""
    t = np.arange(n) * 0.1
    heading = 0.05 * t
    positions = np.stack([40.0 * np.sin(heading), 40.0 * (1 - np.cos(heading)), 0.1 * t], axis=-1)
    R = so3_exp(np.stack([0.0 * t, 0.0 * t, heading], axis=-1))
    return Trajectory(frame, np.int64(start_s * 1e9) + np.int64(1e8) * np.arange(n), se3(R, positions))


def moved(trajectory: Trajectory, T: np.ndarray, *, frame: str | None = None) -> Trajectory:
    return Trajectory(frame or trajectory.frame, trajectory.stamps_ns, T @ trajectory.poses)


def write_run(out: Path, **trajectories: Trajectory) -> Path:
    for name, trajectory in trajectories.items():
        trajectory.save_tum(out / f"{name}.tum")
    return out


def test_a_known_offset_is_the_absolute_error_and_vanishes_after_the_fit(tmp_path: Path) -> None:
    truth = flight()
    shifted = moved(truth, se3(np.eye(3), [0.3, 0.4, 0.0]))
    run = write_run(tmp_path / "run", trajectory=shifted)
    truth.save_tum(tmp_path / "truth.tum")
    row = evaluate_run(run, tmp_path / "truth.tum")["trajectories"]["trajectory"]
    assert row["absolute"]["position_m"] == pytest.approx(
        dict.fromkeys(("max", "rmse", "mean", "median", "p95"), 0.5), abs=1e-5
    )
    assert row["absolute"]["rotation_deg"]["max"] == pytest.approx(0.0, abs=1e-4)
    assert row["aligned"]["position_m"]["max"] == pytest.approx(0.0, abs=1e-5)
    assert json.loads((run / "evaluation.json").read_text())["trajectories"]["trajectory"] == row


def test_odometry_in_its_own_frame_has_no_absolute_error(tmp_path: Path) -> None:
    truth = flight()
    T = se3(so3_exp([0.0, 0.0, 2.0]), [100.0, -30.0, 5.0])
    run = write_run(tmp_path / "run", odometry=moved(truth, T, frame="odom"))
    truth.save_tum(tmp_path / "truth.tum")
    row = evaluate_run(run, tmp_path / "truth.tum")["trajectories"]["odometry"]
    assert "absolute" not in row
    assert row["from_start"]["position_m"]["max"] == pytest.approx(0.0, abs=1e-4)
    assert row["aligned"]["position_m"]["max"] == pytest.approx(0.0, abs=1e-4)


def test_truth_is_interpolated_at_the_estimates_stamps() -> None:
    truth = flight()
    line = Trajectory("map", truth.stamps_ns[::10], truth.poses[::10])
    pairs = metrics.associate(flight(), line)
    assert len(pairs) == 601
    assert pairs.position_errors().max() < 40.0 * (1.0 - np.cos(0.025)) * 1.01  # the sagitta of one second's chord


def test_stamps_outside_the_truth_or_in_its_gaps_are_left_out() -> None:
    truth = flight()
    keep = np.r_[0:100, 200:601]
    pairs = metrics.associate(flight(700), Trajectory("map", truth.stamps_ns[keep], truth.poses[keep]))
    assert len(pairs) == 501


def test_trajectories_that_do_not_overlap_are_an_error(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", trajectory=flight(start_s=5000.0))
    flight().save_tum(tmp_path / "truth.tum")
    with pytest.raises(TrajectoryError, match="does not overlap"):
        evaluate_run(run, tmp_path / "truth.tum")
    assert not (run / "evaluation.json").exists()


def test_alignment_recovers_a_rigid_motion_and_never_mirrors() -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(50, 3)) * [10.0, 8.0, 0.01]
    T = se3(so3_exp([0.3, -0.2, 2.5]), [400.0, -20.0, 3.0])
    found = metrics.alignment(points, points @ T[:3, :3].T + T[:3, 3])
    np.testing.assert_allclose(found, T, atol=1e-9)
    mirrored = metrics.alignment(points, points * [1.0, 1.0, -1.0])
    assert np.linalg.det(mirrored[:3, :3]) == pytest.approx(1.0)


def test_relative_error_of_a_scaled_straight_flight_is_the_scale() -> None:
    stamps = np.int64(1e8) * np.arange(491)
    truth = se3(np.eye(3), np.outer(np.arange(491) * 0.2, [1.0, 0.0, 0.0]))
    estimate = se3(np.eye(3), truth[:, :3, 3] * 1.02)
    rows = metrics.relative_errors(metrics.Pairs(stamps, estimate, truth))
    assert [row["length_m"] for row in rows] == [5.0, 10.0, 25.0, 50.0]  # the flight is shorter than 100 m
    for row in rows:
        assert row["translation_percent"] == pytest.approx(2.0, rel=0.05)
        assert row["rotation_deg_per_100m"] == 0.0


def test_rep_is_the_drift_quotient_of_the_first_parts() -> None:
    stamps = np.int64(1e8) * np.arange(501)
    truth = se3(np.eye(3), np.outer(np.arange(501) * 0.2, [1.0, 0.0, 0.0]))
    estimate = se3(np.eye(3), truth[:, :3, 3] * 1.02)
    assert metrics.rep(metrics.Pairs(stamps, estimate, truth)) == pytest.approx([2.0] * 5)
    assert metrics.rep(metrics.Pairs(stamps[:3], estimate[:3], truth[:3])) == []


def test_realtime_coverage_counts_scans_and_the_first_fix(tmp_path: Path) -> None:
    truth = flight()
    realtime = Trajectory("map", truth.stamps_ns[150:], truth.poses[150:])
    run = write_run(tmp_path / "run", trajectory=truth, realtime=realtime, odometry=truth)
    truth.save_tum(tmp_path / "truth.tum")
    evaluation = evaluate_run(run, tmp_path / "truth.tum")
    assert evaluation["realtime"]["first_fix_s"] == pytest.approx(15.0)
    assert evaluation["realtime"]["scans_covered_percent"] == pytest.approx(100.0 * 451 / 601)
    assert "first after 15.0 s" in coverage_line(evaluation)
    assert evaluation_table(evaluation).row_count == 6  # three trajectories, as they are and fitted


def test_a_run_without_a_map_pose_is_evaluated_and_says_so(tmp_path: Path) -> None:
    truth = flight()
    nothing = Trajectory("map", np.empty(0, np.int64), np.empty((0, 4, 4)))
    odometry = Trajectory("odom", truth.stamps_ns, truth.poses)
    run = write_run(tmp_path / "run", trajectory=nothing, realtime=nothing, odometry=odometry)
    truth.save_tum(tmp_path / "truth.tum")
    evaluation = evaluate_run(run, tmp_path / "truth.tum")
    assert evaluation["trajectories"]["trajectory"] == {"frame": "map", "poses": 0, "compared": 0}
    assert evaluation["realtime"] == {"scans_covered_percent": 0.0, "first_fix_s": None}
    assert "never knew" in coverage_line(evaluation)


def test_check_points_give_the_mean_and_the_sum(tmp_path: Path) -> None:
    truth = flight()
    run = write_run(tmp_path / "run", trajectory=moved(truth, se3(np.eye(3), [0.0, 0.0, 0.2])))
    rows = [f"{1000 + i * 10 + 0.05},{p[0]},{p[1]},{p[2]},P{i}" for i, p in enumerate(truth.positions[:400:100])]
    (tmp_path / "points.csv").write_text("time,x,y,z,name\n" + "\n".join([*rows, "9999,0,0,0,late"]) + "\n")
    points = evaluate_run(run, tmp_path / "points.csv")["trajectories"]["trajectory"]["check_points"]
    along = 2.0 * 0.05  # the estimate is taken 0.05 s later on the track, at 2 m/s and 0.1 m/s up
    expected = float(np.hypot(along, 0.2 + 0.005))
    assert points["errors"]["late"] is None
    assert points["compared"] == 4
    assert points["AvgErr"] == pytest.approx(expected, rel=0.01)
    assert points["TotalErr"] == pytest.approx(4 * expected, rel=0.01)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x,y,z\n1,2,3\n", "line 2"),
        ("time,x,y,z\n1,2,3,4\nfive,2,3,4\n", "line 3"),
        ("time,x,y,z\n1,2,,4\n", "line 2"),
        ("time,x,y,z\n", "no finite check points"),
        ("", "no finite check points"),
        ("time,x,y,z\n1,nan,2,3\n", "no finite check points"),
    ],
)
def test_a_bad_check_point_file_names_its_line(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "points.csv"
    file.write_text(text)
    with pytest.raises(TrajectoryError, match=message):
        read_check_points(file)


def test_a_directory_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="semmap localize"):
        evaluate_run(tmp_path, tmp_path / "truth.tum")


@pytest.mark.skipif(shutil.which("evo_ape") is None, reason="evo is not installed")
def test_the_figures_agree_with_evo(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    truth = flight()
    noisy = truth.poses @ se3(so3_exp(rng.normal(0, 0.02, (601, 3))), rng.normal(0, 0.3, (601, 3)))
    estimate = moved(Trajectory("map", truth.stamps_ns, noisy), se3(so3_exp([0.0, 0.0, 0.4]), [3.0, 1.0, 0.0]))
    run = write_run(tmp_path / "run", trajectory=estimate)
    truth.save_tum(tmp_path / "truth.tum")
    row = evaluate_run(run, tmp_path / "truth.tum")["trajectories"]["trajectory"]
    for options, ours in (([], row["absolute"]), (["--align"], row["aligned"])):
        command = ["evo_ape", "tum", str(tmp_path / "truth.tum"), str(run / "trajectory.tum"), *options]
        out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        theirs = {row[0]: float(row[1]) for row in map(str.split, out.splitlines()) if row[:1] in (["rmse"], ["max"])}
        assert ours["position_m"]["rmse"] == pytest.approx(theirs["rmse"], abs=2e-4)
        assert ours["position_m"]["max"] == pytest.approx(theirs["max"], abs=2e-3)
