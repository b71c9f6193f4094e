"""The whole online way on simulated flights: right in the map, or silent."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from localize import Localizer, LocalizeSettings
from maps.build import build_semantic_map
from maps.prior_map import PriorMap
from semmap.errors import DatabaseError
from semmap.geometry import inverse, se3_log
from semmap.measurements import ImuSample, Scan, UwbRange, WheelSpeed
from tools.simulator import SensorFaults, SimulationSettings, default_rig, fly, scenario, simulate_measurements
from tools.simulator.rigs import with_total_station, with_uwb

FAR = np.array([431_000.0, 5_127_000.0, 1_200.0])


@cache
def mine(name, seed=0):
    return scenario(name, seed=seed)


@cache
def semantic_map(name, seed=0):
    points = mine(name, seed).sample(spacing=0.12, noise=0.01, seed=seed)
    return build_semantic_map(PriorMap(points.astype(np.float32), np.zeros(3)))


@cache
def flight(name, seed=0, start_s=0.0, duration_s=40.0):
    it = fly(mine(name, seed), settings=SimulationSettings(start_s=start_s, duration_s=duration_s), seed=seed)
    return it, tuple(simulate_measurements(it))


def localize(rig, measurements, semantic_map=None):
    localizer = Localizer(rig, semantic_map)
    updates = [update for m in measurements if (update := localizer.add(m)) is not None]
    return localizer.finish(), updates


def errors(trajectory, truth):
    return np.linalg.norm(trajectory.positions - truth.at(trajectory.stamps_ns)[:, :3, 3], axis=1)


@pytest.mark.parametrize("start_s", [0.0, 12.0], ids=["from rest", "in motion"])
def test_finds_its_place_in_the_map_and_keeps_it(start_s):
    it, measurements = flight("demo", 1, start_s)
    result, updates = localize(it.rig, measurements, semantic_map("demo", 1))
    truth = it.truth()
    assert result.trajectory.frame == "map" and len(result.trajectory) == result.summary["scans"]
    assert errors(result.trajectory, truth).max() < 0.15
    assert 0 < len(result.realtime) < len(result.trajectory)
    assert errors(result.realtime, truth).max() < 0.10
    # not a word about the map before the first proof, and a covariance with every word after
    known = [update.T_map_imu is not None for update in updates]
    assert known == sorted(known) and not known[0]
    assert all((u.covariance is None) == (u.T_map_imu is None) for u in updates)
    assert {u.state for u in updates} == {"unknown", "tracking"}


def test_errors_agree_with_the_reported_covariance():
    """Normalised error squared of the published poses: not above its bound, and not absurdly small."""
    squared = []
    for seed in (1, 2):
        it, measurements = flight("demo", seed)
        _, updates = localize(it.rig, measurements, semantic_map("demo", seed))
        known = [u for u in updates if u.T_map_imu is not None]
        truth = it.truth().at(np.array([u.stamp_ns for u in known]))
        for update, T in zip(known, truth, strict=True):
            error = se3_log(inverse(update.T_map_imu) @ T)
            squared.append(error @ np.linalg.solve(update.covariance, error))
    assert 0.02 < np.mean(squared) / 6 < 1.5


@pytest.mark.parametrize(("there", "map_of"), [("demo", ("grid", 0)), ("grid", ("demo", 1)), ("demo", ("demo", 2))])
def test_is_silent_in_a_mine_it_has_no_map_of(there, map_of):
    it, measurements = flight(there, 1)
    result, updates = localize(it.rig, measurements, semantic_map(*map_of))
    assert not len(result.realtime) and not len(result.trajectory)
    assert result.trajectory.frame == "map" and len(result.odometry) == result.summary["scans"]
    assert all(update.T_map_imu is None and update.state == "unknown" for update in updates)


def test_look_alike_crossings_do_not_pin_it_to_a_wrong_one():
    it, measurements = flight("grid", 1)
    whole = semantic_map("grid", 1)
    parts = (whole.intersections, whole.intersections[::3], whole.intersections[5:6], whole.intersections[9:10])
    for part in (replace(whole, intersections=part) for part in parts):
        result, _ = localize(it.rig, measurements, part)
        if len(result.realtime):
            assert errors(result.realtime, it.truth()).max() < 0.1


def test_every_match_is_told_with_its_scores_and_reason():
    it, measurements = flight("demo", 1)
    result, _ = localize(it.rig, measurements, semantic_map("demo", 1))
    looks = [event for event in result.events if event["kind"] == "intersection"]
    assert len(looks) == result.summary["intersections_seen"] > 10
    assert all(event["reason"] and isinstance(event["accepted"], bool) for event in looks)
    pinned = [event for event in looks if event["accepted"]]
    assert {event["id"] for event in pinned} == set(result.summary["intersections_recognised"])
    assert all(event["fit"] > 0.85 and event["icp_distance_m"] < 0.15 for event in pinned)
    assert [event["after"] for event in result.events if event["kind"] == "state"] == ["tracking"]
    stamps = [event["stamp_ns"] for event in result.events]
    assert stamps == sorted(stamps)


def test_mine_grid_coordinates_lose_nothing():
    """The same flight in a map whose numbers are millions of metres."""
    it, measurements = flight("demo", 1)
    near = semantic_map("demo", 1)
    origin = 1000.0 * np.round(FAR / 1000.0)
    far = replace(near, origin=origin, intersections=tuple(replace(i, p_map=i.p_map + FAR) for i in near.intersections))
    result, _ = localize(it.rig, measurements, far)
    beside, _ = localize(it.rig, measurements, near)
    np.testing.assert_allclose(result.trajectory.positions - FAR, beside.trajectory.positions, atol=2e-3)
    np.testing.assert_allclose(result.realtime.positions - FAR, beside.realtime.positions, atol=2e-3)


def test_two_runs_give_the_same_bytes():
    it, measurements = flight("demo", 1)
    first, _ = localize(it.rig, measurements, semantic_map("demo", 1))
    second, _ = localize(it.rig, measurements, semantic_map("demo", 1))
    np.testing.assert_array_equal(first.trajectory.poses, second.trajectory.poses)
    np.testing.assert_array_equal(first.realtime.poses, second.realtime.poses)
    assert first.events == second.events


def test_uwb_alone_finds_the_map():
    """No database: ranges place the odometry, in motion, with no first guess (paper 000)."""
    it = mine("drift", 3)
    route = it.scenario.route_floor()
    rig = with_uwb(default_rig(), it, route[len(route) // 6] + [0, 0, 1.3])
    going = fly(it, rig=rig, settings=SimulationSettings(duration_s=45.0), seed=3)
    result, _ = localize(rig, tuple(simulate_measurements(going)))
    assert result.summary["anchored"] and any("U" in e["after"] for e in result.events if e["kind"] == "mode")
    assert np.median(errors(result.realtime, going.truth())) < 0.25


def test_total_station_alone_finds_the_map():
    it = mine("drift", 3)
    rig = with_total_station(default_rig(), it.scenario.route_floor()[0] + [0.0, 0.0, 1.5])
    going = fly(it, rig=rig, settings=SimulationSettings(duration_s=30.0), seed=3)
    result, _ = localize(rig, tuple(simulate_measurements(going)))
    assert result.trajectory.frame == "map"
    assert errors(result.trajectory, going.truth()).max() < 0.15


@pytest.mark.parametrize("offset_s", [-0.3, 0.3])
def test_a_total_station_whose_clock_is_off_puts_nothing_off(offset_s):
    """From the first pose that is told, and with what was found in summary and events."""
    it = mine("drift", 3)
    rig = with_total_station(default_rig(), it.scenario.route_floor()[0] + [0.0, 0.0, 1.5])
    faults = SensorFaults(prism_clock_s=-offset_s)
    going = fly(it, rig=rig, settings=SimulationSettings(duration_s=30.0, faults=faults), seed=3)
    result, _ = localize(rig, tuple(simulate_measurements(going)))
    clock = result.summary["prism_clock_offset"]
    assert abs(clock["offset_s"] - offset_s) < 4.0 * clock["std_s"] < 0.02
    assert [e for e in result.events if e["kind"] == "prism_clock_off"]
    assert errors(result.realtime, going.truth()).max() < 0.1
    assert errors(result.trajectory, going.truth()).max() < 0.1


def test_without_any_reference_the_frame_is_odom():
    it, measurements = flight("demo", 1)
    localizer = Localizer(it.rig.without("wheel"), None, LocalizeSettings().without_loops())
    updates = [u for m in measurements[: len(measurements) // 4] if (u := localizer.add(m)) is not None]
    result = localizer.finish()
    assert result.trajectory.frame == result.realtime.frame == "odom"
    np.testing.assert_array_equal(result.realtime.poses, result.odometry.poses)
    assert updates[-1].T_map_imu is None


def test_ranges_of_an_unknown_anchor_are_counted_and_left_out():
    it, measurements = flight("demo", 1)
    rig = with_uwb(it.rig, mine("demo", 1), mine("demo", 1).scenario.route_floor()[3] + [0, 0, 1.3])
    strange = [UwbRange(measurements[0].stamp_ns + k * 10**8, 77, 5.0) for k in range(1, 20)]
    result, _ = localize(rig, [*measurements[:3000], *strange])
    assert result.summary["unknown_anchors"] == [77]


def test_a_map_made_with_settings_unknown_here_is_refused():
    """Descriptors of other settings do not compare."""
    strange = replace(semantic_map("demo", 1), settings={"contour": {"sector": 60}})
    with pytest.raises(DatabaseError, match="sectors"):
        Localizer(default_rig(), strange)


def test_a_recording_too_short_to_start_gives_an_empty_result():
    result, updates = localize(default_rig(), [ImuSample(0, np.zeros(3), np.array([0, 0, 9.81]))])
    assert not updates and not len(result.odometry) and result.summary["scans"] == 0


def test_empty_scans_and_a_blind_lidar_do_not_stop_it():
    it, measurements = flight("demo", 1)
    none, no_time = np.zeros((0, 3), np.float32), np.zeros(0, np.int64)
    blind = [
        Scan(m.stamp_ns, none, no_time) if isinstance(m, Scan) and 100 < i % 2000 < 600 else m
        for i, m in enumerate(measurements[:5000])
    ]
    result, _ = localize(it.rig, blind)
    assert result.summary["scans"] > 150
    assert np.isfinite(result.odometry.poses).all()


def test_without_lidar_wheel_and_imu_carry_on():
    it, measurements = flight("demo", 1)
    result, _ = localize(it.rig.without("lidar"), measurements)
    truth = it.truth()
    assert any(isinstance(m, WheelSpeed) for m in measurements)
    start = truth.at(result.odometry.stamps_ns[:1])[0]
    moved = start @ inverse(result.odometry.poses[0]) @ result.odometry.poses
    off = np.linalg.norm(moved[:, :3, 3] - truth.at(result.odometry.stamps_ns)[:, :3, 3], axis=1)
    assert off.max() < 0.05 * truth.length()


def carried_off(measurements, from_s, to_s, gap_s):
    """The recording cut at ``from_s`` and gone on with from ``to_s``; true stamps of its stamps."""
    begin_ns = measurements[0].stamp_ns
    cut_ns, on_ns = begin_ns + round(from_s * 1e9), begin_ns + round(to_s * 1e9)
    back_ns = on_ns - cut_ns - round(gap_s * 1e9)
    before = [m for m in measurements if m.stamp_ns < cut_ns]
    after = [replace(m, stamp_ns=m.stamp_ns - back_ns) for m in measurements if m.stamp_ns >= on_ns]
    return [*before, *after], lambda stamps: np.where(stamps < cut_ns, stamps, stamps + back_ns)


@pytest.mark.parametrize(
    ("name", "seed", "from_s", "to_s", "gap_s"),
    [
        ("demo", 1, 25.0, 37.7, 0.0),
        ("demo", 1, 25.0, 50.0, 4.0),
        pytest.param("grid", 2, 15.0, 35.0, 0.0, marks=pytest.mark.slow),
    ],
    ids=["between two scans", "in a silence", "among look-alikes"],
)
def test_carried_off_in_the_middle_it_says_so_and_finds_itself_again(name, seed, from_s, to_s, gap_s):
    it, measurements = flight(name, seed, duration_s=65.0)
    joined, true_stamps = carried_off(measurements, from_s, to_s, gap_s)
    result, updates = localize(it.rig, joined, semantic_map(name, seed))
    states = [event["after"] for event in result.events if event["kind"] == "state"]
    assert states == ["tracking", "lost", "tracking"]
    assert all((u.T_map_imu is not None) <= (u.state == "tracking") for u in updates)
    for track in (result.realtime, result.trajectory):
        truth = it.truth().at(true_stamps(track.stamps_ns))[:, :3, 3]
        assert np.linalg.norm(track.positions - truth, axis=1).max() < 0.25
    assert len(result.odometry) == result.summary["scans"]


def test_look_alike_crossings_are_told_apart_by_their_rock():
    it, measurements = flight("grid", 1)
    result, _ = localize(it.rig, measurements, semantic_map("grid", 1))
    first_s = (result.realtime.stamps_ns[0] - result.odometry.stamps_ns[0]) * 1e-9
    assert first_s < 25.0 and errors(result.realtime, it.truth()).max() < 0.1
