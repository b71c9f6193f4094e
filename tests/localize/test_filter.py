"""The filter against numerical derivatives, plain numpy and its own statistics."""

import numpy as np
from scipy.stats import chi2

from localize._numba_propagation import propagate
from localize.filter import ErrorStateFilter, information, start_covariance
from localize.settings import ExtrinsicSettings
from localize.state import BIASES_FROM, CLONE, ERROR_DIM, GRAVITY, ODOM, POSITION, ROTATION, VELOCITY, NavState
from localize.wheel import _COLUMNS, WheelVelocity
from semmap.geometry import adjoint, inverse, se3, se3_exp, se3_log, so3_exp, so3_log
from semmap.rig import ImuBlock

IMU = ImuBlock(topic="/imu")


def level_state(v=(0.0, 0.0, 0.0)) -> NavState:
    return NavState(
        R=np.eye(3), p=np.zeros(3), v=np.array(v, float), gyro_bias=np.zeros(3), accel_bias=np.zeros(3),
        g=np.array([0.0, 0.0, -9.81]), T_imu_lidar=np.eye(4), T_imu_tag=np.eye(4), T_imu_wheel=np.eye(4),
        T_odom_clone=np.eye(4), T_odom_map=np.eye(4), map_centre=np.zeros(3),
    )  # fmt: skip


def run_propagation(state: NavState, P, t, gyro, accel, densities):
    s, P, n = state.copy(), P.copy(), len(t)
    propagate(
        s.R, s.p, s.v, s.gyro_bias, s.accel_bias, s.g, P, t, gyro, accel, densities,
        np.empty((n, 3, 3)), *(np.empty((n, 3)) for _ in range(4)),
    )  # fmt: skip
    return s, P


def test_boxplus_and_boxminus_are_inverse(state, rng):
    delta = 0.3 * rng.normal(size=ERROR_DIM)
    delta[GRAVITY] = 0.0  # its length is held, so that part is not free
    np.testing.assert_allclose(state.boxplus(delta).boxminus(state), delta, atol=1e-12)


def test_a_tail_moves_along(located, rng):
    """Where odom lies in the map, and the ranges' biases, are in the error as everything before them is."""
    delta = 0.3 * rng.normal(size=located.dim)
    delta[GRAVITY] = 0.0
    assert located.dim == BIASES_FROM + 2
    np.testing.assert_allclose(located.boxplus(delta).boxminus(located), delta, atol=1e-12)


def _in_map(state):
    """The robot's place in the map as the tests of the tail look at it."""
    return state.T_map_odom @ state.T_odom_imu


def _spread(filter, rng, n=4000):
    """Covariance (6, 6) of the robot's turn, in the map's axes, and place over samples of the filter's error."""
    L = np.linalg.cholesky(filter.P + 1e-16 * np.eye(len(filter.P)))
    at = _in_map(filter.state)
    poses = (_in_map(filter.state.boxplus(L @ rng.normal(size=len(L)))) for _ in range(n))
    return np.cov(np.array([np.r_[so3_log(T[:3, :3] @ at[:3, :3].T), T[:3, 3] - at[:3, 3]] for T in poses]).T)


def test_locating_odom_makes_the_robot_as_sure_as_it_was_said_to_be(state, rng):
    """However far odometry had drifted: its error is in where odom lies, the other way round."""
    filter = ErrorStateFilter(state, np.zeros((ERROR_DIM, ERROR_DIM)), 0, IMU)
    filter.P[:6, :6] = np.diag([0.02, 0.03, 0.01, 0.5, 0.2, 0.4]) ** 2
    said = np.diag([0.01, 0.02, 0.01, 0.1, 0.2, 0.3]) ** 2
    filter.locate(se3(so3_exp(rng.normal(size=3)), 10.0 * rng.normal(size=3)), said)
    scale = np.sqrt(np.diag(said))
    np.testing.assert_allclose(_spread(filter, rng) / np.outer(scale, scale), np.eye(6), atol=0.1)
    before = filter.P[ODOM, ODOM].copy()
    filter.state.p += [30.0, 4.0, 1.0]
    spread = _spread(filter, np.random.default_rng(1))
    filter.centre_odom()
    scale = np.sqrt(np.diag(spread))
    again = _spread(filter, np.random.default_rng(1))
    np.testing.assert_allclose(again / np.outer(scale, scale), spread / np.outer(scale, scale), atol=0.1)
    assert filter.P[ODOM, ODOM].trace() > 2.0 * before.trace()


def test_an_anchor_heard_has_a_bias_once(located, rng):
    L = 0.1 * rng.normal(size=(located.dim, located.dim))
    filter = ErrorStateFilter(located, L @ L.T, 0, IMU)
    filter.hear(3, 0.5)
    assert len(filter.P) == located.dim == BIASES_FROM + 2
    filter.hear(9, 0.5)
    assert filter.state.anchors == (7, 3, 9) and len(filter.P) == filter.state.dim
    assert filter.P[-1, -1] == 0.25 and not filter.P[-1, :-1].any()


