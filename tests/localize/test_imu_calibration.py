"""Noise of an IMU from a recording: the levels that went in come out, motion and haste are refused."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from localize.earth import Earth
from localize.imu_calibration import calibrate, find_static
from localize.imu_noise import sensor_noise
from semmap.errors import RecordingError
from semmap.rig import EarthBlock, ImuBlock
from tools.simulator.imu import imu_errors
from tools.simulator.vibration import oil_pumps, standing_imu

STILL = Earth.of(None)
COARSE = ImuBlock(
    topic="/imu/data", gyro_noise=4e-4, accel_noise=3e-3, gyro_bias_walk=4e-5, accel_bias_walk=5e-4,
    gyro_bias_std=3e-3, accel_bias_std=0.03,
)  # fmt: skip
FIBRE = ImuBlock(
    topic="/imu/data", gyro_noise=1.5e-6, accel_noise=3e-4, gyro_bias_walk=1e-8, accel_bias_walk=1e-6,
    gyro_bias_std=1e-6, accel_bias_std=5e-4,
)  # fmt: skip
RATE = 200.0


def standing(block: ImuBlock, seconds: float, seed: int, *, earth: Earth = STILL, shaken: bool = False):
    """Stamps, rates and forces of an IMU at rest."""
    t = np.arange(round(seconds * RATE)) / RATE
    vibration = oil_pumps(seed, gyro_rms=0.005, accel_rms=0.3) if shaken else None
    exact = standing_imu(t, np.eye(3), earth_rate=earth.rate, gravity=earth.gravity, vibration=vibration)
    errors = imu_errors(block, len(t), RATE, 1.0, np.random.default_rng(seed))
    return np.round(t * 1e9).astype(np.int64), exact[0] + errors[0], exact[1] + errors[1]


def driving(seconds: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rates and forces of a robot that wanders about, on top of rest."""
    t = np.arange(round(seconds * RATE)) / RATE
    rng = np.random.default_rng([seed, 1])
    phase = rng.uniform(0.0, 6.0, (2, 3))
    rate = 0.03 * np.sin(2 * np.pi * np.array([0.31, 0.23, 0.17]) * t[:, None] + phase[0])
    force = 0.3 * np.sin(2 * np.pi * np.array([0.19, 0.29, 0.37]) * t[:, None] + phase[1])
    return rate, force


@pytest.mark.parametrize("shaken", [False, True])
@pytest.mark.parametrize("block", [COARSE, FIBRE], ids=["coarse", "fibre"])
def test_what_went_in_comes_out(block, shaken) -> None:
    stamps, gyro, accel = standing(block, 900.0, 3, shaken=shaken)
    found = calibrate(stamps, gyro, accel, ImuBlock(topic="/imu/data"), STILL)
    assert found.stretch.duration_s > 890.0
    for key in ("gyro_noise", "accel_noise"):
        assert_allclose(found.noise_block[key], getattr(block, key), rtol=0.1)
    for key, fit in (("gyro_bias_walk", found.gyro), ("accel_bias_walk", found.accel)):
        if fit.walk.seen:
            assert_allclose(found.noise_block[key], getattr(block, key), rtol=0.6)
        else:  # a quarter of an hour does not show it: what is written is what it is at the most
            assert 0.9 * getattr(block, key) < found.noise_block[key] < 5.0 * getattr(block, key)


def test_levels_are_off_by_what_they_say(rng) -> None:
    """Twenty sensors: errors over their sigmas are of length one, about."""
    scaled = []
    for _ in range(20):
        n = 40_000
        samples = 1e-3 * np.sqrt(RATE) * rng.normal(size=(n, 3))
        samples += np.cumsum(2e-4 / np.sqrt(RATE) * rng.normal(size=(n, 3)), axis=0)
        noise = sensor_noise(samples, RATE)
        scaled.append([(noise.white.value - 1e-3) / noise.white.std, (noise.walk.value - 2e-4) / noise.walk.std])
        assert noise.white.bound > 1e-3 * 0.95
    assert 0.3 < np.mean(np.square(scaled)) < 3.0


