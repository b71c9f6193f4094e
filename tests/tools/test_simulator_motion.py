"""The motion: its derivatives are exact, its IMU reproduces it, and it stays within its limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from semmap.errors import InputFileError
from semmap.geometry import Array, se3, so3_exp, so3_log
from semmap.rig import STANDARD_GRAVITY
from tools.simulator import MotionSettings, load_route, plan
from tools.simulator.angles import Angles, direction
from tools.simulator.motion import Motion, MotionState
from tools.simulator.route import checked_route, control_points
from tools.simulator.spline import UniformSpline

SHAKEN = MotionSettings(wobble_deg=2.0, vibration_accel=1.5, vibration_gyro=0.1)
GRAVITY = np.array([0.0, 0.0, -STANDARD_GRAVITY])


def demo_motion(settings: MotionSettings | None = None, *, scenario: str = "demo") -> Motion:
    return along(plan(scenario).route_floor(), settings, seed=3)


def along(route: Array, settings: MotionSettings | None = None, seed: int = 0) -> Motion:
    settings = settings or MotionSettings()
    return Motion(control_points(route, settings), settings, seed)


def there_and_back(length: float = 30.0) -> Array:
    return np.array([[0.0, 0.0, 0.0], [length, 0.0, 0.0], [0.0, 0.0, 0.0]])


def differences(motion: Motion, t: Array, h: float) -> tuple[MotionState, MotionState, MotionState]:
    return motion(t - h), motion(t), motion(t + h)


def test_the_spline_keeps_its_ends_and_its_order() -> None:
    rng = np.random.default_rng(0)
    rising = np.cumsum(rng.exponential(size=30))
    straight = UniformSpline(rising, 0.5, ends="straight")
    assert_allclose(straight(np.array([0.0, straight.end])), rising[[0, -1]], atol=1e-9)
    rest = UniformSpline(rising, 0.5, ends="rest")
    assert (np.diff(rest(np.linspace(0.0, rest.end, 500))) > 0.0).all()
    assert_allclose(UniformSpline(np.array([1.0, 3.0]), 1.0, ends="straight")(np.array([0.5])), [2.0])


@pytest.mark.parametrize("order", [1, 2, 3])
def test_spline_derivatives(order: int) -> None:
    spline = UniformSpline(np.random.default_rng(1).normal(size=(40, 3)), 0.5, ends="rest")
    x, h = np.linspace(1.0, 18.0, 50), 1e-5
    assert_allclose(
        spline(x, order), (spline(x + h, order - 1) - spline(x - h, order - 1)) / (2 * h), rtol=1e-5, atol=1e-5
    )


def test_direction_derivatives() -> None:
    t, h = np.linspace(0.1, 3.0, 20), 1e-5

    def xy(t: Array) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
        return (2 + np.cos(t), -np.sin(t), -np.cos(t)), (t**2, 2 * t, np.full_like(t, 2.0))

    angle, rate, acceleration = direction(*xy(t))
    before, after = direction(*xy(t - h)), direction(*xy(t + h))
    assert_allclose(rate, (after[0] - before[0]) / (2 * h), atol=1e-8)
    assert_allclose(acceleration, (after[1] - before[1]) / (2 * h), atol=1e-8)
    assert_allclose(angle, np.arctan2(t**2, 2 + np.cos(t)))


def test_angles_turn_as_roll_pitch_yaw() -> None:
    zero = np.zeros((1, 3))
    nose_down = Angles(np.array([[0.0, 0.3, 0.0]]), zero, zero).rotation()[0]
    assert nose_down[2, 0] < 0.0
    assert_allclose(
        Angles(np.array([[0.1, 0.2, 0.3]]), zero, zero).rotation()[0],
        so3_exp([0, 0, 0.3]) @ so3_exp([0, 0.2, 0]) @ so3_exp([0.1, 0, 0]),
        atol=1e-12,
    )


@pytest.mark.parametrize("settings", [MotionSettings(), SHAKEN], ids=["calm", "shaken"])
@pytest.mark.parametrize("scenario", ["demo", "ramp"])
def test_all_derivatives_agree_with_differences(settings: MotionSettings, scenario: str) -> None:
    motion = demo_motion(settings, scenario=scenario)
    t, h = np.linspace(0.5, motion.duration_s - 0.5, 400), 1e-4
    before, now, after = differences(motion, t, h)
    assert_allclose(now.velocity, (after.position - before.position) / (2 * h), atol=2e-4)
    assert_allclose(now.acceleration, (after.velocity - before.velocity) / (2 * h), atol=3e-3)
    turn = so3_log(np.swapaxes(before.R_map_imu, 1, 2) @ after.R_map_imu) / (2 * h)
    assert_allclose(now.angular_velocity, turn, atol=2e-4)
    assert_allclose(now.angular_acceleration, (after.angular_velocity - before.angular_velocity) / (2 * h), atol=3e-2)


def test_integrating_an_ideal_imu_gives_the_path_to_the_millimetre() -> None:
    # at 400 Hz, because this plain integration errs by 3 mm at 200 Hz and by a quarter of it at twice the rate
    motion, dt = demo_motion(), 1.0 / 400.0
    t = np.arange(10.0, 70.0 + dt / 2, dt)
    state = motion(t)
    gyro, force = state.angular_velocity, state.specific_force()
    R, v, p = state.R_map_imu[0], state.velocity[0], state.position[0]
    for k in range(len(t) - 1):
        R_next = R @ so3_exp(0.5 * (gyro[k] + gyro[k + 1]) * dt)
        a, a_next = R @ force[k] + GRAVITY, R_next @ force[k + 1] + GRAVITY
        p = p + v * dt + (2.0 * a + a_next) * dt**2 / 6.0
        R, v = R_next, v + 0.5 * (a + a_next) * dt
    assert np.linalg.norm(p - state.position[-1]) < 1e-3
    assert np.linalg.norm(so3_log(R.T @ state.R_map_imu[-1])) < 1e-5


def test_it_starts_at_rest_at_the_route_s_start_and_ends_at_rest_at_its_end() -> None:
    motion, route = demo_motion(), plan("demo").route_floor()
    still = motion(np.array([0.0, 0.5, 1.0]))
    assert_allclose(still.velocity, 0.0, atol=1e-12)
    assert_allclose(still.angular_velocity, 0.0, atol=1e-12)
    assert_allclose(np.linalg.norm(still.specific_force(), axis=1), STANDARD_GRAVITY)
    assert_allclose(still.position, np.broadcast_to(route[0] + [0.0, 0.0, 1.3], (3, 3)), atol=1e-6)
    end = motion(np.array([motion.duration_s]))
    assert_allclose(end.velocity, 0.0, atol=1e-9)
    assert_allclose(end.position[0], route[-1] + [0.0, 0.0, 1.3], atol=1e-6)


@pytest.mark.parametrize("scenario", ["demo", "grid", "ramp"])
def test_it_keeps_its_limits(scenario: str) -> None:
    settings = MotionSettings(wobble_deg=0.0)
    motion = demo_motion(settings, scenario=scenario)
    state = motion(np.arange(0.0, motion.duration_s, 0.05))
    speed = np.linalg.norm(state.velocity, axis=1)
    assert speed.max() < 2.0 * 1.005
    assert np.median(speed) > 1.8
    assert np.abs(state.angular_velocity[:, 2]).max() < 1.1 * settings.max_yaw_rate
    assert np.linalg.norm(state.acceleration, axis=1).max() < 1.5


def test_the_body_points_along_the_path_and_its_slope() -> None:
    motion = demo_motion(MotionSettings(wobble_deg=0.0), scenario="ramp")
    state = motion(np.arange(5.0, motion.duration_s - 5.0, 0.5))
    forward = state.velocity / np.linalg.norm(state.velocity, axis=1, keepdims=True)
    assert_allclose(state.R_map_imu[:, :, 0], forward, atol=1e-9)
    assert np.degrees(np.arcsin(forward[:, 2])).max() > 14.0
    level = demo_motion(MotionSettings(wobble_deg=0.0, follow_slope=False), scenario="ramp")
    assert_allclose(level(np.arange(0.0, 200.0)).R_map_imu[:, 2, 2], 1.0)


def test_wobble_and_vibration_have_the_rms_that_is_set() -> None:
    route, t = np.array([[0.0, 0.0, 0.0], [400.0, 0.0, 0.0]]), np.arange(20.0, 180.0, 0.003)
    wobble = along(route, MotionSettings(wobble_deg=2.0), 0)(t)
    assert np.degrees(np.std(np.arctan2(wobble.R_map_imu[:, 2, 1], wobble.R_map_imu[:, 2, 2]))) == pytest.approx(
        2, rel=0.1
    )
    shaken = along(route, MotionSettings(wobble_deg=0.0, vibration_accel=3.0, vibration_gyro=0.2), 0)(t)
    assert_allclose(np.std(shaken.acceleration, axis=0), 3.0, rtol=0.1)
    assert_allclose(np.std(shaken.angular_velocity, axis=0), 0.2, rtol=0.1)


def test_a_route_that_turns_back_makes_a_small_loop() -> None:
    motion = along(there_and_back(), MotionSettings(wobble_deg=0.0), 0)
    state = motion(np.arange(0.0, motion.duration_s, 0.02))
    assert np.abs(state.angular_velocity[:, 2]).max() < 0.7
    assert 29.0 < state.position[:, 0].max() < 30.5
    assert 0.4 < np.ptp(state.position[:, 1]) < 2.0
    assert_allclose(state.position[-1], [0.0, 0.0, 1.3], atol=1e-6)


def test_the_seed_sets_the_wobble() -> None:
    route, t = there_and_back(), np.array([8.0])
    first, again, other = (along(route, MotionSettings(), seed)(t).R_map_imu for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.allclose(first, other)


def test_a_route_far_from_the_origin_loses_nothing() -> None:
    far = np.array([4_512_300.0, 1_234_500.0, -800.0])
    route, t = plan("demo").route_floor(), np.linspace(0.0, 100.0, 200)
    near_state, far_state = (along(r, MotionSettings(), 0)(t) for r in (route, route + far))
    assert_allclose(far_state.position - far, near_state.position, atol=1e-6)
    assert_allclose(far_state.specific_force(), near_state.specific_force(), atol=1e-5)


@pytest.mark.parametrize(
    "text",
    [
        "# x_m,y_m,z_floor_m  (map frame)\n0,0,1\n10,0,1\n",
        "x_m,y_m,z_floor_m\r\n0,0,1\r\n\r\n10,0,1 # the end\r\n",
        "0.0, 0.0, 1.0, note\n0,0,1\n1e1\t0\t1\n",
    ],
)
def test_route_files(tmp_path: Path, text: str) -> None:
    (tmp_path / "route.csv").write_text(text)
    assert_allclose(load_route(tmp_path / "route.csv"), [[0.0, 0.0, 1.0], [10.0, 0.0, 1.0]])


@pytest.mark.parametrize("text", ["x_m,y_m\n0,0\n10,0\n", "0\t0\n0;0 # again\n10;0"])
def test_route_files_without_heights(tmp_path: Path, text: str) -> None:
    (tmp_path / "route.csv").write_text(text)
    assert_allclose(load_route(tmp_path / "route.csv"), [[0.0, 0.0], [10.0, 0.0]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "fewer than two points"),
        ("x,y,z\n1,2,3\n", "fewer than two points"),
        ("1,2,3\n1,2,3\n", "fewer than two points"),
        ("1,2,3\n4,5\n", "line 2: is not three numbers"),
        ("1,2\n4,foo\n", "line 2: is not two numbers"),
        ("1\n2\n", "line 1: is not three numbers"),
        ("x,y,z\n1,2,3\nfoo,5,6\n", "line 3: is not three numbers"),
        ("1,2,3\n4,nan,6\n", "point 1 is not finite"),
    ],
)
def test_bad_route_files_name_the_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "route.csv").write_text(text)
    with pytest.raises(InputFileError, match=message) as caught:
        load_route(tmp_path / "route.csv")
    assert "route.csv" in str(caught.value)


def test_bad_routes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="cannot be read"):
        load_route(tmp_path / "gone.csv")
    with pytest.raises(InputFileError, match="shape"):
        checked_route(np.zeros((4, 4)))
    with pytest.raises(InputFileError, match="steeper than"):
        along(np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 60.0]]), MotionSettings(), 0)


T_IMU_WHEEL = se3(so3_exp([0.02, -0.05, 0.1]), [-0.4, 0.3, -0.8])


def test_a_rolling_wheel_goes_where_it_heads_and_takes_the_imu_along() -> None:
    settings = MotionSettings(wobble_deg=4.0)
    motion = Motion(control_points(plan("ramp").route_floor(), settings), settings, 3, T_IMU_WHEEL)
    t, h = np.linspace(5.0, motion.duration_s - 5.0, 400), 1e-4
    before, now, after = differences(motion, t, h)
    velocity = now.point_velocity(T_IMU_WHEEL[:3, 3]) @ T_IMU_WHEEL[:3, :3]
    assert velocity[:, 0].max() > 1.5
    assert_allclose(velocity[:, 1:], 0.0, atol=1e-9)
    assert_allclose(now.velocity, (after.position - before.position) / (2 * h), atol=2e-4)
    assert_allclose(now.acceleration, (after.velocity - before.velocity) / (2 * h), atol=3e-3)
    turn = so3_log(np.swapaxes(before.R_map_imu, 1, 2) @ after.R_map_imu) / (2 * h)
    assert_allclose(now.angular_velocity, turn, atol=2e-4)
    assert_allclose(now.angular_acceleration, (after.angular_velocity - before.angular_velocity) / (2 * h), atol=3e-2)
    usual = Motion(control_points(plan("ramp").route_floor(), settings), settings, 3)(t)
    assert np.linalg.norm(now.position - usual.position, axis=1).max() < 0.9
    pitch = np.degrees(-np.arcsin(now.of(T_IMU_WHEEL).R_map_imu[:, 2, 0]))
    assert pitch.std() > 2.0
