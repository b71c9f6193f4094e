"""`simulate`: the files are whole, read back as what was simulated, and an error leaves none behind."""

from __future__ import annotations

import csv
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import pytest
from numpy.testing import assert_allclose

from maps.prior_map import read_prior_map
from semmap.errors import InputFileError, SemmapError
from semmap.geometry import interpolate_poses
from semmap.measurements import ImuSample, PrismFix, Scan, UwbRange, WheelSpeed
from semmap.recordings import read_recording
from semmap.rig import Rig
from semmap.trajectory import Trajectory
from tools import cli
from tools.evaluate import read_check_points
from tools.metrics import point_errors
from tools.simulator import (
    SimulationSettings,
    default_rig,
    fly,
    load_mesh,
    load_route,
    scenario,
    simulate,
    simulate_measurements,
    with_total_station,
    with_uwb,
)
from tools.simulator.rigs import save_rig

SHORT = SimulationSettings(start_s=1.0, duration_s=3.0, map={"spacing": 0.4})
FAR = np.array([500_000.0, 4_000_000.0, 200.0])


@pytest.fixture
def hall(tmp_path: Path) -> tuple[Path, Path]:
    """A mesh file far from the origin and a route file through it."""
    mesh = o3d.geometry.TriangleMesh.create_box(40.0, 12.0, 4.0).translate(FAR)
    o3d.io.write_triangle_mesh(str(tmp_path / "hall.ply"), mesh)
    rows = FAR + np.array([[4.0, 6.0, 0.0], [20.0, 4.0, 0.0], [36.0, 6.0, 0.0]])
    lines = ["x_m,y_m,z_floor_m", *(",".join(f"{value:.3f}" for value in row) for row in rows)]
    (tmp_path / "route.csv").write_text("\n".join(lines))
    return tmp_path / "hall.ply", tmp_path / "route.csv"


