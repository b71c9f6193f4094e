"""The sensors: without faults they say exactly what is so, with faults what was asked for."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from semmap.errors import InputFileError, SettingsError
from semmap.geometry import interpolate_poses, quaternion_xyzw, so3_exp, transform
from semmap.measurements import ImuSample, Measurement, PrismFix, Scan, UwbRange, WheelSpeed
from semmap.recordings import read_recording
from semmap.rig import Rig
from semmap.trajectory import Trajectory
from tools.simulator import (
    Flight,
    Mine,
    MotionSettings,
    SensorFaults,
    SimulationSettings,
    default_rig,
    fly,
    load_mesh,
    scenario,
    simulate_measurements,
    with_total_station,
    with_uwb,
    with_uwb_along,
)
from tools.simulator.imu import imu_errors
from tools.simulator.lidar import beam_directions, measured_ranges
from tools.simulator.measurements import arrival_ns
from tools.simulator.raycaster import Hits
from tools.simulator.wheel import slip_excess, true_wheel_speed

EDGAR = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "edgar_mine"
LOW, HIGH = np.array([-30.0, -15.0, 0.0]), np.array([30.0, 15.0, 5.0])
ROUTE = np.array([[-20.0, -8.0, 0.0], [15.0, -8.0, 0.0], [20.0, 8.0, 0.0], [-20.0, 8.0, 0.0]])
PERFECT = SensorFaults.none()


def box(low: np.ndarray, high: np.ndarray) -> o3d.geometry.TriangleMesh:
    return o3d.geometry.TriangleMesh.create_box(*(high - low)).translate(low)


@cache
def hall(*, wall: bool = False) -> Mine:
    """A box-shaped hall with known planes, with or without a wall along part of its middle."""
    mesh = box(LOW, HIGH)
    if wall:
        mesh += box(np.array([-28.0, -1.0, 0.0]), np.array([12.0, 1.0, 5.0]))
    return Mine("hall", np.asarray(mesh.vertices), np.asarray(mesh.triangles), np.zeros(3))


def tilted_rig() -> Rig:
    """The default rig with its LiDAR off the centre and on a slant."""
    q = tuple(quaternion_xyzw(so3_exp([0.1, 0.2, 0.7])[None])[0])
    rig = default_rig()
    lidar = rig.lidar.model_copy(update={"q_imu_lidar_xyzw": q, "p_imu_lidar": (0.2, -0.1, 0.3), "columns": 360})
    return rig.model_copy(update={"lidar": lidar})


def flight(
    rig: Rig | None = None, faults: SensorFaults = PERFECT, *, mine: Mine | None = None, seed: int = 0, **more: float
) -> Flight:
    settings = SimulationSettings(
        motion=MotionSettings(wobble_deg=3.0), faults=faults, **{"start_s": 6.0, "duration_s": 4.0, **more}
    )
    return fly(mine or hall(), ROUTE, rig, settings=settings, seed=seed)


def of_type(kind: type, measurements: Iterable[Measurement]) -> list:
    return [m for m in measurements if isinstance(m, kind)]


def on_the_walls(points: np.ndarray) -> np.ndarray:
    """Distance of points from the nearest plane of the hall."""
    return np.abs(np.concatenate([points - LOW, points - HIGH], axis=1)).min(axis=1)


def test_points_lie_on_the_walls_when_each_is_placed_by_its_own_time() -> None:
    rig = tilted_rig()
    one = flight(rig)
    scans = of_type(Scan, simulate_measurements(one))
    assert len(scans) == 40
    scan = scans[20]
    poses = one.motion(one.times(scan.stamp_ns + scan.offsets_ns)).poses() @ rig.lidar.T_imu_lidar
    placed = np.einsum("nij,nj->ni", poses[:, :3, :3], scan.points.astype(float)) + poses[:, :3, 3]
    assert on_the_walls(placed).max() < 1e-3
    frozen = transform(poses[0], scan.points)
    assert np.quantile(on_the_walls(frozen), 0.9) > 0.05


def test_a_scan_starts_at_its_stamp_and_turns_clockwise_once() -> None:
    scan = of_type(Scan, simulate_measurements(flight()))[0]
    assert scan.offsets_ns.min() >= 0 and scan.offsets_ns.max() < 100_000_000
    assert (np.diff(scan.offsets_ns) >= 0).all()
    assert set(np.unique(scan.ring)) == set(range(16))
    azimuth = np.arctan2(scan.points[:, 1], scan.points[:, 0])[scan.ring == 8]
    assert (np.diff(np.unwrap(azimuth)) < 0.0).all()
    elevation = np.degrees(np.arcsin(scan.points[:, 2] / np.linalg.norm(scan.points, axis=1)))
    assert_allclose(elevation, np.linspace(-15.0, 15.0, 16)[scan.ring], atol=1e-3)


def test_range_noise_dropouts_and_reach() -> None:
    block = default_rig().lidar
    n = 200_000
    hits = Hits(np.full(n, 20.0, np.float32), np.ones(n, np.float32))
    faults = PERFECT.model_copy(update={"noise": 1.0, "lidar_dropout": 0.03})
    ranges, kept = measured_ranges(hits, block, faults, np.random.default_rng(0))
    assert np.std(ranges) == pytest.approx(block.range_std, rel=0.01)
    assert 1.0 - kept.mean() == pytest.approx(0.03, abs=0.003)
    for distance in (0.3, 90.0, np.inf):
        out = Hits(np.full(9, distance, np.float32), np.ones(9, np.float32))
        assert not measured_ranges(out, block, PERFECT, np.random.default_rng(0))[1].any()


def test_flat_and_far_hits_are_lost_more_often() -> None:
    block, faults = default_rig().lidar, SensorFaults()
    kept = {}
    for name, distance, cosine in (("near", 5.0, 1.0), ("flat", 5.0, 0.01), ("far", 78.0, 1.0)):
        hits = Hits(np.full(5000, distance, np.float32), np.full(5000, cosine, np.float32))
        kept[name] = measured_ranges(hits, block, faults, np.random.default_rng(0))[1].mean()
    assert kept["near"] > 0.99
    assert kept["flat"] < 0.6
    assert kept["far"] < 0.7


def test_beams_are_unit_vectors() -> None:
    directions = beam_directions(default_rig().lidar)
    assert directions.shape == (900, 16, 3)
    assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    assert_allclose(directions[0, :, 1], 0.0, atol=1e-12)
    assert (directions[0, :, 0] < 0.0).all()


def test_a_perfect_imu_reads_the_motion() -> None:
    one = flight()
    samples = of_type(ImuSample, simulate_measurements(one))
    stamps = np.array([s.stamp_ns for s in samples])
    assert len(samples) == 801
    assert_array_equal(np.diff(stamps), 5_000_000)
    state = one.motion(one.times(stamps))
    assert_allclose([s.gyro for s in samples], state.angular_velocity)
    assert_allclose([s.accel for s in samples], state.specific_force())


def test_imu_errors_have_the_densities_of_the_rig() -> None:
    block, rate = default_rig().imu, 200.0
    gyro, accel = imu_errors(block, 400_000, rate, 1.0, np.random.default_rng(0))
    for error, density in ((gyro, block.gyro_noise), (accel, block.accel_noise)):
        white = np.std(np.diff(error, axis=0), axis=0) / np.sqrt(2.0)
        assert_allclose(white, density * np.sqrt(rate), rtol=0.01)
    drifts = np.array([imu_errors(block, 4001, rate, 1.0, np.random.default_rng(k))[1] for k in range(200)])
    smooth = drifts[:, :4000].reshape(200, 10, 400, 3).mean(axis=2)
    drift = (smooth[:, -1] - smooth[:, 0]).std()
    # the mean of a walk over a window of length w, two windows T apart, differs by walk sqrt(T - w/3)
    walk = block.accel_bias_walk * np.sqrt(18.0 - 2.0 / 3.0)
    white = block.accel_noise * np.sqrt(rate) * np.sqrt(2.0 / 400.0)
    assert drift == pytest.approx(np.hypot(walk, white), rel=0.15)
    assert smooth[:, 0].std() == pytest.approx(block.accel_bias_std, rel=0.15)


def test_the_wheel_reads_the_speed_at_its_own_point() -> None:
    rig = default_rig()
    block = rig.wheel.model_copy(update={"p_imu_wheel": (-0.1, 0.9, -0.35)})
    one = flight(rig.model_copy(update={"wheel": block}), start_s=14.0, duration_s=12.0)
    readings = of_type(WheelSpeed, simulate_measurements(one))
    t = one.times(np.array([r.stamp_ns for r in readings]))
    h = 1e-4
    way = one.motion(t + h).point(block.p_imu_wheel) - one.motion(t - h).point(block.p_imu_wheel)
    forward = one.motion(t).R_map_imu[:, :, 0]
    speeds = np.array([r.speed for r in readings])
    assert_allclose(speeds, np.sum(way * forward, axis=1) / (2 * h), atol=1e-5)
    central = rig.wheel.model_copy(update={"p_imu_wheel": (0.0, 0.0, 0.0)})
    assert np.abs(speeds - true_wheel_speed(one.motion(t), central)).max() > 0.3


def test_wheel_scale_and_slip() -> None:
    faults = PERFECT.model_copy(update={"wheel_scale_std": 0.1})
    one, true = flight(faults=faults), flight()
    ratio = np.array([a.speed / b.speed for a, b in zip(_wheel(one), _wheel(true), strict=True)])
    assert_allclose(ratio, ratio[0])
    assert 0.001 < abs(ratio[0] - 1.0) < 0.5
    excess = slip_excess(np.arange(0.0, 3000.0, 0.02), 2.0, 0.3, np.random.default_rng(0))
    assert 0.01 < (excess > 0.0).mean() < 0.06
    assert (excess >= 0.0).all()


def _wheel(one: Flight) -> list[WheelSpeed]:
    return of_type(WheelSpeed, simulate_measurements(one))


def test_uwb_ranges_are_true_in_line_of_sight_and_long_behind_rock() -> None:
    mine = hall(wall=True)
    rig = with_uwb(default_rig(), mine, (0.0, 2.5, 2.0), max_range=40.0)
    assert len(rig.uwb.anchors) == 4
    anchors = rig.uwb.anchor_positions()
    faults = PERFECT.model_copy(update={"uwb_nlos_bias": 2.0})
    one = flight(rig, faults, mine=mine, start_s=2.0, duration_s=40.0)
    ranges = of_type(UwbRange, simulate_measurements(one))
    tag = one.motion(one.times(np.array([r.stamp_ns for r in ranges]))).point(rig.uwb.p_imu_tag)
    anchor = np.array([anchors[r.anchor] for r in ranges])
    true = np.linalg.norm(tag - anchor, axis=1)
    seen = np.isinf(mine.raycaster.free_way(tag, anchor))
    excess = np.array([r.distance for r in ranges]) - true
    assert seen.sum() > 100 and (~seen).sum() > 20
    assert_allclose(excess[seen], 0.0, atol=1e-9)
    assert (excess[~seen] >= 0.0).all() and excess[~seen].mean() == pytest.approx(2.0, rel=0.5)
    assert np.linalg.norm(tag - rig.uwb.center, axis=1).max() <= 40.0 < true.max()


def test_uwb_outliers_and_noise() -> None:
    rig = with_uwb(default_rig(), hall(), (0.0, 0.0, 2.0), max_range=60.0)
    faults = PERFECT.model_copy(update={"uwb_outlier_rate": 0.1, "noise": 1.0})
    one = flight(rig, faults, duration_s=30.0)
    ranges = of_type(UwbRange, simulate_measurements(one))
    tag = one.motion(one.times(np.array([r.stamp_ns for r in ranges]))).point(rig.uwb.p_imu_tag)
    true = np.linalg.norm(tag - np.array([rig.uwb.anchor_positions()[r.anchor] for r in ranges]), axis=1)
    error = np.array([r.distance for r in ranges]) - true
    assert (np.abs(error) > 1.0).mean() == pytest.approx(0.1, abs=0.04)
    assert 1.4826 * np.median(np.abs(error)) == pytest.approx(rig.uwb.range_std, rel=0.25)


def uwb_of(faults: dict[str, object], **more: float) -> list[UwbRange]:
    rig = with_uwb(default_rig(), hall(), (0.0, 0.0, 2.0), max_range=60.0)
    return of_type(UwbRange, simulate_measurements(flight(rig, PERFECT.model_copy(update=faults), **more)))


def test_radios_are_as_badly_calibrated_as_the_rig_says() -> None:
    rig = with_uwb(default_rig(), hall(), (0.0, 0.0, 2.0), max_range=60.0)
    bad = rig.model_copy(update={"uwb": rig.uwb.model_copy(update={"bias_std": 0.2, "scale_std": 0.05})})
    ranges = of_type(UwbRange, simulate_measurements(flight(rig, PERFECT, duration_s=30.0)))
    biased = [
        of_type(UwbRange, simulate_measurements(flight(bad, PERFECT.model_copy(update={"noise": n}), duration_s=30.0)))
        for n in (0.0, 1.0)
    ]
    assert biased[0] == ranges
    for anchor in rig.uwb.anchors:
        true, read = (np.array([r.distance for r in one if r.anchor == anchor]) for one in (ranges, biased[1]))
        scale, bias = np.polyfit(true, read, 1)
        assert 0.0 < abs(scale - 1.0) < 0.2 and 0.0 < abs(bias) < 0.8


def test_ranges_by_a_detour_are_long_and_change_no_other() -> None:
    straight = uwb_of({"uwb_nlos_bias": 2.0, "noise": 1.0}, duration_s=30.0)
    bent = uwb_of({"uwb_nlos_bias": 2.0, "noise": 1.0, "uwb_nlos_rate": 0.1}, duration_s=30.0)
    assert [(m.stamp_ns, m.anchor) for m in bent] == [(m.stamp_ns, m.anchor) for m in straight]
    excess = np.array([b.distance - s.distance for b, s in zip(bent, straight, strict=True)])
    assert (excess >= 0.0).all()
    assert (excess > 0.0).mean() == pytest.approx(0.1, abs=0.03)
    assert excess[excess > 0.0].mean() == pytest.approx(2.0, rel=0.25)


def test_a_dead_anchor_says_nothing_and_a_silence_is_everybodys() -> None:
    assert {m.anchor for m in uwb_of({})} == {100, 101, 102, 103}
    assert {m.anchor for m in uwb_of({"uwb_dead": (101, 103)})} == {100, 102}
    seconds = np.array([m.stamp_ns for m in uwb_of({"uwb_silent_s": (7.0, 8.5)})]) * 1e-9 - 1000.0
    assert ((seconds < 7.0) | (seconds >= 8.5)).all()
    assert (seconds < 7.0).sum() > 30 and (seconds >= 8.5).sum() > 30


def test_a_long_slip_is_where_and_as_much_as_asked() -> None:
    speeds = {
        name: of_type(WheelSpeed, simulate_measurements(flight(None, PERFECT.model_copy(update=faults))))
        for name, faults in {"none": {}, "slip": {"wheel_slip": 0.2, "wheel_slip_s": (7.0, 8.0)}}.items()
    }
    seconds = np.array([m.stamp_ns for m in speeds["none"]]) * 1e-9 - 1000.0
    ratio = np.array([slip.speed / true.speed for slip, true in zip(speeds["slip"], speeds["none"], strict=True)])
    assert_allclose(ratio, np.where((seconds >= 7.0) & (seconds < 8.0), 1.2, 1.0))


def test_prism_fixes_only_in_line_of_sight() -> None:
    mine = hall(wall=True)
    rig = with_total_station(default_rig(), (25.0, 10.0, 2.0))
    one = flight(rig, PERFECT, mine=mine, start_s=0.0, duration_s=60.0)
    fixes = of_type(PrismFix, simulate_measurements(one))
    assert 50 < len(fixes) < 0.9 * 5 * 60
    prism = one.motion(one.times(np.array([f.stamp_ns for f in fixes]))).point(rig.total_station.p_imu_prism)
    assert_allclose([f.p_map for f in fixes], prism)
    behind_the_wall = (prism[:, 0] < -5.0) & (prism[:, 1] < -6.0)
    assert not behind_the_wall.any()


def test_measurements_come_in_the_order_of_their_arrival() -> None:
    rig = with_total_station(with_uwb(default_rig(), hall(), (0.0, 0.0, 2.0)), (25.0, 10.0, 2.0))
    stream = list(simulate_measurements(flight(rig, SensorFaults())))
    arrivals = np.array([arrival_ns(m) for m in stream])
    assert (np.diff(arrivals) >= 0).all()
    assert {type(m) for m in stream} == {Scan, ImuSample, WheelSpeed, UwbRange, PrismFix}
    last_imu = max(m.stamp_ns for m in stream if isinstance(m, ImuSample))
    assert all(m.end_ns <= last_imu for m in stream if isinstance(m, Scan))


def test_the_same_seed_gives_the_same_stream_and_sensors_do_not_disturb_each_other() -> None:
    whole, again = (list(simulate_measurements(flight(faults=SensorFaults(), seed=5))) for _ in range(2))
    for a, b in zip(of_type(Scan, whole), of_type(Scan, again), strict=True):
        assert_array_equal(a.points, b.points)
    fewer = list(simulate_measurements(flight(default_rig().without("lidar"), SensorFaults(), seed=5)))
    assert not of_type(Scan, fewer)
    assert [w.speed for w in of_type(WheelSpeed, fewer)] == [w.speed for w in of_type(WheelSpeed, whole)]
    other = list(simulate_measurements(flight(faults=SensorFaults(), seed=6)))
    assert of_type(WheelSpeed, other)[0].speed != of_type(WheelSpeed, whole)[0].speed


def test_the_truth_is_the_motion_at_fifty_hertz() -> None:
    one = flight()
    truth = one.truth()
    assert truth.frame == "map" and len(truth) == 201
    assert_allclose(truth.poses, one.motion(one.times(truth.stamps_ns)).poses())
    assert truth.stamps_ns[0] == next(simulate_measurements(one)).stamp_ns


def test_a_recording_may_start_in_motion() -> None:
    resting, moving = flight(start_s=0.0), flight(start_s=10.0)
    assert of_type(WheelSpeed, simulate_measurements(resting))[0].speed == pytest.approx(0.0, abs=1e-9)
    assert of_type(WheelSpeed, simulate_measurements(moving))[0].speed > 1.5
    with pytest.raises(SettingsError, match="after the end of the flight"):
        flight(start_s=1e4)


@pytest.mark.parametrize(
    ("route", "message"),
    [
        ([[-20, 0, 0], [45, 0, 0]], "passes through rock|has no floor below"),
        ([[-20, 40, 0], [20, 40, 0]], "has no floor below"),
        ([[-20, 40], [20, 40]], "has no floor of the mine under it"),
        ([[-20, 0, 0]], "fewer than two points"),
        ([[-20, 0, 0], [np.nan, 0, 0]], "not finite"),
    ],
)
def test_routes_that_leave_the_mine_are_refused(route: list[list[float]], message: str) -> None:
    with pytest.raises(InputFileError, match=message):
        fly(hall(), route)


def test_a_route_on_the_ground_outside_is_refused() -> None:
    mesh = box(LOW, HIGH) + box(np.array([-60.0, -60.0, -1.0]), np.array([60.0, 60.0, -0.5]))
    mine = Mine("hall on a plate", np.asarray(mesh.vertices), np.asarray(mesh.triangles), np.zeros(3))
    fly(mine, ROUTE)
    with pytest.raises(InputFileError, match="is outside the mine"):
        fly(mine, [[-20.0, 40.0, -0.5], [20.0, 40.0, -0.5]])


def test_a_way_too_narrow_is_refused() -> None:
    mesh = box(np.array([0.0, -0.2, 0.0]), np.array([40.0, 0.2, 3.0]))
    crack = Mine("crack", np.asarray(mesh.vertices), np.asarray(mesh.triangles), np.zeros(3))
    with pytest.raises(InputFileError, match="comes nearer than"):
        fly(crack, [[2.0, 0.0, 0.0], [36.0, 0.0, 0.0]])


def test_a_path_gives_way_where_there_is_no_room_to_swing_out() -> None:
    mesh = box(np.array([0.0, -0.8, 0.0]), np.array([40.0, 0.8, 3.0]))
    narrow = Mine("narrow", np.asarray(mesh.vertices), np.asarray(mesh.triangles), np.zeros(3))
    motion = fly(narrow, [[2.0, 0.0, 0.0], [36.0, 0.0, 0.0], [2.0, 0.0, 0.0]]).motion
    p = motion(np.arange(0.0, motion.duration_s, 0.1)).position
    assert narrow.raycaster.clearance(p).min() > 0.35
    assert np.ptp(p[:, 1]) > 0.3


def test_a_mesh_needs_a_route() -> None:
    with pytest.raises(InputFileError, match="needs a route"):
        fly(hall())


@pytest.mark.skipif(not EDGAR.is_dir(), reason="the benchmark data is not beside the repository")
def test_scans_agree_with_a_recording_that_another_simulator_made() -> None:
    rig = Rig.from_yaml(EDGAR / "rig.yaml")
    assert rig == default_rig() and rig.model_fields_set == default_rig().model_fields_set
    truth = Trajectory.load_tum(EDGAR / "recording_60s" / "ground_truth.tum")
    mine, block = load_mesh(EDGAR / "edgar_mine.ply"), rig.lidar
    stream = read_recording(EDGAR / "recording_60s", rig)
    scan = [next(m for m in stream if isinstance(m, Scan)) for _ in range(5)][-1]
    poses = interpolate_poses(truth.stamps_ns, truth.poses, scan.stamp_ns + scan.offsets_ns) @ block.T_imu_lidar
    column = np.rint(scan.offsets_ns / 1e8 * block.columns).astype(int)
    rays = np.einsum("nij,nj->ni", poses[:, :3, :3], beam_directions(block)[column, scan.ring])
    ours = mine.raycaster.cast(poses[:, :3, 3], rays).distances
    difference = np.linalg.norm(scan.points, axis=1) - ours
    assert abs(np.median(difference)) < 2e-3
    assert 1.4826 * np.median(np.abs(difference)) == pytest.approx(block.range_std, rel=0.1)


def test_anchors_along_a_route_are_seen_from_all_of_it_and_lie_in_no_plane() -> None:
    mine = scenario("demo", seed=2)
    route = mine.scenario.route_floor()
    rig = with_uwb_along(default_rig(), mine, route, spacing=6.0, max_range=20.0)
    anchors = np.array(list(rig.uwb.anchor_positions().values()))
    for p in route[:: len(route) // 12] + [0.0, 0.0, 1.3]:
        near = anchors[np.linalg.norm(anchors - p, axis=1) < 20.0]
        seen = near[np.isinf(mine.raycaster.free_way(np.broadcast_to(p, near.shape), near))]
        assert len(seen) >= 3
        assert np.linalg.svd(seen - seen.mean(axis=0), compute_uv=False)[-1] > 0.3 or len(seen) == 3
