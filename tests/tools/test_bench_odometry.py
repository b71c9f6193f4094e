"""The odometry benchmark: what it feeds, what it counts, and the errors it reports."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from semmap.errors import SettingsError
from semmap.geometry import Array, se3, so3_exp, yaw_rotation
from tools.bench.odometry import known_systems, row_of, trajectory_of
from tools.bench.odometry_cache import RANGE_UNIT, OrganisedScan, Recorded, RecordedWriter
from tools.bench.odometry_errors import consistency, drift_profile, errors, from_first_metre, up_to
from tools.bench.odometry_recordings import PLANS, STILL_S, recorded
from tools.bench.odometry_run import driven, made
from tools.bench.peers import Estimate
from tools.metrics import Pairs


@pytest.fixture(scope="module")
def gallery(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Twelve metres, from rest, through a box of 40 m by 5 m by 3 m with forty smaller ones along its walls."""
    import open3d as o3d

    directory, rng = tmp_path_factory.mktemp("gallery"), np.random.default_rng(5)
    mesh = o3d.geometry.TriangleMesh.create_box(40.0, 5.0, 3.0).translate((-5.0, -2.5, 0.0))
    for number in range(40):
        size = rng.uniform([0.4, 0.3, 0.5], [1.5, 1.0, 3.0])
        y = 2.5 - size[1] if number % 2 else -2.5
        mesh += o3d.geometry.TriangleMesh.create_box(*size).translate((rng.uniform(-5.0, 33.0), y, 0.0))
    o3d.io.write_triangle_mesh(str(directory / "gallery.ply"), mesh)
    (directory / "route.csv").write_text("0,0,0\n20,0.5,0\n")
    return recorded(
        "mesh", directory / "cache", mesh=directory / "gallery.ply", route=directory / "route.csv", metres=12.0,
        seed=3, progress=lambda done, total: None,
    )  # fmt: skip


def test_a_recording_holds_what_was_asked(gallery: Recorded) -> None:
    stamps, poses = gallery.truth()
    flown = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum()
    assert flown == pytest.approx(12.0, abs=0.5)
    still = stamps <= stamps[0] + (STILL_S - 0.5) * 1e9
    np.testing.assert_allclose(np.ptp(poses[still, :3, 3], axis=0), 0.0, atol=1e-3)
    np.testing.assert_array_equal(np.diff(gallery.stamps_ns), 100_000_000)
    np.testing.assert_array_equal(np.diff(gallery.imu_ns), 5_000_000)


def test_every_scan_comes_after_the_imu_that_covers_it(gallery: Recorded) -> None:
    handed = 0
    for rows, scan in gallery.in_order():
        assert rows.start == handed
        assert gallery.imu_ns[rows.stop - 2] < scan.end_ns <= gallery.imu_ns[rows.stop - 1]
        handed = rows.stop
    assert handed > len(gallery.imu_ns) - 25


def test_points_lie_in_the_gallery_and_mostly_on_its_walls(gallery: Recorded) -> None:
    scan = next(gallery.scans())
    points, offsets_ns, beam = scan.returns()
    _, poses = gallery.truth()
    R, p = poses[0, :3, :3], poses[0, :3, 3]
    beside = np.abs((points + gallery.T_imu_lidar[:3, 3]) @ R.T + p - [15.0, 0.0, 1.5]) - [20.0, 2.5, 1.5]
    assert beside.max() < 0.1
    assert 0.5 < np.mean(beside.max(axis=1) > -0.1) < 1.0
    assert beam.max() == 15
    assert 0 <= offsets_ns.min() < offsets_ns.max() < 100_000_000
    assert np.count_nonzero(scan.cloud().any(axis=2)) == len(points)


def test_the_same_recording_is_simulated_once(gallery: Recorded) -> None:
    before = (gallery.directory / "ranges.u16").stat().st_mtime_ns
    again = recorded(
        "mesh", gallery.directory.parent, mesh=gallery.directory.parents[1] / "gallery.ply",
        route=gallery.directory.parents[1] / "route.csv", metres=12.0, seed=3, progress=lambda done, total: None,
    )  # fmt: skip
    assert again.directory == gallery.directory
    assert (gallery.directory / "ranges.u16").stat().st_mtime_ns == before


def test_our_odometry_holds_in_the_gallery(gallery: Recorded, tmp_path: Path) -> None:
    row = row_of("semmap", dict(driven(made("semmap", gallery), gallery)), gallery, tmp_path / "semmap.tum")
    assert row.whole is not None
    assert row.consistency is not None
    assert row.scans == len(gallery.stamps_ns)
    assert row.whole.poses > 0.95 * row.scans
    assert row.whole.ape_rmse < 0.1
    assert 0.0 < row.start_memory_mb <= row.memory_mb
    assert (tmp_path / "semmap.tum").is_file()


