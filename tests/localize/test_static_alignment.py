"""Attitude at rest: exact without noise, as sure as it says with it, and held level by gravity."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from localize.denoise import DenoiseSettings, enhance
from localize.earth import Earth
from localize.static_alignment import align_static, corrected_tilt, tilt_gain
from semmap.errors import MeasurementError
from semmap.geometry import so3_exp, so3_log, yaw_of
from semmap.rig import EarthBlock, ImuBlock
from tools.simulator.imu import imu_errors
from tools.simulator.vibration import oil_pumps, standing_imu

EARTH = Earth.of(EarthBlock(latitude_deg=37.87, grid_bearing_deg=15.0))
FIBRE = ImuBlock(
    topic="/imu", gyro_noise=1.5e-6, accel_noise=3e-4, gyro_bias_walk=1e-10, accel_bias_walk=1e-7,
    gyro_bias_std=1e-7, accel_bias_std=5e-4,
)  # fmt: skip
COARSE = ImuBlock(topic="/imu", gyro_bias_std=0.005)


def stretch(seconds: float, rate: float = 100.0) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(round(seconds * rate) + 1) / rate
    return t, np.round(t * 1e9).astype(np.int64)


@pytest.mark.parametrize("attitude", [[0.0, 0.0, 0.0], [0.1, -0.05, 2.5], [0.02, 0.3, -1.0]])
def test_level_and_north_are_found_exactly(attitude) -> None:
    t, stamps = stretch(10.0)
    R = so3_exp(attitude)
    gyro, accel = standing_imu(t, R, earth_rate=EARTH.rate, gravity=EARTH.gravity, vibration=None)
    found = align_static(stamps, gyro, accel, FIBRE, EARTH)
    assert_allclose(found.R_map_imu, R, atol=1e-9)
    assert_allclose(found.gyro_bias, 0.0, atol=1e-12)
    assert found.sure(heading_std=0.02)


@pytest.mark.parametrize("seed", range(3))
def test_a_given_heading_is_taken(seed) -> None:
    t, stamps = stretch(10.0)
    rng = np.random.default_rng(seed)
    R = so3_exp([0.05, -0.1, rng.uniform(-3, 3)])
    bias = 0.01 * rng.normal(size=3)
    gyro, accel = standing_imu(t, R, earth_rate=EARTH.rate, gravity=EARTH.gravity, vibration=None)
    found = align_static(stamps, gyro + bias, accel, COARSE, EARTH, heading=yaw_of(R))
    assert_allclose(found.R_map_imu, R, atol=1e-9)
    assert_allclose(found.gyro_bias, bias, atol=1e-9)


@pytest.mark.parametrize(("imu", "earth"), [(COARSE, EARTH), (FIBRE, Earth.of(None))])
def test_who_cannot_find_north_says_so(imu, earth) -> None:
    t, stamps = stretch(10.0)
    R = so3_exp([0.05, -0.1, 1.0])
    gyro, accel = standing_imu(t, R, earth_rate=earth.rate, gravity=earth.gravity, vibration=None)
    found = align_static(stamps, gyro, accel, imu, earth)
    assert not found.sure(heading_std=0.5)
    assert_allclose(found.R_map_imu[2], R[2], atol=1e-9)
    # only what the vertical tells is taken off the rate
    assert np.abs(found.gyro_bias).max() < 7.3e-5


def test_a_stretch_too_short_is_refused() -> None:
    with pytest.raises(MeasurementError, match="at rest"):
        align_static(np.arange(3, dtype=np.int64), np.zeros((3, 3)), np.ones((3, 3)), FIBRE, EARTH)


def test_errors_are_what_the_alignment_says_of_itself() -> None:
    """Thirty turn-ons: the errors over their sigmas are of length one, about."""
    t, stamps = stretch(60.0, 50.0)
    scaled = []
    for seed in range(30):
        rng = np.random.default_rng([seed, 1])
        R = so3_exp([0.0, 0.0, rng.uniform(-3, 3)]) @ so3_exp(np.append(0.05 * rng.normal(size=2), 0.0))
        exact = standing_imu(t, R, earth_rate=EARTH.rate, gravity=EARTH.gravity, vibration=None)
        errors = imu_errors(FIBRE, len(t), 50.0, 1.0, rng)
        found = align_static(stamps, exact[0] + errors[0], exact[1] + errors[1], FIBRE, EARTH)
        off = so3_log(found.R_map_imu @ R.T)
        scaled.append(off / np.array([found.tilt_std, found.tilt_std, found.heading_std]))
    assert_allclose(np.mean(np.square(scaled), axis=0), 1.0, atol=0.75)
    assert_allclose(np.mean(np.square(scaled)), 1.0, atol=0.4)


def test_under_vibration_the_enhanced_heading_is_that_of_the_quiet_machine() -> None:
    seed = 2
    t, stamps = stretch(60.0, 200.0)
    R = so3_exp([0.02, -0.01, seed])
    white = 1.5e-6 * np.sqrt(200.0) * np.random.default_rng(seed).normal(size=(len(t), 3))
    headings = {}
    for name, pumps in (("quiet", None), ("loud", oil_pumps(seed))):
        gyro, accel = standing_imu(t, R, earth_rate=EARTH.rate, gravity=EARTH.gravity, vibration=pumps)
        enhanced = enhance(stamps, gyro + white, accel, DenoiseSettings())
        headings[name] = align_static(stamps, enhanced.gyro, enhanced.accel, FIBRE, EARTH).R_map_imu
        if pumps is not None:
            headings["raw"] = align_static(stamps, gyro + white, accel, FIBRE, EARTH).R_map_imu
    off, raw = (np.linalg.norm(so3_log(headings["quiet"].T @ headings[name])) for name in ("loud", "raw"))
    assert np.degrees(off) < 0.02
    assert off < 0.3 * raw  # what a tapered mean leaves is the coning


def test_the_gain_halves_where_the_text_says() -> None:
    g = 9.81
    assert_allclose(tilt_gain(np.array([0.0, 0.0, g]), g), 0.991, atol=1e-3)
    assert_allclose(tilt_gain(np.array([0.0, 0.0, 1.148 * g]), g), 0.991 / 2, atol=1e-9)
    assert_allclose(tilt_gain(np.array([0.0, 0.0, 0.852 * g]), g), 0.991 / 2, atol=1e-9)
    assert tilt_gain(np.array([0.0, 0.0, 1.4 * g]), g) < 1e-6
    assert tilt_gain(np.array([0.0, 0.0, 1e3]), g) >= 0.0


def test_the_correction_levels_and_leaves_the_heading(rng) -> None:
    R = so3_exp([0.05, -0.1, 0.0])
    R = so3_exp([0.0, 0.0, 0.8]) @ R
    leaning = so3_exp([0.02, -0.03, 0.0]) @ R
    accel = R.T @ [0.0, 0.0, 9.81]
    once = corrected_tilt(leaning, accel, 9.81)
    assert np.arccos(once[2] @ R[2]) < 0.02 * np.arccos(leaning[2] @ R[2])
    # the turn in the map is about a horizontal axis
    assert abs(so3_log(once @ leaning.T)[2]) < 1e-4
    jolted = corrected_tilt(leaning, 1.5 * accel, 9.81)
    assert_allclose(jolted, leaning, atol=1e-9)


def test_a_slow_correction_bounds_the_drift_of_a_biased_gyroscope() -> None:
    R, drifting = so3_exp([0.02, 0.01, 0.3]), so3_exp([0.02, 0.01, 0.3])
    free = R
    for _ in range(2000):
        step = so3_exp([0.0005 * 0.01, 0.0, 0.0])
        free = free @ step
        drifting = corrected_tilt(drifting @ step, R.T @ [0.0, 0.0, 9.81], 9.81, dt=0.01, time_s=2.0)
    # 0.5 mrad/s held at two seconds of it
    assert np.linalg.norm(so3_log(drifting.T @ R)) < 1.1e-3
    assert np.linalg.norm(so3_log(free.T @ R)) > 9e-3