def test_a_built_in_mine_gives_all_files(tmp_path: Path) -> None:
    reports: list[tuple[int, int]] = []
    out = tmp_path / "new" / "sim"
    done = simulate("drift", out=out, seed=2, settings=SHORT, progress=lambda *report: reports.append(report))
    names = {"prior_map.laz", "recording", "rig.yaml", "ground_truth.tum", "check_points.csv", "junctions.csv"}
    assert {path.name for path in out.iterdir()} == names
    assert [path.name for path in out.parent.iterdir()] == ["sim"]
    assert done.scans == 30 and done.junctions == 2 and done.duration_s == pytest.approx(3.0)
    assert reports[-1] == (100, 100)
    assert all(a <= b for (a, _), (b, _) in pairwise(reports))
    with (out / "junctions.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    assert list(rows[0]) == ["id", "x_m", "y_m", "branches", "bearings_deg", "z_m"]
    assert [int(row["branches"]) for row in rows] == [len(row["bearings_deg"].split(";")) for row in rows]


def test_the_files_read_back_as_what_was_simulated(tmp_path: Path) -> None:
    simulate("drift", out=tmp_path / "sim", seed=2, settings=SHORT)
    flight = fly(scenario("drift", 2), settings=SHORT, seed=2)
    rig = Rig.from_yaml(tmp_path / "sim" / "rig.yaml")
    assert rig == default_rig() and rig.model_fields_set == default_rig().model_fields_set
    ours = list(simulate_measurements(flight))
    read = list(read_recording(tmp_path / "sim" / "recording", rig))
    for kind in (ImuSample, WheelSpeed, Scan):
        a, b = ([m for m in stream if isinstance(m, kind)] for stream in (ours, read))
        assert [m.stamp_ns for m in a] == [m.stamp_ns for m in b]
    scan, back = next(m for m in ours if isinstance(m, Scan)), next(m for m in read if isinstance(m, Scan))
    assert_allclose(back.points, scan.points)
    assert np.abs(back.offsets_ns - scan.offsets_ns).max() < 100
    truth = Trajectory.load_tum(tmp_path / "sim" / "ground_truth.tum")
    assert truth.frame == "map"
    assert_allclose(truth.poses, flight.truth().poses, atol=1e-6)


def test_check_points_read_back_as_places_on_the_true_way(tmp_path: Path) -> None:
    simulate("drift", out=tmp_path / "sim", seed=2, settings=SHORT)
    points = read_check_points(tmp_path / "sim" / "check_points.csv")
    truth = Trajectory.load_tum(tmp_path / "sim" / "ground_truth.tum")
    assert_allclose(point_errors(truth, points.stamps_ns, points.points), np.zeros(15), atol=1e-4)


def test_the_same_seed_writes_the_same_bytes_over_the_old_ones(tmp_path: Path) -> None:
    def contents(path: Path) -> dict[str, bytes]:
        return {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}

    simulate("drift", out=tmp_path / "a", seed=3, settings=SHORT)
    first = contents(tmp_path / "a")
    simulate("drift", out=tmp_path / "a", seed=3, settings=SHORT)
    assert contents(tmp_path / "a") == first
    assert len(first) == 7


def test_a_mesh_gives_everything_but_junctions(tmp_path: Path, hall: tuple[Path, Path]) -> None:
    mesh, route = hall
    out = tmp_path / "sim"
    out.mkdir()
    (out / "junctions.csv").write_text("of an older simulation")
    (out / "mine.txt").write_text("keep me")
    done = simulate(mesh, out=out, route=route, settings=SHORT)
    assert done.junctions is None
    assert not (out / "junctions.csv").exists()
    assert (out / "mine.txt").read_text() == "keep me"
    points = read_prior_map(out / "prior_map.laz")
    cloud = points.points + points.origin
    assert_allclose(cloud.min(axis=0), FAR, atol=0.1)
    assert_allclose(cloud.max(axis=0), FAR + [40.0, 12.0, 4.0], atol=0.1)


def test_a_rig_of_one_s_own(tmp_path: Path, hall: tuple[Path, Path]) -> None:
    mesh, route = hall
    mine = load_mesh(mesh)
    rig = with_uwb(default_rig().without("lidar"), mine, load_route(route)[1] + [0.0, 0.0, 2.0], max_range=60.0)
    simulate(mesh, out=tmp_path / "sim", route=route, rig=rig, settings=SHORT)
    back = Rig.from_yaml(tmp_path / "sim" / "rig.yaml")
    assert back == rig
    stream = list(read_recording(tmp_path / "sim" / "recording", back))
    assert {m.anchor for m in stream if isinstance(m, UwbRange)} == set(rig.uwb.anchors)
    assert not any(isinstance(m, Scan) for m in stream)


def test_a_rig_file_with_beacons_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mine = scenario("drift", 0)
    axis = mine.scenario.route_floor() + [0.0, 0.0, 1.6]
    rig = with_total_station(with_uwb(default_rig().without("lidar"), mine, axis[15], max_range=40.0), axis[6])
    save_rig(tmp_path / "beacons.yaml", rig)
    settings = "simulate: {duration_s: 20.0, map: {spacing: 0.5}, faults: {uwb_outlier_rate: 0}}"
    (tmp_path / "config.yaml").write_text(settings)
    options = ["--rig", str(tmp_path / "beacons.yaml"), "--config", str(tmp_path / "config.yaml")]
    assert cli.run(["simulate", "drift", *options, "--out", str(tmp_path / "sim")]) == 0
    assert "junctions" not in capsys.readouterr().out

    back = Rig.from_yaml(tmp_path / "sim" / "rig.yaml")
    stream = list(read_recording(tmp_path / "sim" / "recording", back))
    truth = Trajectory.load_tum(tmp_path / "sim" / "ground_truth.tum")
    fixes, ranges = ([m for m in stream if isinstance(m, kind)] for kind in (PrismFix, UwbRange))
    assert len(fixes) > 50 and len(ranges) > 200
    prism = points_of_the_body(truth, fixes, back.total_station.p_imu_prism)
    assert np.std(prism - [fix.p_map for fix in fixes], axis=0).max() < 1.2 * back.total_station.point_std
    assert_allclose(prism, [fix.p_map for fix in fixes], atol=0.02)
    tag = points_of_the_body(truth, ranges, back.uwb.p_imu_tag)
    anchors = np.array([back.uwb.anchors[reading.anchor] for reading in ranges])
    true = np.linalg.norm(tag - anchors, axis=1)
    error = np.array([reading.distance for reading in ranges]) - true
    seen = np.isinf(mine.raycaster.free_way(tag, anchors))
    assert seen.sum() > 200
    assert abs(error[seen].mean()) < 0.02
    assert error[seen].std() == pytest.approx(back.uwb.range_std, rel=0.2)


def points_of_the_body(truth: Trajectory, at: list[Any], p_imu: tuple[float, ...]) -> np.ndarray:
    """Where a point fixed to the body truly is when measurements are made, map frame."""
    poses = interpolate_poses(truth.stamps_ns, truth.poses, np.array([measurement.stamp_ns for measurement in at]))
    return poses[:, :3, :3] @ np.array(p_imu) + poses[:, :3, 3]


def test_the_command_line_says_what_a_mesh_does_not_give(
    tmp_path: Path, hall: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    mesh, route = hall
    (tmp_path / "config.yaml").write_text("simulate: {duration_s: 3.0, map: {spacing: 0.5}}")
    route.write_text("\n".join(line.replace("200.000", "197.5") for line in route.read_text().splitlines()))
    args = ["simulate", str(mesh), "--route", str(route), "--config", str(tmp_path / "config.yaml")]
    assert cli.run([*args, "--out", str(tmp_path / "sim")]) == 0
    said = capsys.readouterr().out
    assert "moved up to 2.5 m" in said and "no junctions.csv" in said and said.count("\n") == 1
    assert cli.run([*args, "--rig", str(tmp_path / "gone.yaml"), "--out", str(tmp_path / "other")]) == 2
    assert "gone.yaml" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


def test_what_a_rig_says_of_other_point_times_does_not_count_here(tmp_path: Path, hall: tuple[Path, Path]) -> None:
    mesh, route = hall
    block = default_rig().lidar.model_copy(update={"time_field": "t", "time_unit": "ns", "range_std": 0.03})
    settings = SHORT.model_copy(update={"duration_s": 0.5})
    rig = default_rig().model_copy(update={"lidar": block})
    simulate(mesh, out=tmp_path / "sim", route=route, rig=rig, settings=settings)
    back = Rig.from_yaml(tmp_path / "sim" / "rig.yaml")
    assert back.lidar == default_rig().lidar.model_copy(update={"range_std": 0.03})
    scan = next(m for m in read_recording(tmp_path / "sim" / "recording", back) if isinstance(m, Scan))
    assert 0.09e9 < scan.offsets_ns.max() <= 0.1e9


def test_bad_input_leaves_nothing_behind(tmp_path: Path, hall: tuple[Path, Path]) -> None:
    mesh, route = hall
    (tmp_path / "broken.ply").write_text("no mesh")
    (tmp_path / "away.csv").write_text("0,0,0\n10,0,0\n")
    (tmp_path / "short.csv").write_text("0,0,0\n")
    before = set(tmp_path.iterdir())
    for source, way in (
        ("demmo", None),
        (tmp_path / "gone.ply", route),
        (tmp_path / "broken.ply", route),
        (mesh, None),
        (mesh, tmp_path / "away.csv"),
        (mesh, tmp_path / "short.csv"),
        (mesh, tmp_path / "gone.csv"),
    ):
        with pytest.raises(SemmapError):
            simulate(source, out=tmp_path / "sim", route=way, settings=SHORT)
    assert set(tmp_path.iterdir()) == before


def test_an_error_half_way_leaves_the_older_files(
    tmp_path: Path, hall: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh, route = hall
    (tmp_path / "sim").mkdir()
    (tmp_path / "sim" / "rig.yaml").write_text("old")

    def full_disk(*_: object, **__: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr("tools.simulator.record.save_laz", full_disk)
    with pytest.raises(OSError, match="no space"):
        simulate(mesh, out=tmp_path / "sim", route=route, settings=SHORT)
    assert (tmp_path / "sim" / "rig.yaml").read_text() == "old"
    assert {path.name for path in tmp_path.iterdir()} == {"hall.ply", "route.csv", "sim"}


def test_what_is_in_the_way_is_not_removed(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("a file")
    with pytest.raises(InputFileError, match="is a file"):
        simulate("demo", out=tmp_path / "file")
    (tmp_path / "dir" / "recording").mkdir(parents=True)
    (tmp_path / "dir" / "recording" / "diary.txt").write_text("mine")
    with pytest.raises(InputFileError, match="is not a recording"):
        simulate("demo", out=tmp_path / "dir")
    assert (tmp_path / "dir" / "recording" / "diary.txt").read_text() == "mine"


def test_a_rig_file_holds_what_was_set(tmp_path: Path) -> None:
    save_rig(tmp_path / "rig.yaml", default_rig())
    text = (tmp_path / "rig.yaml").read_text()
    assert "uwb" not in text and "accel_unit" not in text and "q_imu_lidar_xyzw" not in text
    assert Rig.from_yaml(tmp_path / "rig.yaml") == default_rig()