def test_gravity_keeps_its_length(state, rng):
    moved = state.boxplus(rng.normal(size=ERROR_DIM))
    np.testing.assert_allclose(np.linalg.norm(moved.g), np.linalg.norm(state.g))


def test_covariance_propagation_is_the_jacobian_of_the_motion(state, rng):
    """F of the kernel, read off by propagating P = e eᵀ, equals the numerical derivative of the motion."""
    t = np.array([0.0, 0.005, 0.010])
    gyro, accel = rng.normal(size=(3, 3)), 10.0 * rng.normal(size=(3, 3))
    zero = np.zeros(4)
    end, _ = run_propagation(state, np.zeros((ERROR_DIM, ERROR_DIM)), t, gyro, accel, zero)
    step = 1e-6
    columns = [c for c in range(18) if c not in range(15, 18)]
    for column in columns:
        delta = np.zeros(ERROR_DIM)
        delta[column] = step
        moved, _ = run_propagation(state.boxplus(delta), np.zeros((ERROR_DIM, ERROR_DIM)), t, gyro, accel, zero)
        numeric = moved.boxminus(end) / step
        P = np.zeros((ERROR_DIM, ERROR_DIM))
        P[column, column] = 1.0
        _, P_end = run_propagation(state, P, t, gyro, accel, zero)
        np.testing.assert_allclose(np.outer(numeric, numeric), P_end, atol=5e-4)


def test_constant_rate_and_acceleration_are_integrated_exactly():
    """A body at constant body rate about z, driven in a circle: centripetal specific force, closed after one turn."""
    rate, speed, n = 0.5, 2.0, 4001
    t = np.linspace(0.0, 2 * np.pi / rate, n)
    gyro = np.tile([0.0, 0.0, rate], (n, 1))
    accel = np.tile([0.0, speed * rate, 9.81], (n, 1))
    end, _ = run_propagation(level_state((speed, 0, 0)), np.zeros((ERROR_DIM, ERROR_DIM)), t, gyro, accel, np.zeros(4))
    np.testing.assert_allclose(end.p, 0.0, atol=1e-4)
    np.testing.assert_allclose(end.R, np.eye(3), atol=1e-9)


def test_predicted_covariance_agrees_with_errors():
    """Normalised error squared of dead reckoning over seeds lies in its 95 % bounds."""
    rate, seconds, seeds = 200, 2.0, 60
    n = int(rate * seconds) + 1
    t = np.arange(n) / rate
    gyro_true = np.stack([0.3 * np.sin(t), 0.2 * np.cos(2 * t), 0.5 + 0 * t], axis=1)
    accel_true = np.stack([np.sin(3 * t), np.cos(t), 9.81 + 0.3 * np.sin(5 * t)], axis=1)
    truth, _ = run_propagation(
        level_state((1.0, 0, 0)), np.zeros((ERROR_DIM, ERROR_DIM)), t, gyro_true, accel_true, np.zeros(4)
    )
    squared = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        P = start_covariance(
            IMU, tilt_std=0.01, velocity_std=0.1, g=np.array([0, 0, -9.81]), mountings=ExtrinsicSettings()
        )
        start = level_state((1.0, 0, 0)).boxplus(rng.multivariate_normal(np.zeros(ERROR_DIM), P))
        bias_g, bias_a = rng.normal(size=3) * IMU.gyro_bias_std, rng.normal(size=3) * IMU.accel_bias_std
        start.gyro_bias[:], start.accel_bias[:] = 0.0, 0.0
        gyro = gyro_true + bias_g + rng.normal(size=(n, 3)) * IMU.gyro_noise * np.sqrt(rate)
        accel = accel_true + bias_a + rng.normal(size=(n, 3)) * IMU.accel_noise * np.sqrt(rate)
        filter = ErrorStateFilter(start, P, 0, IMU)
        filter.predict((t * 1e9).astype(np.int64), gyro, accel)
        error = truth.boxminus(filter.state)[:9]
        squared.append(error @ np.linalg.solve(filter.P[:9, :9], error))
    low, high = chi2.ppf([0.025, 0.975], 9 * seeds) / seeds
    assert low < np.mean(squared) < high


class _PositionFix:
    """A sensor of six lines, as a newcomer would write one."""

    def __init__(self, p, std):
        self.p, self.std = p, std

    def linearize(self, state):
        return information(state.p - self.p, np.eye(3), self.std**2 * np.eye(3), np.r_[POSITION])


def test_update_is_the_kalman_update_and_spares_what_is_known():
    P = start_covariance(IMU, tilt_std=0.01, velocity_std=0.5, g=np.array([0, 0, -9.81]), mountings=ExtrinsicSettings())
    P[POSITION, POSITION] = np.diag([1.0, 4.0, 9.0])
    P[POSITION, VELOCITY] = P[VELOCITY, POSITION] = 0.2 * np.eye(3)
    filter = ErrorStateFilter(level_state(), P.copy(), 0, IMU)
    filter.update(_PositionFix(np.array([1.0, -2.0, 3.0]), 0.5), iterations=3)
    K = P[:, POSITION] @ np.linalg.inv(P[POSITION, POSITION] + 0.25 * np.eye(3))
    np.testing.assert_allclose(filter.state.p, K[POSITION] @ [1.0, -2.0, 3.0], atol=1e-9)
    np.testing.assert_allclose(filter.state.v, K[VELOCITY] @ [1.0, -2.0, 3.0], atol=1e-9)
    np.testing.assert_allclose(filter.P, P - K @ P[POSITION], atol=1e-9)
    np.testing.assert_array_equal(filter.state.T_imu_lidar, np.eye(4))