@pytest.mark.parametrize("system", ["rko-lio:mine", "genz-lio:mine", "dlio:mine", "kiss-icp:mine"])
def test_a_peer_is_fed_rightly(gallery: Recorded, tmp_path: Path, system: str) -> None:
    pytest.importorskip({"rko": "rko_lio", "gen": "genz_lio"}.get(system[:3], "evalio"), reason="needs the extra bench")
    row = row_of(system, dict(driven(made(system, gallery), gallery)), gallery, tmp_path / "peer.tum")
    assert row.whole is not None
    assert row.whole.poses > 0.95 * row.scans
    assert row.whole.ape_rmse < 0.5  # wrong units, times or extrinsics throw them metres off


def test_ranges_are_kept_to_a_millimetre(tmp_path: Path) -> None:
    directions = np.zeros((2, 3, 3), np.float32)
    directions[..., 0] = 1.0
    offsets = np.array([0, 10, 20], np.int64)
    nothing = np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3))
    with RecordedWriter(tmp_path / "r", directions, offsets, {"T_imu_lidar": np.eye(4)[:3].tolist()}) as out:
        out.write(7, np.array([1, 0]), np.array([20, 0]), np.array([12.3456, 0.777]))
        out.finish(nothing, (np.zeros(1, np.int64), np.eye(4)[None]))
    scan = next(Recorded.open(tmp_path / "r").scans())
    np.testing.assert_allclose(scan.ranges, [[0.777, 0, 0], [0, 0, 12.3456]], atol=0.5 * RANGE_UNIT + 1e-6)
    points, times, beams = scan.returns()
    assert (times.tolist(), beams.tolist(), scan.end_ns) == ([0, 20], [0, 1], 27)
    assert points.shape == (2, 3)


def test_a_recording_that_breaks_off_leaves_nothing(tmp_path: Path) -> None:
    with (
        pytest.raises(RuntimeError, match="stop"),
        RecordedWriter(tmp_path / "r", np.zeros((1, 1, 3), np.float32), np.zeros(1, np.int64), {}),
    ):
        raise RuntimeError("stop")
    assert not list(tmp_path.iterdir())


class Listener:
    """A system that only listens."""

    def __init__(self) -> None:
        self.heard: list[str] = []

    def imu(self, stamp_ns: int, gyro: Array, accel: Array) -> None:
        self.heard.append("imu")

    def prepare(self, scan: OrganisedScan) -> int:
        return scan.end_ns

    def scan(self, prepared: int) -> None:
        self.heard.append("scan")

    def estimates(self) -> list[Estimate]:
        return [Estimate(len(self.heard), np.eye(4))]


def test_what_is_timed(gallery: Recorded) -> None:
    system = Listener()
    result = driven(system, gallery)
    scans = system.heard.count("scan")
    assert len(result["scan_ms"]) == len(result["imu_ms"]) == len(result["cpu_ms"]) == len(result["poses"]) == scans
    assert system.heard[:22] == ["imu"] * 21 + ["scan"]
    assert result["covariances"].size == 0
    assert result["memory_mb"][1] >= result["memory_mb"][0] > 0.0


def walked(n: int = 600, step: float = 0.2) -> Pairs:
    """A true walk round a wide bend, the estimate the same in another frame."""
    turn = yaw_rotation(0.0)[None] @ so3_exp(np.column_stack([np.zeros((n, 2)), 0.004 * np.arange(n)]))
    position = np.cumsum(step * turn[:, :, 0], axis=0) + [5e5, 4e6, 300.0]
    truth = se3(turn, position)
    return Pairs(100 * np.arange(n), se3(so3_exp([0.1, -0.2, 1.0]), [3.0, 4.0, 5.0]) @ truth, truth)


def test_another_frame_is_no_error() -> None:
    e = errors(walked())
    for value in (e.ape_max, e.drift_rmse, e.drift_end, e.start_m, e.percent_10m, e.percent_100m):
        assert value == pytest.approx(0.0, abs=1e-6)
    assert max(e.attitude_rmse, e.tilt_end, abs(e.yaw_end), e.start_deg) < 1e-4
    assert e.metres == pytest.approx(599 * 0.2)


def test_drift_counts_from_the_first_metre_and_the_start_up_to_it() -> None:
    pairs = walked()
    jump = se3(so3_exp([0.0, np.radians(0.8), 0.0]), [0.1, 0.0, 0.0])
    leap = np.where(np.arange(600)[:, None, None] < 3, np.eye(4), jump)
    e = errors(Pairs(pairs.stamps_ns, leap @ np.linalg.inv(pairs.truth[0]) @ pairs.truth, pairs.truth))
    assert e.start_deg == pytest.approx(0.8, abs=1e-3)
    assert e.start_m > 0.09
    assert e.drift_end == pytest.approx(0.0, abs=1e-6)
    assert e.ape_max > 0.05


