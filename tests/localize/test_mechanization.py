"""Inertial navigation against motions whose answer is known, and against a fine integration."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from localize.earth import EARTH_RATE, Earth, enu_of_ned, flu_of_frd, normal_gravity
from localize.mechanization import Increments, Navigator
from semmap.geometry import skew, so3_exp, so3_log
from semmap.rig import EarthBlock

STILL = Earth.of(None)
TAIYUAN = EarthBlock(latitude_deg=37.87, grid_bearing_deg=25.0)
WEIGHTLESS = Earth(np.zeros(3), 0.0, np.zeros((3, 3)))


def oracle(R, v, p, increments: Increments, earth: Earth):
    """Paper 002 Eq. 8 to 12 as they stand, for equal intervals, with gravity, Coriolis and the turning frame."""
    dt = np.diff(increments.stamps_ns) * 1e-9
    before_theta, before_v = np.zeros(3), np.zeros(3)
    for k, h in enumerate(dt):
        theta, velocity = increments.angle[k], increments.velocity[k]
        phi = theta + np.cross(before_theta, theta) / 12.0
        force = velocity + 0.5 * np.cross(theta, velocity)
        force = force + (np.cross(before_theta, velocity) + np.cross(before_v, theta)) / 12.0
        turn = so3_exp(-h * earth.navigation_rate(v))
        after = v + so3_exp(-0.5 * h * earth.navigation_rate(v)) @ R @ force + h * earth.acceleration(v)
        R, p, v = turn @ R @ so3_exp(phi), p + 0.5 * h * (v + after), after
        before_theta, before_v = theta, velocity
    return R, v, p


def stamps(n: int, rate: float) -> np.ndarray:
    return np.round(np.arange(n) * 1e9 / rate).astype(np.int64)


def coning(t: np.ndarray, half_angle: float, w: float) -> tuple[np.ndarray, np.ndarray]:
    """Attitude of a rotation vector that goes round at w [rad/s], and the exact integral of its body rate."""
    a = half_angle
    R = so3_exp(a * np.column_stack([np.cos(w * t), np.sin(w * t), 0.0 * t]))
    # body rate: w (-sin a sin wt, sin a cos wt, -2 sin²(a/2))
    integral = np.column_stack([np.sin(a) * np.cos(w * t), np.sin(a) * np.sin(w * t), -2 * np.sin(a / 2) ** 2 * w * t])
    return R, integral


def test_kernel_equals_the_printed_equations(rng) -> None:
    earth = Earth.of(TAIYUAN)
    increments = Increments(stamps(60, 100.0), 0.02 * rng.normal(size=(59, 3)), 0.2 * rng.normal(size=(59, 3)))
    R, v, p = so3_exp(rng.normal(size=3)), rng.normal(size=3), rng.normal(size=3)
    navigator = Navigator(R, v, p, earth)
    track = navigator.run(increments)
    R_true, v_true, p_true = oracle(R, v, p, increments, earth)
    assert_allclose(track.R[-1], R_true, atol=1e-13)
    assert_allclose(track.v[-1], v_true, atol=1e-12)
    assert_allclose(track.p[-1], p_true, atol=1e-12)
    assert_allclose(track.R[0], R)


def test_in_pieces_is_the_same_as_at_once(rng) -> None:
    angle, velocity = 0.02 * rng.normal(size=(2, 40, 3))
    at = stamps(41, 200.0)
    once, pieces = (Navigator(np.eye(3), np.zeros(3), np.zeros(3), STILL) for _ in range(2))
    once.run(Increments(at, angle, velocity))
    for a, b in ((0, 13), (13, 14), (14, 40)):
        pieces.run(Increments(at[a : b + 1], angle[a:b], velocity[a:b]))
    assert_allclose(pieces.R, once.R, atol=1e-15)
    assert_allclose(pieces.p, once.p, atol=1e-15)


@pytest.mark.parametrize(("hz", "rate"), [(25.0, 475.0), (50.0, 475.0), (25.0, 200.0)])
def test_coning_in_closed_form(hz, rate) -> None:
    """A cone of one milliradian drifts by w a²/2 without the term of Eq. 8; with it, by what two intervals leave."""
    a, w, h = 1e-3, 2 * np.pi * hz, 1.0 / rate
    n = round(4.0 * rate)
    t = np.arange(n + 1) * h
    R_true, integral = coning(t, a, w)
    increments = np.diff(integral, axis=0)
    navigator = Navigator(R_true[0], np.zeros(3), np.zeros(3), WEIGHTLESS)
    # the first interval has none before it: begin with the true one
    navigator.run(Increments(stamps(2, rate), increments[:1], np.zeros((1, 3))))
    navigator.R = R_true[1]
    track = navigator.run(Increments(stamps(n, rate), increments[1:], np.zeros((n - 1, 3))))
    off = turned(track.R[-1], R_true[-1])
    plain = R_true[1]
    for step in increments[1:]:
        plain = plain @ so3_exp(step)
    without = turned(plain, R_true[-1])
    # known residues per second: w a²/2 (1 - sinc), and with the term (wh)^4 w a² / 60 of it
    x = w * h
    span = t[-1] - t[1]
    assert_allclose(without, 0.5 * a**2 * w * (1 - np.sin(x) / x) * span, rtol=0.05)
    assert off < 0.3 * x**2 * without
    assert off < 1.5 * a**2 * w * x**4 / 60.0 * span + 1e-9


def rocking(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Rate and specific force of a machine that shakes and turns: nothing commutes."""
    w = 2 * np.pi * 23.0
    rate = np.array([0.3, 0.25, 0.2]) * np.sin(w * t + np.array([0.0, 1.3, 0.4])) + np.array([0.0, 0.02, 0.15])
    force = np.array([3.0, 2.0, 4.0]) * np.cos(w * t + np.array([0.2, 0.9, 0.1])) + np.array([0.2, -0.1, 9.79])
    return rate, force


