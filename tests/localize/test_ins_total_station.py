"""The INS/total-station filter: matrices numerically, errors against the covariance, fixes that lie or fail."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose

from localize.earth import Earth
from localize.ins_total_station import (
    ACCEL_BIAS,
    DIM,
    GYRO_BIAS,
    POSITION,
    ROTATION,
    VELOCITY,
    InsState,
    InsTotalStationFilter,
    InsTotalStationSettings,
    error_rates,
    noise_rates,
    prism_jacobian,
    transition,
)
from semmap.errors import MeasurementError
from semmap.geometry import so3_exp
from semmap.measurements import PrismFix
from semmap.rig import EarthBlock, ImuBlock, TotalStationBlock
from tools.simulator.angles import Angles

EARTH = Earth.of(EarthBlock(latitude_deg=37.87))
LEVER = (0.0918, 0.8221, 0.384)
"""The paper's, forward, left, up [m]."""
STATION = TotalStationBlock(topic="/prism", position=(0, 0, 0), p_imu_prism=LEVER, point_std=0.002, time_offset_std=0)
IMU = ImuBlock(
    topic="/imu", gyro_noise=1e-4, accel_noise=1e-3, gyro_bias_walk=2e-6, accel_bias_walk=5e-5,
    gyro_bias_std=5e-4, accel_bias_std=0.01,
)  # fmt: skip
SETTINGS = InsTotalStationSettings(bias_time_s=200.0)
RATE = 100
START_STD = np.repeat([0.005, 0.002, 0.01, IMU.gyro_bias_std, IMU.accel_bias_std], 3)


def random_ins(rng) -> InsState:
    return InsState(so3_exp(rng.normal(size=3)), *(scale * rng.normal(size=3) for scale in (5.0, 1.0, 0.01, 0.1)))


def derivative(f, state: InsState) -> np.ndarray:
    """Central differences of a vector by the 15 errors."""
    step = 1e-6
    columns = []
    for k in range(DIM):
        delta = step * np.eye(DIM)[k]
        columns.append((f(state.boxplus(delta)) - f(state.boxplus(-delta))) / (2 * step))
    return np.column_stack(columns)