def test_without_a_walk_none_is_seen_and_a_bound_is_told(rng) -> None:
    noise = sensor_noise(1e-3 * np.sqrt(RATE) * rng.normal(size=(12_000, 3)), RATE)
    assert not noise.walk.seen
    assert 0.0 < noise.walk.bound < 5e-4
    assert_allclose(noise.white.value, 1e-3, rtol=0.15)


def test_a_walk_too_short_to_see_stays_the_rigs() -> None:
    stamps, gyro, accel = standing(FIBRE, 90.0, 5)
    found = calibrate(stamps, gyro, accel, FIBRE, STILL)
    assert found.noise_block["gyro_bias_walk"] <= 3.0 * FIBRE.gyro_bias_walk


@pytest.mark.parametrize("seed", range(3))
def test_the_stretch_is_found_between_drives(seed) -> None:
    stamps, gyro, accel = standing(COARSE, 200.0, seed, shaken=True)
    moving = np.r_[0:8000, 24_000:40_000]
    rate, force = driving(200.0, seed)
    gyro[moving] += rate[moving]
    accel[moving] += force[moving]
    found = find_static(stamps, gyro, accel, STILL.gravity)
    assert 7800 <= found.begin <= 9400
    assert 22_600 <= found.end <= 24_200
    assert found.unrest < 1.0


def test_an_even_turn_is_not_rest() -> None:
    stamps, gyro, accel = standing(COARSE, 100.0, 1)
    assert find_static(stamps, gyro + [0.0, 0.0, 0.3], accel, STILL.gravity) is None


def test_a_hole_in_the_stamps_ends_a_stretch() -> None:
    stamps, gyro, accel = standing(COARSE, 100.0, 1)
    stamps = stamps + np.where(np.arange(len(stamps)) > 6100, 500_000_000, 0)
    found = find_static(stamps, gyro, accel, STILL.gravity)
    assert found.begin > 6000


@pytest.mark.parametrize(
    ("seconds", "moving", "message"),
    [
        (40.0, False, r"/imu/data: stands still for 39 s .*of 40 s; record more"),
        (120.0, True, "stands still for .*of 120"),
    ],
)
def test_haste_and_motion_are_refused(seconds, moving, message) -> None:
    stamps, gyro, accel = standing(COARSE, seconds, 2)
    if moving:
        rate, force = driving(seconds, 2)
        gyro, accel = gyro + rate, accel + force
    with pytest.raises(RecordingError, match=message):
        calibrate(stamps, gyro, accel, COARSE, STILL)


def test_a_slow_vibration_that_hides_the_noise_is_told() -> None:
    stamps, gyro, accel = standing(COARSE, 120.0, 6)
    swing = 0.02 * np.sin(2 * np.pi * 0.9 * stamps[:, None] * 1e-9 + np.arange(3))
    with pytest.raises(RecordingError, match="hides the white noise of the accelerometer; record it with the engines"):
        calibrate(stamps, gyro, accel + swing, COARSE, STILL)


@pytest.mark.parametrize("n", [0, 1, 3])
def test_next_to_nothing_is_refused(n) -> None:
    stamps, gyro, accel = standing(COARSE, 1.0, 2)
    with pytest.raises(RecordingError, match="stands still"):
        calibrate(stamps[:n], gyro[:n], accel[:n], COARSE, STILL)


def test_the_turn_on_bias_is_told_from_the_earth() -> None:
    earth = Earth.of(EarthBlock(latitude_deg=37.87))
    stamps, gyro, accel = standing(FIBRE, 120.0, 4, earth=earth)
    with_latitude = calibrate(stamps, gyro, accel, FIBRE, earth).noise_block["gyro_bias_std"]
    without = calibrate(stamps, gyro, accel, FIBRE, STILL).noise_block["gyro_bias_std"]
    assert with_latitude < 5e-6 < 3e-5 < without


def test_gravitys_length_bounds_the_accelerometers_bias_from_below() -> None:
    stamps, gyro, accel = standing(COARSE, 70.0, 4)
    found = calibrate(stamps, gyro, accel + [0.0, 0.0, 0.4], COARSE, STILL)
    assert_allclose(found.noise_block["accel_bias_std"], abs(found.force_error))
    assert found.force_error > 0.3