def fine(R, v, p, earth: Earth, times: list[float]):
    """The continuous equations, integrated from 0 to the last digits: the state at each of the times."""

    def slope(t, x):
        C, velocity = x[:9].reshape(3, 3), x[9:12]
        rate, force = rocking(t)
        turn = C @ skew(rate) - skew(earth.navigation_rate(velocity)) @ C
        return np.concatenate([turn.ravel(), C @ force + earth.acceleration(velocity), velocity])

    start = np.concatenate([R.ravel(), v, p])
    found = solve_ivp(slope, (0.0, times[-1]), start, method="DOP853", rtol=1e-12, atol=1e-13, t_eval=times).y.T
    return [(x[:9].reshape(3, 3), x[9:12], x[12:]) for x in found]


def turned(R_a: np.ndarray, R_b: np.ndarray) -> float:
    """Angle between two attitudes [rad], exact near zero."""
    return float(np.linalg.norm(so3_log(R_a.T @ R_b)))


def after_the_first(R, v, p, earth: Earth, increments: Increments) -> Navigator:
    """A navigator in a given state after the first interval, which it knows."""
    navigator = Navigator(R, v, p, earth)
    navigator.run(Increments(increments.stamps_ns[:2], increments.angle[:1], increments.velocity[:1]))
    navigator.R, navigator.v, navigator.p = R, v, p
    navigator.run(Increments(increments.stamps_ns[1:], increments.angle[1:], increments.velocity[1:]))
    return navigator


def exact_increments(rate: float, seconds: float) -> Increments:
    nodes, weights = np.polynomial.legendre.leggauss(12)
    at = np.arange(round(rate * seconds)) / rate
    angle, velocity = np.zeros((2, len(at), 3))
    for node, weight in zip(nodes, weights, strict=True):
        values = [rocking(t + 0.5 * (1.0 + node) / rate) for t in at]
        angle += 0.5 * weight / rate * np.array([value[0] for value in values])
        velocity += 0.5 * weight / rate * np.array([value[1] for value in values])
    return Increments(stamps(len(at) + 1, rate), angle, velocity)


def without_the_interval_before(R, v, earth: Earth, increments: Increments):
    """Attitude and velocity from the second interval on, by single intervals alone."""
    for k, h in enumerate(np.diff(increments.stamps_ns)[1:] * 1e-9, 1):
        angle, velocity = increments.angle[k], increments.velocity[k]
        after = v + R @ (velocity + 0.5 * np.cross(angle, velocity)) + h * earth.acceleration(v)
        R, v = so3_exp(-h * earth.navigation_rate(v)) @ R @ so3_exp(angle), after
    return R, v


