"""A machine that stands in sight of the total station finds north, once it has stood for long enough."""

import numpy as np
import pytest

from localize.earth import Earth
from localize.settings import DenoiseSettings
from localize.standing import Standing
from semmap.geometry import so3_exp, yaw_of
from semmap.measurements import ImuSample, PrismFix
from tools.simulator.imu import imu_errors
from tools.simulator.roadheader import CONSUMER, TACTICAL, roadheader_rig
from tools.simulator.vibration import oil_pumps, standing_imu

RIG = roadheader_rig(TACTICAL.model_copy(update={"rate_hz": 100.0}))
EARTH = Earth.of(RIG.earth)


def stood(seconds, *, yaw=1.0, seed=0, pumps=False, moves_at=np.inf):
    rng = np.random.default_rng([seed, 8])
    t = np.arange(round(seconds * 100)) / 100.0
    R = so3_exp([0.0, 0.0, yaw]) @ so3_exp([0.01, -0.02, 0.0])
    vibration = oil_pumps(seed, gyro_rms=0.005, accel_rms=0.3) if pumps else None
    gyro, accel = standing_imu(t, R, earth_rate=EARTH.rate, gravity=EARTH.gravity, vibration=vibration)
    errors = imu_errors(RIG.imu, len(t), 100.0, 1.0, rng)
    standing = Standing.of(RIG, DenoiseSettings())
    for k, time in enumerate(t):
        stamp_ns = round(time * 1e9)
        standing.add_sample(ImuSample(stamp_ns, gyro[k] + errors[0][k], accel[k] + errors[1][k]))
        if k % 20 == 0:
            moved = np.array([0.2 * max(0.0, time - moves_at), 0.0, 0.0])
            standing.add_fix(PrismFix(stamp_ns, moved + 0.002 * rng.normal(size=3)))
    return standing


@pytest.mark.parametrize("pumps", [False, True])
@pytest.mark.parametrize("yaw", [-2.5, 0.3])
def test_heading(yaw, pumps):
    found = stood(30.0, yaw=yaw, seed=4, pumps=pumps).alignment()
    assert found is not None
    assert found.heading_std < 0.01
    assert abs(yaw_of(found.R_map_imu) - yaw) < 4.0 * found.heading_std
    assert np.degrees(np.arccos(found.R_map_imu[2] @ so3_exp([0.01, -0.02, 0.0])[2])) < 0.02


def test_it_waits():
    assert stood(15.0).alignment() is None


def test_motion_begins_it_anew():
    standing = stood(35.0, moves_at=30.0)
    assert standing.since_ns > 29e9
    assert standing.alignment() is None


@pytest.mark.parametrize(
    "rig", [roadheader_rig(CONSUMER), RIG.without("prism"), RIG.model_copy(update={"earth": None})]
)
def test_rigs_that_cannot(rig):
    assert Standing.of(rig, DenoiseSettings()) is None
