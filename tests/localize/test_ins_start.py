"""The start of the INS/total-station filter: its covariance is that of the errors it makes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from localize.earth import Earth
from localize.ins_start import standing_start
from localize.ins_total_station import DIM, POSITION, ROTATION, InsState, prism_jacobian
from localize.static_alignment import align_static
from semmap.geometry import so3_exp, yaw_of
from semmap.measurements import PrismFix
from semmap.rig import EarthBlock, ImuBlock, TotalStationBlock
from tools.simulator.vibration import standing_imu

EARTH = Earth.of(EarthBlock(latitude_deg=37.87))
STATION = TotalStationBlock(topic="/prism", position=(0, 0, 0), p_imu_prism=(0.0918, 0.8221, 0.384), point_std=0.002)
FIBRE = ImuBlock(
    topic="/imu", gyro_noise=1.5e-6, accel_noise=3e-4, gyro_bias_walk=1e-12, accel_bias_walk=1e-9,
    gyro_bias_std=2e-7, accel_bias_std=5e-4,
)  # fmt: skip
COARSE = ImuBlock(
    topic="/imu", gyro_noise=3e-4, accel_noise=4e-3, gyro_bias_walk=1e-9, accel_bias_walk=1e-9,
    gyro_bias_std=5e-3, accel_bias_std=0.03,
)  # fmt: skip
RATE, SECONDS, HEADING_STD = 50.0, 20.0, 0.01


def started(imu: ImuBlock, seed: int):
    """The true state, and the start made of one stretch and one fix; a coarse IMU is told its heading."""
    rng = np.random.default_rng([seed, 11])
    t = np.arange(round(RATE * SECONDS)) / RATE
    R = so3_exp([0.0, 0.0, rng.uniform(-3, 3)]) @ so3_exp([0.05, -0.08, 0.0])
    p = rng.normal(size=3)
    gyro, accel = standing_imu(t, R, earth_rate=EARTH.rate, gravity=EARTH.gravity, vibration=None)
    bias = np.repeat([imu.gyro_bias_std, imu.accel_bias_std], 3) * rng.normal(size=6)
    white = np.sqrt(RATE) * np.repeat([imu.gyro_noise, imu.accel_noise], 3) * rng.normal(size=(len(t), 6))
    gyro, accel = gyro + (bias + white)[:, :3], accel + (bias + white)[:, 3:]
    told = {} if imu is FIBRE else {"heading": yaw_of(R) + HEADING_STD * rng.normal(), "heading_std": HEADING_STD}
    stamps = np.round(t * 1e9).astype(np.int64)
    alignment = align_static(stamps, gyro, accel, imu, EARTH, **told)
    noise = STATION.point_std * rng.normal(size=3)
    fix = PrismFix(int(stamps[-1]), p + R @ STATION.p_imu_prism + noise)
    velocity = 0.005 * rng.normal(size=3)
    truth = InsState(R, p, velocity, bias[:3], bias[3:])
    return truth, *standing_start(alignment, fix, imu, STATION, EARTH)


@pytest.mark.parametrize("imu", [FIBRE, COARSE], ids=["fibre", "coarse"])
def test_errors_agree_with_the_covariance(imu) -> None:
    values = []
    for seed in range(60):
        truth, state, P = started(imu, seed)
        error = truth.boxminus(state)
        parts = {
            name: error[at] @ np.linalg.solve(P[at, at], error[at]) for name, at in (("R", ROTATION), ("p", POSITION))
        }
        values.append([parts["R"] / 3.0, parts["p"] / 3.0, error @ np.linalg.solve(P, error) / DIM])
    rotation, position, whole = np.mean(values, axis=0)
    assert_allclose([rotation, position], 1.0, atol=0.5)
    assert_allclose(whole, 1.0, atol=0.3)  # the weights of the faded mean cost a little of the noise's averaging


def test_the_prism_stays_where_it_was_seen() -> None:
    """However wrong the attitude, the lever arm's end is known to a fix."""
    _, state, P = started(COARSE, 3)
    H = prism_jacobian(state, np.array(STATION.p_imu_prism))
    assert_allclose(H @ P @ H.T, STATION.point_std**2 * np.eye(3), atol=1e-12)
    assert np.trace(P[POSITION, POSITION]) > 5.0 * 3.0 * STATION.point_std**2