def test_wheel_jacobian(state, rng, check_jacobian):
    model = WheelVelocity(1.3, rng.normal(size=3), np.array([0.02, 0.1, 0.1]))
    check_jacobian(model.residual, model.jacobian(state), state, _COLUMNS)


def test_wheel_residual_of_a_turning_vehicle_is_zero():
    """Lever arm: a wheel 1 m behind the imu of a vehicle that turns about the wheel sees no sideways speed."""
    state = level_state((2.0, 0.5, 0.0))
    state.T_imu_wheel = se3(np.eye(3), [-1.0, 0.0, 0.0])
    model = WheelVelocity(2.0, np.array([0.0, 0.0, 0.5]), np.ones(3))
    np.testing.assert_allclose(model.residual(state), 0.0, atol=1e-12)


def test_covariance_since_clone_matches_samples(state, rng):
    """The linearized covariance of the relative pose equals that of sampled pairs of poses."""
    filter = ErrorStateFilter(state, np.zeros((ERROR_DIM, ERROR_DIM)), 0, IMU)
    L = 0.01 * rng.normal(size=(12, 12))
    index = np.r_[ROTATION, POSITION, CLONE]
    filter.P[np.ix_(index, index)] = L @ L.T
    mean = inverse(state.T_odom_clone) @ state.T_odom_imu
    samples = []
    for _ in range(4000):
        delta = np.zeros(ERROR_DIM)
        delta[index] = L @ rng.normal(size=12)
        moved = state.boxplus(delta)
        samples.append(se3_log(inverse(mean) @ inverse(moved.T_odom_clone) @ moved.T_odom_imu))
    covariance = filter.covariance_since_clone()
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(np.cov(np.array(samples).T) / np.outer(scale, scale),
                               covariance / np.outer(scale, scale), atol=0.08)  # fmt: skip


def test_clone_right_after_cloning_is_exact(state, rng):
    filter = ErrorStateFilter(state, np.zeros((ERROR_DIM, ERROR_DIM)), 0, IMU)
    L = rng.normal(size=(36, 36))
    filter.P[:36, :36] = L @ L.T
    filter.clone_pose()
    np.testing.assert_allclose(filter.covariance_since_clone(), 0.0, atol=1e-9)


def test_deskew_undoes_the_motion():
    """Points seen along a screw motion come out where the lidar at the end sees them."""
    n, rate = 41, 200
    stamps = (np.arange(n) * (1e9 / rate)).astype(np.int64)
    w, f = np.array([0.2, -0.1, 0.7]), np.array([0.4, 0.2, 9.81])
    T_imu_lidar = se3(so3_exp([0.1, 0.2, 0.3]), [0.05, 0.1, 0.12])
    filter = ErrorStateFilter(level_state((2.0, 0, 0)), np.zeros((ERROR_DIM, ERROR_DIM)), 0, IMU)
    track = filter.predict(stamps, np.tile(w, (n, 1)), np.tile(f, (n, 1)))
    rng = np.random.default_rng(3)
    world = rng.normal(size=(40, 3)) * 5
    T_odom_lidar = track.poses[:-1] @ T_imu_lidar
    seen = np.array([inverse(T)[:3, :3] @ p + inverse(T)[:3, 3] for T, p in zip(T_odom_lidar, world, strict=True)])
    out = track.deskew(seen.astype(np.float32), stamps[:-1], 0, T_imu_lidar)
    expected = (inverse(track.poses[-1] @ T_imu_lidar) @ np.c_[world, np.ones(40)].T).T[:, :3]
    np.testing.assert_allclose(out, expected, atol=2e-5)
    assert np.linalg.norm(out - seen, axis=1).max() > 0.3  # there was something to undo


def test_adjoint_convention_of_relative_covariance():
    """Perturbing on the right of T_clone_imu is what gtsam's between factor expects: Exp(ξ) with rotation first."""
    xi = np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0])
    T = se3_exp([0.3, 0.1, -0.4, 2.0, 1.0, 0.5])
    np.testing.assert_allclose(T @ se3_exp(xi), se3_exp(adjoint(T) @ xi) @ T, atol=1e-12)


def test_a_bias_corrects_a_distance_where_it_is_sure(located):
    filter = ErrorStateFilter(located, np.zeros((located.dim, located.dim)), 0, IMU)
    bias = located.bias_of(7)
    np.testing.assert_allclose(filter.true_distance(7, 9.0), (9.0 - bias) / located.range_scale)
    filter.P[BIASES_FROM, BIASES_FROM] = (0.6 * bias) ** 2
    assert filter.true_distance(7, 9.0) == 9.0
    assert filter.true_distance(99, 9.0) == 9.0