def test_against_a_fine_integration_on_the_turning_earth() -> None:
    earth, seconds, rates = Earth.of(TAIYUAN), 1.0, (950.0, 475.0, 237.5)
    R, v, p = so3_exp([0.02, -0.03, 1.0]), np.array([1.0, 0.5, 0.0]), np.array([10.0, 0.0, 2.0])
    *starts, (R_true, v_true, p_true) = fine(R, v, p, earth, [1.0 / rate for rate in rates] + [seconds])
    errors = []
    for rate, start in zip(rates, starts, strict=True):
        navigator = after_the_first(*start, earth, exact_increments(rate, seconds))
        off = (navigator.v - v_true, navigator.p - p_true)
        errors.append([turned(navigator.R, R_true), *(float(np.linalg.norm(part)) for part in off)])
    without = without_the_interval_before(*starts[1][:2], earth, exact_increments(475.0, seconds))
    # coning and sculling count: without the terms of the interval before it ends ten times as far off
    assert errors[1][0] < 0.1 * turned(without[0], R_true)
    assert errors[1][1] < 0.1 * np.linalg.norm(without[1] - v_true)
    angle, velocity, position = np.array(errors).T
    assert angle[1] < 5e-7
    # Eq. 11 turns the specific force by the first power of the angle: of the second, 2e-7 of 10 m/s² are left
    assert velocity[1] < 5e-6
    assert position[1] < 1e-5  # the trapezoid of Eq. 12
    # at half the rate a method of second order is 4 times as far off, one of fourth order 16 times
    assert angle[2] > 10.0 * angle[1]
    assert velocity[2] > 3.0 * velocity[1]


def test_standing_on_the_turning_earth_stays() -> None:
    earth = Earth.of(TAIYUAN)
    R = so3_exp([0.1, 0.05, -2.0])
    n = 600
    gyro, accel = np.tile(R.T @ earth.rate, (n, 1)), np.tile(R.T @ [0.0, 0.0, earth.gravity], (n, 1))
    navigator = Navigator(R, np.zeros(3), np.zeros(3), earth)
    track = navigator.run(Increments.of_samples(stamps(n, 10.0), gyro, accel))
    assert turned(track.R[-1], R) < 1e-9
    assert np.abs(track.p[-1]).max() < 1e-5


def test_the_navigation_rate_is_the_papers() -> None:
    """In north, east, down it is the vector under Eq. 20."""
    latitude = np.radians(37.87)
    earth = Earth.of(EarthBlock(latitude_deg=37.87))
    v_N, v_E = 3.0, -2.0
    a, e2 = 6_378_137.0, 6.69437999014e-3
    R_N = a / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    R_M = R_N * (1 - e2) / (1 - e2 * np.sin(latitude) ** 2)
    printed = np.array(
        [
            EARTH_RATE * np.cos(latitude) + v_E / R_N,
            -v_N / R_M,
            -EARTH_RATE * np.sin(latitude) - v_E * np.tan(latitude) / R_N,
        ]
    )
    assert_allclose(enu_of_ned(earth.navigation_rate(np.array([v_E, v_N, 0.0]))), printed, rtol=1e-12)


def test_the_grid_turns_the_earth() -> None:
    north_of = {bearing: Earth.of(EarthBlock(latitude_deg=0.0, grid_bearing_deg=bearing)).rate for bearing in (0, 90)}
    assert_allclose(north_of[0] / EARTH_RATE, [0, 1, 0], atol=1e-12)
    assert_allclose(north_of[90] / EARTH_RATE, [-1, 0, 0], atol=1e-12)  # +y points east, +x south


def test_ned_and_frd_are_their_own_inverses(rng) -> None:
    v = rng.normal(size=(4, 3))
    assert_allclose(enu_of_ned(enu_of_ned(v)), v)
    assert_allclose(flu_of_frd(flu_of_frd(v)), v)
    assert_allclose(enu_of_ned([1.0, 2.0, 3.0]), [2.0, 1.0, -3.0])
    assert_allclose(flu_of_frd([1.0, 2.0, 3.0]), [1.0, -2.0, -3.0])


@pytest.mark.parametrize(("latitude_deg", "g"), [(0.0, 9.7803253), (45.0, 9.8061977), (90.0, 9.8321849)])
def test_normal_gravity(latitude_deg, g) -> None:
    assert_allclose(normal_gravity(np.radians(latitude_deg)), g, atol=2e-6)
