"""A shaking machine: its IMU reads what its motion says, as strongly as was asked for."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from semmap.geometry import so3_exp, so3_log
from tools.simulator.vibration import oil_pumps, standing_imu

EARTH_RATE = np.array([0.0, 5.8e-5, 4.4e-5])


@pytest.mark.parametrize("seed", range(3))
def test_the_rate_is_that_of_the_attitude(seed) -> None:
    pumps = oil_pumps(seed, gyro_rms=0.5)
    t, step = np.linspace(0.0, 0.5, 40), 1e-6
    R_rest = so3_exp([0.1, -0.2, seed])
    gyro, _ = standing_imu(t, R_rest, earth_rate=EARTH_RATE, gravity=9.8, vibration=pumps)
    before, after = (so3_exp(pumps.angles(t + side * step)[0]) for side in (-1, 1))
    numeric = so3_log(np.swapaxes(before, 1, 2) @ after) / (2 * step)
    R = R_rest @ so3_exp(pumps.angles(t)[0])
    assert_allclose(gyro, numeric + np.einsum("nji,j->ni", R, EARTH_RATE), atol=1e-6)


def test_the_specific_force_leans_with_the_attitude() -> None:
    pumps = oil_pumps(1)
    t = np.linspace(0.0, 0.5, 40)
    R_rest = so3_exp([0.1, -0.2, 1.0])
    _, accel = standing_imu(t, R_rest, earth_rate=EARTH_RATE, gravity=9.8, vibration=pumps)
    turned = so3_exp(pumps.angles(t)[0])
    at_rest = pumps.acceleration(t) + R_rest.T @ [0.0, 0.0, 9.8]
    assert_allclose(np.einsum("nij,nj->ni", turned, accel), at_rest, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_it_shakes_as_strongly_as_asked(seed) -> None:
    t = np.arange(20_000) / 1000.0
    pumps = oil_pumps(seed, gyro_rms=0.02, accel_rms=0.7)
    _, rate = pumps.angles(t)
    assert_allclose(np.sqrt(np.mean(rate**2)), 0.02, rtol=0.02)
    assert_allclose(np.sqrt(np.mean(pumps.acceleration(t) ** 2)), 0.7, rtol=0.02)
    assert_allclose(rate.mean(axis=0), 0.0, atol=1e-4)


def test_at_rest_it_reads_earth_and_gravity() -> None:
    gyro, accel = standing_imu(np.zeros(2), np.eye(3), earth_rate=EARTH_RATE, gravity=9.8, vibration=None)
    assert_allclose(gyro, [EARTH_RATE] * 2)
    assert_allclose(accel, [[0.0, 0.0, 9.8]] * 2)