def test_the_error_is_one_of_the_state(rng) -> None:
    state, delta = random_ins(rng), 0.1 * rng.normal(size=DIM)
    assert_allclose(state.boxplus(delta).boxminus(state), delta, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_the_prism_jacobian_numerically(seed) -> None:
    rng = np.random.default_rng(seed)
    state, lever = random_ins(rng), rng.normal(size=3)
    numeric = derivative(lambda s: s.p + s.R @ lever, state)
    assert_allclose(prism_jacobian(state, lever), numeric, atol=1e-8)


def carried(state: InsState, gyro: np.ndarray, accel: np.ndarray, dt: float) -> InsState:
    """The state a short time later, by the continuous equations to the second order."""
    rate, force = gyro - state.gyro_bias, accel - state.accel_bias
    turn = so3_exp(-dt * EARTH.navigation_rate(state.v))
    middle = so3_exp(-0.5 * dt * EARTH.navigation_rate(state.v)) @ state.R @ so3_exp(0.5 * dt * rate)
    v = state.v + dt * (middle @ force + EARTH.acceleration(state.v))
    decay = np.exp(-dt / SETTINGS.bias_time_s)
    return InsState(
        turn @ state.R @ so3_exp(dt * rate), state.p + 0.5 * dt * (state.v + v), v,
        decay * state.gyro_bias, decay * state.accel_bias,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
def test_the_transition_numerically(seed) -> None:
    rng = np.random.default_rng(seed)
    state, dt = random_ins(rng), 1e-3
    gyro, accel = rng.normal(size=3), 10.0 * rng.normal(size=3)
    after = carried(state, gyro, accel, dt)
    numeric = derivative(lambda s: carried(s, gyro, accel, dt).boxminus(after), state)
    sensed = gyro - state.gyro_bias, accel - state.accel_bias, EARTH, SETTINGS.bias_time_s
    # per second; what the velocity does to the transport rate, 1.6e-7, is left out
    assert_allclose((numeric - np.eye(DIM)) / dt, (transition(state, *sensed, dt) - np.eye(DIM)) / dt, atol=1e-5)
    assert_allclose((numeric - np.eye(DIM)) / dt, error_rates(state, *sensed), atol=0.02)


@dataclass
class Drive:
    """A roadheader that goes 4.7 m forward and back, swings about, and rolls over its floor."""

    stamps: np.ndarray
    R: np.ndarray
    p: np.ndarray
    v: np.ndarray
    rate: np.ndarray
    force: np.ndarray

    @classmethod
    def of(cls, seconds: float) -> Drive:
        t = np.arange(round(seconds * RATE) + 1) / RATE
        w = 2 * np.pi * np.array([1 / 30.0, 1 / 17.0, 1 / 11.0])
        size = np.array([2.35, 0.6, 0.03])
        p, v = size * (1 - np.cos(w * t[:, None])), size * w * np.sin(w * t[:, None])
        a = size * w**2 * np.cos(w * t[:, None])
        turn, spin = np.array([0.02, 0.03, 0.5]), 2 * np.pi * np.array([1 / 5.0, 1 / 7.0, 1 / 20.0])
        phase = spin * t[:, None]
        angles = Angles(turn * np.sin(phase), turn * spin * np.cos(phase), -turn * spin**2 * np.sin(phase))
        R = angles.rotation()
        rate = angles.angular_velocity() + np.einsum("nji,j->ni", R, EARTH.rate)
        force = a - np.array([EARTH.acceleration(x) for x in v])
        return cls(np.round(t * 1e9).astype(np.int64), R, p, v, rate, np.einsum("nji,nj->ni", R, force))

    def state(self, k: int, biases: np.ndarray) -> InsState:
        return InsState(self.R[k], self.p[k], self.v[k], biases[k, :3], biases[k, 3:])

    def fix(self, k: int, noise: np.ndarray) -> PrismFix:
        return PrismFix(int(self.stamps[k]), self.p[k] + self.R[k] @ LEVER + noise)


DRIVE = Drive.of(40.0)


def markov(rng, start: np.ndarray, walk: np.ndarray, n: int) -> np.ndarray:
    """Biases (n, 6): Markov processes that begin at ``start`` and tend back to it."""
    biases, decay = np.empty((n, 6)), np.exp(-1.0 / RATE / SETTINGS.bias_time_s)
    biases[0] = start
    for k in range(1, n):
        biases[k] = start + decay * (biases[k - 1] - start) + walk / np.sqrt(RATE) * rng.normal(size=6)
    return biases


class Run:
    """One drive with noisy sensors and a wrong start; ``filter`` goes along."""

    def __init__(self, seed: int, *, noise: float = 1.0) -> None:
        self.rng, n = np.random.default_rng([seed, 3]), len(DRIVE.stamps)
        walk = np.repeat([IMU.gyro_bias_walk, IMU.accel_bias_walk], 3)
        white = np.sqrt(RATE) * np.repeat([IMU.gyro_noise, IMU.accel_noise], 3)
        # the filter knows the biases they tend back to only as well as the alignment told: here, well
        self.biases = markov(self.rng, noise * 0.01 * self.rng.normal(size=6), noise * walk, n)
        errors = self.biases + noise * white * self.rng.normal(size=(n, 6))
        self.gyro, self.accel = DRIVE.rate + errors[:, :3], DRIVE.force + errors[:, 3:]
        start_std = noise * START_STD
        start_std[9:] *= 0.01
        begin = DRIVE.state(0, self.biases).boxplus(start_std * self.rng.normal(size=DIM))
        P = np.diag(np.maximum(start_std, 1e-9) ** 2)
        self.filter = InsTotalStationFilter(begin, P, 0, IMU, STATION, EARTH, SETTINGS)
        self.noise = noise

    def go(self, k: int, to: int) -> None:
        self.filter.predict(DRIVE.stamps[k : to + 1], self.gyro[k : to + 1], self.accel[k : to + 1])

    def drive(self, *, every: int = 20, hidden=lambda k: False, outlier=lambda k: False):
        """By sample number, error (15,) and covariance after each fix; ``hidden``, ``outlier`` tell by number."""
        errors = {}
        for k in range(0, len(DRIVE.stamps) - every, every):
            self.go(k, k + every)
            if not hidden(k + every):
                off = np.array([0.3, -0.2, 0.1]) if outlier(k + every) else 0.0
                noise = self.noise * STATION.point_std * self.rng.normal(size=3)
                self.filter.update(DRIVE.fix(k + every, noise + off))
            errors[k + every] = (DRIVE.state(k + every, self.biases).boxminus(self.filter.state), self.filter.P)
        return errors


def test_perfect_sensors_stay_on_the_track() -> None:
    run = Run(0, noise=0.0)
    errors = run.drive(hidden=lambda k: True)
    last, _ = errors[4000]
    assert np.abs(last[ROTATION]).max() < 1e-5
    assert np.abs(last[POSITION]).max() < 5e-3  # 40 s without a fix, at 100 Hz
    assert np.abs(last[VELOCITY]).max() < 5e-4


def test_errors_agree_with_the_covariance() -> None:
    """Twelve runs: the normalised squared error is that of 15 numbers, in sight and after 10 s out of it."""
    scaled = {"seen": [], "hidden": []}
    for seed in range(12):
        hidden = range(2000, 3000)
        errors = Run(seed).drive(hidden=lambda k, hidden=hidden: k in hidden)
        for k in (1800, 2980, 4000):
            error, P = errors[k]
            scaled["hidden" if k in hidden else "seen"].append(float(error @ np.linalg.solve(P, error)))
    for values in scaled.values():
        assert_allclose(np.mean(values) / DIM, 1.0, atol=0.35)


@pytest.mark.parametrize("offset_s", [-0.1, 0.1])
def test_a_clock_that_is_off_is_found_on_the_way(offset_s) -> None:
    run, station = Run(1), STATION.model_copy(update={"time_offset_std": 0.1})
    run.filter = InsTotalStationFilter(run.filter.state, run.filter.P, 0, IMU, station, EARTH, SETTINGS)
    late = round(offset_s * RATE)
    for k in range(0, len(DRIVE.stamps) - 40, 20):
        run.go(k, k + 20)
        of_then = DRIVE.fix(k + 20 + late, STATION.point_std * run.rng.normal(size=3))
        run.filter.update(PrismFix(int(DRIVE.stamps[k + 20]), of_then.p_map))
    error, std = DRIVE.state(k + 20, run.biases).boxminus(run.filter.state), np.sqrt(run.filter.covariance[-1, -1])
    assert abs(run.filter.clock_offset - offset_s) < 0.01 and std < 0.01
    assert np.linalg.norm(error[POSITION]) < 0.02


def test_the_prism_in_sight_holds_the_position() -> None:
    runs = [Run(seed).drive() for seed in range(2)]
    off = [np.linalg.norm(error[POSITION]) for errors in runs for k, (error, _) in errors.items() if k > 1000]
    assert np.sqrt(np.mean(np.square(off))) < 0.005


def test_out_of_sight_the_position_drifts_as_the_covariance_says_and_comes_back() -> None:
    run = Run(2)
    sigma = {}
    for k in range(0, 4000, 20):
        run.go(k, k + 20)
        if k + 20 not in range(1500, 2500):
            run.filter.update(DRIVE.fix(k + 20, 0.002 * run.rng.normal(size=3)))
        sigma[k + 20] = np.sqrt(np.trace(run.filter.P[POSITION, POSITION]))
    assert sigma[2480] > 5.0 * sigma[1480]
    assert sigma[2700] < 1.2 * sigma[1480]
    assert run.filter.refused == 0


@pytest.mark.parametrize("seed", range(3))
def test_outliers_are_refused_and_do_no_harm(seed) -> None:
    run = Run(seed)
    errors = run.drive(outlier=lambda k: k > 500 and k % 300 == 0)
    lies = len([k for k in errors if k > 500 and k % 300 == 0])
    assert lies <= run.filter.refused <= lies + 1  # one good fix of a thousand is refused
    scaled = [error[POSITION] @ np.linalg.solve(P[POSITION, POSITION], error[POSITION]) for error, P in errors.values()]
    assert np.mean(scaled) < 3.0 * 3.0


def test_the_lever_arm_tells_the_heading() -> None:
    """With the prism to one side, swinging about shows the heading, which at rest nothing does."""
    run = Run(5)
    before = run.filter.P[2, 2]
    run.drive()
    assert run.filter.P[2, 2] < 0.4 * before


def test_biases_tend_back_to_those_of_the_start() -> None:
    filter_ = InsTotalStationFilter(
        DRIVE.state(0, np.full((1, 6), 0.01)), np.zeros((DIM, DIM)), 0, IMU, STATION, EARTH, SETTINGS
    )
    filter_.P = np.diag(np.repeat([0.0, 0.0, 0.0, 1e-4, 1e-4], 3))
    filter_.predict(DRIVE.stamps, DRIVE.rate, DRIVE.force)
    assert_allclose(filter_.state.gyro_bias, 0.01)
    stationary = np.square([IMU.gyro_bias_walk, IMU.accel_bias_walk]) * SETTINGS.bias_time_s / 2.0
    left = np.exp(-2.0 * 40.0 / SETTINGS.bias_time_s)
    for part, driven in zip((GYRO_BIAS, ACCEL_BIAS), stationary, strict=True):
        assert_allclose(np.diag(filter_.P[part, part]), 1e-4 * left + driven * (1.0 - left), rtol=1e-3)


def test_the_noise_is_the_rigs() -> None:
    Q = noise_rates(IMU)
    assert_allclose(np.diag(Q)[[0, 3, 6, 9, 12]], [1e-8, 0.0, 1e-6, 4e-12, 2.5e-9])


def test_what_is_out_of_order_is_an_error() -> None:
    run = Run(0)
    with pytest.raises(MeasurementError, match=r"off the filter's time.*predict up to the fix"):
        run.filter.update(DRIVE.fix(10, np.zeros(3)))
    with pytest.raises(MeasurementError, match="begin at the filter's time"):
        run.filter.predict(DRIVE.stamps[5:10], DRIVE.rate[5:10], DRIVE.force[5:10])


def test_two_runs_give_the_same_bytes() -> None:
    first, second = Run(1), Run(1)
    first.drive(), second.drive()
    assert first.filter.P.tobytes() == second.filter.P.tobytes()
