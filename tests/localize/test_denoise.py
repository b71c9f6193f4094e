"""The vibration filter: the paper's rules one by one, then tones that go and motion that stays."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from localize.denoise import (
    DenoiseSettings,
    boundary,
    enhance,
    modes_of,
    noise_threshold,
    rectification,
    slow_part,
    soft_threshold,
)
from localize.denoise_online import OnlineDenoiser
from semmap.geometry import so3_exp
from semmap.measurements import ImuSample
from tools.simulator.vibration import oil_pumps, standing_imu

SETTINGS = DenoiseSettings()
EARTH = 7.292115e-5 * np.array([0.0, 0.79, 0.61])


def shaken(seed: int, rate: int, seconds: float, *, noise: float = 0.0, **amplitudes: float):
    """Stamps, then rates and forces with and without the pumps, both with the same white noise."""
    t = np.arange(round(rate * seconds)) / rate
    rng = np.random.default_rng(seed)
    R = so3_exp([0.02, -0.03, rng.uniform(-3.0, 3.0)])
    white = noise * rng.normal(size=(2, len(t), 3)) * np.array([1.0, 30.0])[:, None, None]
    with_pumps = standing_imu(t, R, earth_rate=EARTH, gravity=9.8, vibration=oil_pumps(seed, **amplitudes))
    quiet = standing_imu(t, R, earth_rate=EARTH, gravity=9.8, vibration=None)
    stamps = np.round(t * 1e9).astype(np.int64)
    return stamps, np.array(with_pumps) + white, np.array(quiet) + white


def turn(t: np.ndarray) -> np.ndarray:
    """A start and a stop of 0.2 rad/s with ramps of 0.4 s, round an axis between z and x."""
    rate = 0.2 * np.clip((t - 4.0) / 0.4, 0.0, 1.0) * np.clip((9.0 - t) / 0.4, 0.0, 1.0)
    return rate[:, None] * np.array([0.3, 0.0, 1.0])


def test_modes_sum_up_to_the_signal_fastest_first(rng) -> None:
    t = np.arange(2000) / 200.0
    signal = 0.01 * np.sin(2 * np.pi * 25.0 * t) + 0.05 * np.sin(2 * np.pi * 0.4 * t) + 1e-3 * rng.normal(size=len(t))
    modes = modes_of(signal, sifts=4, count=6)
    assert_allclose(modes.sum(axis=0), signal, atol=1e-15)
    crossings = np.count_nonzero(np.diff(np.signbit(modes), axis=1), axis=1)
    assert (np.diff(crossings) <= 0).all()


@pytest.mark.parametrize("signal", [np.full(300, 9.8), np.zeros(5), np.linspace(0.0, 1.0, 50)])
def test_a_signal_without_oscillation_is_all_rest(signal) -> None:
    assert_allclose(modes_of(signal, sifts=4, count=6)[-1], signal, atol=1e-15)


def test_the_boundary_is_where_two_reconstructions_differ_least(rng) -> None:
    modes = rng.normal(size=(5, 400)) * np.array([3.0, 2.0, 0.5, 1.0, 4.0])[:, None]
    Z = [modes[k:].sum(axis=0) for k in range(5)]
    differences = [np.mean((Z[k + 1] - Z[k]) ** 2) for k in range(4)]
    assert boundary(modes) == int(np.argmin(differences)) == 2


def test_the_threshold_finds_the_sigma_of_white_noise(rng) -> None:
    n = 20000
    assert_allclose(noise_threshold(0.3 * rng.normal(size=n)), 0.3 * np.sqrt(2 * np.log(n)), rtol=0.03)


def test_whole_intervals_shrink_by_their_extremum() -> None:
    mode = np.array([1.0, 4.0, 2.0, -1.0, -2.0, -1.0, 3.0, 3.0])
    # extrema 4, 2 and 3 against 2.5: factors 1.5 / 4, 0 and 0.5 / 3
    expected = np.array([0.375, 1.5, 0.75, 0.0, 0.0, 0.0, 0.5, 0.5])
    assert_allclose(soft_threshold(mode, 2.5), expected)
    assert_array_equal(soft_threshold(mode, 0.0), mode)


def test_the_slow_part_keeps_motion_and_drops_tones() -> None:
    t = np.arange(4000) / 200.0
    slow, tone = np.sin(2 * np.pi * 0.2 * t), np.sin(2 * np.pi * 15.0 * t)
    inner = slice(200, -200)
    assert_allclose(slow_part(slow[:, None], 200.0, 2.0)[inner, 0], slow[inner], atol=0.01)
    assert np.abs(slow_part(tone[:, None], 200.0, 2.0)[inner]).max() < 1e-3
    assert_allclose(slow_part(t[:, None], 200.0, 2.0)[inner, 0], t[inner], atol=1e-9)


@pytest.mark.parametrize(("seed", "rate"), [(0, 200), (1, 475), (2, 200)])
def test_tones_with_harmonics_go(seed, rate) -> None:
    stamps, loud, quiet = shaken(seed, rate, 16.0, noise=2e-4)
    out = enhance(stamps, loud[0], loud[1], SETTINGS)
    inner = slice(rate, -rate)
    for got, before, truth in ((out.gyro, loud[0], quiet[0]), (out.accel, loud[1], quiet[1])):
        still = truth.mean(axis=0)
        assert np.std((got - still)[inner]) < 0.05 * np.std((before - still)[inner])


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_motion_stays(seed) -> None:
    rate = 200
    stamps, loud, _ = shaken(seed, rate, 14.0, noise=2e-4)
    t = stamps * 1e-9
    out = enhance(stamps, loud[0] + turn(t), loud[1], SETTINGS)
    inner = slice(rate, -rate)
    assert_allclose(out.gyro[inner], turn(t)[inner], atol=0.02)
    assert np.sqrt(np.mean((out.gyro - turn(t))[inner] ** 2)) < 2e-3
    # 1 rad of turn, to the noise of the white part and a residue of the tones
    assert_allclose(out.gyro[inner].sum(axis=0) / rate, turn(t)[inner].sum(axis=0) / rate, atol=1.5e-3)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_sudden_start_stays_sharper_than_in_a_low_pass(seed) -> None:
    rate = 200
    stamps, loud, _ = shaken(seed, rate, 10.0, noise=2e-4)
    start = 0.2 * np.clip((stamps * 1e-9 - 5.0) / 0.1, 0.0, 1.0)[:, None] * np.ones(3)
    out = enhance(stamps, loud[0] + start, loud[1], SETTINGS).gyro
    low = slow_part(loud[0] + start, rate, SETTINGS.motion_hz)
    near = slice(940, 1100)
    off, blurred = (np.sqrt(np.mean((signal - start)[near] ** 2)) for signal in (out, low))
    assert off < 0.5 * blurred


def test_without_vibration_nothing_slow_changes(rng) -> None:
    t = np.arange(2400) / 200.0
    gyro = turn(t)
    accel = np.tile([0.1, 0.0, 9.8], (len(t), 1)) + 0.3 * turn(t)
    out = enhance(np.round(t * 1e9).astype(np.int64), gyro, accel, SETTINGS)
    assert np.abs(out.gyro - gyro).max() < 0.01
    assert_allclose(out.gyro.mean(axis=0), gyro.mean(axis=0), atol=1e-5)


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_what_coning_and_sculling_turn_and_push_is_given_back(seed) -> None:
    """The slow part of the rate of a shaking body that does not turn is not zero; with the rectification it is."""
    rate = 475
    _, loud, quiet = shaken(seed, rate, 20.0, gyro_rms=0.03, accel_rms=1.0)
    fast = np.hstack([loud[0] - quiet[0], loud[1] - quiet[1]])
    slow = slow_part(fast, rate, 2.0)
    added = rectification(fast - slow, rate, 2.0)
    inner = slice(rate, -rate)
    before, after = slow[inner].mean(axis=0), (slow + added)[inner].mean(axis=0)
    assert np.linalg.norm(after[:3]) < 0.06 * np.linalg.norm(before[:3])
    assert np.linalg.norm(before[:3]) > 3e-7  # of 5.8e-5 rad/s that tell north
    assert np.linalg.norm(after[3:]) < 0.1 * np.linalg.norm(before[3:]) + 2e-5


def test_a_hole_in_the_stamps_is_not_sifted_across() -> None:
    stamps, loud, _ = shaken(3, 200, 12.0)
    late = stamps + np.where(np.arange(len(stamps)) >= 1200, 5_000_000_000, 0)
    out = enhance(late, loud[0], loud[1], SETTINGS)
    first = enhance(stamps[:1200], loud[0][:1200], loud[1][:1200], SETTINGS)
    assert_array_equal(out.gyro[:1200], first.gyro)


@pytest.mark.parametrize("n", [0, 1, 2, 30])
def test_what_is_too_short_stays_as_it_is(n, rng) -> None:
    gyro, accel = rng.normal(size=(2, n, 3))
    out = enhance(np.arange(n, dtype=np.int64) * 5_000_000, gyro, accel, SETTINGS)
    assert_array_equal(out.gyro, gyro)
    assert_array_equal(out.accel, accel)


def test_two_runs_give_the_same_bytes() -> None:
    stamps, loud, _ = shaken(5, 200, 9.0, noise=1e-3)
    assert (
        enhance(stamps, *loud, SETTINGS).gyro.tobytes() == enhance(stamps.copy(), *loud.copy(), SETTINGS).gyro.tobytes()
    )


def streamed(stamps, gyro, accel):
    """What the online filter gives back, and how old each sample was by then [s]."""
    online, out, ages = OnlineDenoiser(SETTINGS), [], []
    for stamp, w, f in zip(stamps.tolist(), gyro, accel, strict=True):
        done = online.add(ImuSample(stamp, w, f))
        out += done
        ages += [(stamp - sample.stamp_ns) * 1e-9 for sample in done]
    return online, out + online.finish(), ages


@pytest.mark.parametrize("rate", [100, 200, 475])
def test_online_gives_every_sample_back_in_time(rate) -> None:
    stamps, loud, quiet = shaken(1, rate, 10.0, noise=2e-4)
    online, out, ages = streamed(stamps, *loud)
    assert [sample.stamp_ns for sample in out] == stamps.tolist()
    assert max(ages) <= online.latency_s + 1.0 / rate + 1e-6
    gyro = np.array([sample.gyro for sample in out])
    inner = slice(rate, -rate)
    assert np.std((gyro - quiet[0].mean(axis=0))[inner]) < 0.1 * np.std(loud[0][inner])


def test_online_keeps_a_turn() -> None:
    rate = 200
    stamps, loud, _ = shaken(4, rate, 14.0, noise=2e-4)
    t = stamps * 1e-9
    _, out, _ = streamed(stamps, loud[0] + turn(t), loud[1])
    gyro = np.array([sample.gyro for sample in out])
    inner = slice(rate, -rate)
    assert np.sqrt(np.mean((gyro - turn(t))[inner] ** 2)) < 3e-3
    assert_allclose(gyro[inner].sum(axis=0) / rate, turn(t)[inner].sum(axis=0) / rate, atol=3e-3)


def test_online_starts_anew_after_a_hole_and_drops_what_is_late() -> None:
    stamps, loud, _ = shaken(2, 200, 6.0)
    late = stamps + np.where(np.arange(len(stamps)) >= 600, 1_000_000_000, 0)
    late[700] = late[699]
    online, out, _ = streamed(late, *loud)
    assert [sample.stamp_ns for sample in out] == np.delete(late, 700).tolist()
    assert online.dropped == 1