def test_the_profile_tells_the_direction_of_the_drift() -> None:
    pairs = walked()
    flown = pairs.distance_flown()
    slow = pairs.truth.copy()
    slow[:, 2, 3] += 0.01 * flown
    rows = drift_profile(Pairs(pairs.stamps_ns, slow, pairs.truth), 20.0)
    assert [row["metres"] for row in rows] == pytest.approx([20, 40, 60, 80, 100], abs=1.5)
    assert [row["up"] for row in rows] == pytest.approx([0.01 * (row["metres"] - 1.0) for row in rows], abs=3e-3)
    assert max(abs(row["along"]) + abs(row["left"]) + abs(row["yaw"]) for row in rows) < 1e-6


def test_a_heading_error_is_seen_as_yaw_and_to_the_left() -> None:
    n = 500
    truth = se3(np.tile(np.eye(3), (n, 1, 1)), np.column_stack([0.2 * np.arange(n), np.zeros((n, 2))]))
    heading = np.radians(0.01 * np.maximum(truth[:, 0, 3] - 1.0, 0.0))
    estimate = truth.copy()
    estimate[:, :3, :3] = so3_exp(np.column_stack([np.zeros((n, 2)), heading]))
    estimate[:, 1, 3] = np.cumsum(0.2 * np.sin(heading))
    last = drift_profile(Pairs(np.arange(n), estimate, truth), 45.0)[-1]
    assert last["yaw"] == pytest.approx(0.01 * (last["metres"] - 1.0), abs=5e-3)
    assert last["left"] == pytest.approx(0.5 * np.radians(0.01) * (last["metres"] - 1.0) ** 2, rel=0.02)
    assert abs(last["tilt_x"]) + abs(last["tilt_y"]) < 1e-6


def test_stretches_end_where_they_should() -> None:
    assert up_to(walked(), 50.0).distance_flown()[-1] == pytest.approx(50.0, abs=0.21)
    assert from_first_metre(walked()).position_errors()[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("scale", "inside"), [(1.0, (0.9, 1.0)), (5.0, (0.0, 0.1))])
def test_consistency_knows_honest_from_boastful(scale: float, inside: tuple[float, float]) -> None:
    rng, n = np.random.default_rng(4), 4000
    truth = se3(np.tile(yaw_rotation(0.7), (n, 1, 1)), np.column_stack([np.arange(n), np.arange(n), np.zeros(n)]))
    sigma = np.array([1e-3, 1e-3, 2e-3, 0.3, 0.1, 0.05])
    error = rng.normal(size=(n, 6)) * sigma * scale
    error[0] = 0.0
    estimate = truth.copy()
    estimate[:, :3, :3] = truth[:, :3, :3] @ np.swapaxes(so3_exp(error[:, :3]), 1, 2)
    estimate[:, :3, 3] -= error[:, 3:]
    found = consistency(Pairs(np.arange(n), estimate, truth), np.tile(np.diag(sigma**2), (n, 1, 1)))
    assert found.nees == pytest.approx(scale**2, rel=0.1)
    assert inside[0] <= found.inside <= inside[1]
    assert [found.along, found.across, found.up] == pytest.approx([scale] * 3, rel=0.1)
    assert found.sigma_along == pytest.approx(np.hypot(0.3 * np.cos(0.7), 0.1 * np.sin(0.7)), rel=1e-6)


def test_a_run_that_diverges_ends_there() -> None:
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[2, 0, 3] = np.nan
    trajectory, covariances = trajectory_of(
        {"stamps_ns": np.array([1, 1, 2, 3]), "poses": poses, "covariances": np.zeros(0)}
    )
    assert trajectory.stamps_ns.tolist() == [1]
    assert covariances is None


def test_an_unknown_system_is_named() -> None:
    assert known_systems("semmap,dlio,rko-lio:mine") == ["semmap", "dlio", "rko-lio:mine"]
    assert known_systems("semmap:voxel_size=0.45+gate=3") == ["semmap:voxel_size=0.45+gate=3"]
    with pytest.raises(SettingsError, match="voxel_size"):
        known_systems("semmap:voxel_sise=0.45")
    with pytest.raises(SettingsError, match="rko-lia"):
        known_systems("rko-lia")


@pytest.mark.parametrize(("name", "length"), [("rough", 2000.0), ("tunnel", 280.0)])
def test_the_mines_are_as_long_as_they_say(name: str, length: float) -> None:
    plan = PLANS[name]
    assert plan.mine is not None
    floor = plan.mine(2).route_floor()
    assert np.linalg.norm(np.diff(floor, axis=0), axis=1).sum() == pytest.approx(length, rel=0.08)
