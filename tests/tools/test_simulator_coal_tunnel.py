"""The tunnel of paper 000: its lay-out, its own robot, its check points, and that nothing in it tells where one is."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

from semmap.measurements import UwbRange, WheelSpeed
from tools.simulator import Flight, MotionSettings, SimulationSettings, dig, fly, simulate_measurements
from tools.simulator.check_points import check_stamps
from tools.simulator.coal_tunnel import GATE_X, coal_rig, coal_tunnel

P_END = np.array([34.963, 0.0, 2.249])


@cache
def tunnel(seed: int, length: float = 75.0) -> Flight:
    return fly(dig(coal_tunnel(seed, length=length), voxel=0.3), seed=seed)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_robot_starts_at_the_papers_place_and_sees_every_anchor(seed: int) -> None:
    flight = tunnel(seed)
    assert_allclose(flight.truth(1.0).positions[0], [11.49, -0.019, 0.971], atol=1e-6)
    tag = flight.motion(np.zeros(1)).point(np.array(flight.rig.uwb.p_imu_tag))
    for anchor in flight.rig.uwb.anchor_positions().values():
        assert np.isinf(flight.mine.raycaster.free_way(tag, anchor[None])[0])


def test_it_drives_at_the_papers_speed_to_the_face() -> None:
    for length in (75.0, 200.0):
        truth = tunnel(0, length).truth()
        steps = np.linalg.norm(np.diff(truth.positions, axis=0), axis=1)
        assert 50.0 * np.median(steps) == pytest.approx(0.3, abs=0.001)
        assert GATE_X + length - truth.positions[-1, 0] == pytest.approx(4.0, abs=0.01)


def test_no_range_arrives_beyond_the_end_of_the_reach() -> None:
    flight = tunnel(1)
    ranges = list(simulate_measurements(replace(flight, rig=flight.rig.without("lidar"))))
    last = max(m.stamp_ns for m in ranges if isinstance(m, UwbRange))
    assert any(isinstance(m, WheelSpeed) and m.stamp_ns > last + 100e9 for m in ranges)
    x = flight.motion(flight.times(np.array([last]))).point(np.array(flight.rig.uwb.p_imu_tag))[0, 0]
    assert x == pytest.approx(P_END[0], abs=0.1)
    assert np.linalg.norm(P_END - coal_rig().uwb.center) == pytest.approx(coal_rig().uwb.max_range)


def test_the_inner_tunnel_looks_the_same_everywhere_and_the_outer_one_does_not() -> None:
    caster = tunnel(2).mine.raycaster
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    round_about = np.column_stack([np.zeros(24), np.cos(angle), np.sin(angle)])

    def section(x: float) -> np.ndarray:
        return caster.cast(np.tile([x, 0.0, 1.5], (24, 1)), round_about).distances

    inner = np.array([section(x) for x in np.arange(GATE_X + 5.0, GATE_X + 65.0, 1.7)])
    outer = np.array([section(x) for x in np.arange(2.0, GATE_X - 5.0, 1.7)])
    assert np.ptp(inner, axis=0).max() < 0.01
    assert np.std(outer, axis=0).mean() > 0.05


def test_check_points_are_evenly_spread_and_the_last_is_the_end() -> None:
    truth = tunnel(0).truth()
    stamps = check_stamps(truth)
    assert len(stamps) == 15
    x = truth.at(stamps)[:, 0, 3]
    assert_allclose(np.diff(x), truth.length() / 15, atol=0.02)
    assert x[-1] == pytest.approx(truth.positions[-1, 0], abs=1e-3)


def test_what_the_settings_say_of_the_motion_goes_before_the_tunnels_own() -> None:
    mine = tunnel(0).mine
    faster = fly(mine, settings=SimulationSettings(motion=MotionSettings(speed=1.5)))
    assert faster.motion.duration_s < 0.3 * tunnel(0).motion.duration_s
    assert_allclose(faster.truth(1.0).positions[0], tunnel(0).truth(1.0).positions[0])
