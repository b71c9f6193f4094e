"""The group axioms of SO(3) and SE(3), near the identity and near half a turn as elsewhere."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from semmap.geometry import (
    adjoint,
    interpolate_poses,
    inverse,
    quaternion_xyzw,
    rotation_angle,
    rotation_between,
    rotation_of_quaternion,
    se3,
    se3_exp,
    se3_log,
    skew,
    so3_exp,
    so3_left_jacobian,
    so3_log,
    transform,
    yaw_of,
    yaw_rotation,
)

ANGLES = [0.0, 1e-12, 1e-8, 1e-6, 1e-5, 1e-4, 1e-3, 0.1, 1.0, 3.0, np.pi - 1e-3, np.pi - 1e-6, np.pi - 1e-9]
BATCHES = [(), (1,), (4,), (2, 3), (0,)]


def axes(n: int = 5) -> np.ndarray:
    v = np.random.default_rng(1).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def random_twists(shape: tuple[int, ...], seed: int = 2) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(*shape, 6))


@pytest.mark.parametrize("shape", BATCHES)
def test_every_function_takes_any_batch_shape(shape):
    xi = random_twists(shape)
    T = se3_exp(xi)
    assert T.shape == (*shape, 4, 4)
    assert se3_log(T).shape == (*shape, 6)
    assert inverse(T).shape == (*shape, 4, 4)
    assert adjoint(T).shape == (*shape, 6, 6)
    assert so3_left_jacobian(xi[..., :3]).shape == (*shape, 3, 3)
    assert quaternion_xyzw(T[..., :3, :3]).shape == (*shape, 4)
    assert rotation_of_quaternion(quaternion_xyzw(T[..., :3, :3])).shape == (*shape, 3, 3)
    assert rotation_angle(T[..., :3, :3]).shape == shape


def test_a_batch_is_the_same_as_one_by_one():
    xi = random_twists((2, 3))
    T = se3_exp(xi)
    for k in np.ndindex(2, 3):
        assert_allclose(T[k], se3_exp(xi[k]), rtol=0, atol=1e-15)
        assert_allclose(se3_log(T)[k], se3_log(T[k]), rtol=0, atol=1e-15)
        assert_allclose(adjoint(T)[k], adjoint(T[k]), rtol=0, atol=1e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_so3_exp_is_a_rotation_by_that_angle_about_that_axis(angle):
    for axis in axes():
        R = so3_exp(angle * axis)
        assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-14)
        assert_allclose(R @ axis, axis, atol=1e-14)
        assert rotation_angle(R) == pytest.approx(angle, abs=3e-8)


@pytest.mark.parametrize("angle", ANGLES)
def test_so3_log_undoes_exp(angle):
    theta = angle * axes()
    assert_allclose(so3_log(so3_exp(theta)), theta, atol=1e-8 if angle > 3.0 else 1e-14)


def test_so3_log_of_half_a_turn_is_half_a_turn_about_either_end_of_the_axis():
    for axis in axes():
        theta = so3_log(so3_exp(np.pi * axis))
        assert np.linalg.norm(theta) == pytest.approx(np.pi)
        assert abs(theta @ axis) == pytest.approx(np.pi)


@pytest.mark.parametrize("scale", [1e-9, 1e-5, 1e-3, 1.0])
def test_se3_axioms(scale):
    A, B, C = (se3_exp(scale * random_twists((), seed)) for seed in (3, 4, 5))
    assert_allclose((A @ B) @ C, A @ (B @ C), atol=1e-13)
    assert_allclose(A @ np.eye(4), A)
    assert_allclose(A @ inverse(A), np.eye(4), atol=1e-14)
    assert_allclose(inverse(A) @ A, np.eye(4), atol=1e-14)
    assert_allclose(inverse(A @ B), inverse(B) @ inverse(A), atol=1e-14)


@pytest.mark.parametrize("angle", ANGLES)
def test_se3_log_undoes_exp(angle):
    for axis in axes():
        xi = np.concatenate([angle * axis, [10.0, -20.0, 5.0]])
        assert_allclose(se3_log(se3_exp(xi)), xi, atol=1e-6 if angle > 3.0 else 1e-11)


def test_se3_exp_is_the_flow_of_its_twist():
    xi = random_twists(())
    assert_allclose(se3_exp(0.3 * xi) @ se3_exp(0.7 * xi), se3_exp(xi), atol=1e-14)
    assert_allclose(np.linalg.matrix_power(se3_exp(xi / 64), 64), se3_exp(xi), atol=1e-13)


def test_adjoint_moves_a_twist_across():
    T, xi = se3_exp(random_twists((), 6)), random_twists((), 7)
    assert_allclose(T @ se3_exp(xi) @ inverse(T), se3_exp(adjoint(T) @ xi), atol=1e-13)


def test_adjoint_is_a_homomorphism():
    A, B = se3_exp(random_twists((2,)))
    assert_allclose(adjoint(A @ B), adjoint(A) @ adjoint(B), atol=1e-13)
    assert_allclose(adjoint(inverse(A)), np.linalg.inv(adjoint(A)), atol=1e-13)


@pytest.mark.parametrize("angle", [0.0, 1e-7, 1e-5, 9e-5, 1.1e-4, 1e-2, 1.0, 3.0])
def test_left_jacobian_is_the_derivative_of_exp(angle):
    theta = angle * axes(1)[0]
    step = 1e-6
    columns = [so3_log(so3_exp(theta + step * e) @ so3_exp(theta - step * e).T) / (2 * step) for e in np.eye(3)]
    assert_allclose(so3_left_jacobian(theta), np.stack(columns, axis=1), atol=2e-9)


def test_skew_is_the_cross_product():
    v, w = np.random.default_rng(0).normal(size=(2, 5, 3))
    assert_allclose((skew(v) @ w[..., None])[..., 0], np.cross(v, w))


def test_transform_agrees_with_the_matrix():
    T = se3_exp(random_twists(()))
    points = np.random.default_rng(0).normal(size=(7, 3))
    homogeneous = np.c_[points, np.ones(7)] @ T.T
    assert_allclose(transform(T, points), homogeneous[:, :3])
    assert_allclose(transform(inverse(T), transform(T, points)), points, atol=1e-14)


def test_se3_broadcasts_one_rotation_over_many_points():
    T = se3(np.eye(3), np.zeros((5, 3)))
    assert T.shape == (5, 4, 4)


@pytest.mark.parametrize("a", [[1, 0, 0], [0, 0, -2], [0.3, -5, 1]])
@pytest.mark.parametrize("b", [[1, 0, 0], [-1, 0, 0], [0, 0, 9.81], [0, 1e-9, 1], [-0.3, 5, -1]])
def test_rotation_between_turns_a_onto_b_the_short_way(a, b):
    u, v = np.array(a, float), np.array(b, float)
    u, v = u / np.linalg.norm(u), v / np.linalg.norm(v)
    R = rotation_between(a, b)
    assert_allclose(R @ u, v, atol=1e-12)
    assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert rotation_angle(R) == pytest.approx(np.arccos(np.clip(u @ v, -1, 1)), abs=1e-7)


@pytest.mark.parametrize("yaw", [-3.0, -0.5, 0.0, 0.1, 3.1])
def test_yaw(yaw):
    assert yaw_of(yaw_rotation(yaw)) == pytest.approx(yaw)
    assert_allclose(yaw_rotation(yaw), so3_exp([0, 0, yaw]), atol=1e-15)


def test_quaternions_are_x_y_z_w_of_unit_length():
    assert_allclose(quaternion_xyzw(yaw_rotation(np.pi / 2)), [0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    assert_allclose(rotation_of_quaternion([0, 0, 3, 3]), yaw_rotation(np.pi / 2), atol=1e-15)


class TestInterpolation:
    stamps = np.array([0, 1, 4], np.int64) * 1_000_000_000 + 1_700_000_000_000_000_000

    def poses(self):
        return se3_exp(np.array([[0, 0, 0, 0, 0, 0], [0, 0, 1.0, 2, 0, 0], [0.5, 0, 1.0, 2, 3, 0]]))

    def test_it_returns_the_poses_at_their_own_stamps(self):
        assert_allclose(interpolate_poses(self.stamps, self.poses(), self.stamps), self.poses(), atol=1e-12)

    def test_halfway_it_has_half_the_angle_and_half_the_way(self):
        middle = interpolate_poses(self.stamps, self.poses(), self.stamps[:1] + 500_000_000)[0]
        assert_allclose(so3_log(middle[:3, :3]), [0, 0, 0.5], atol=1e-12)
        assert_allclose(middle[:3, 3], 0.5 * self.poses()[:2, :3, 3].sum(axis=0))

    def test_angular_speed_is_constant_between_poses(self):
        query = self.stamps[1] + np.arange(0, 3_000_000_001, 500_000_000)
        R = interpolate_poses(self.stamps, self.poses(), query)[:, :3, :3]
        assert np.ptp(rotation_angle(np.swapaxes(R[:-1], 1, 2) @ R[1:])) < 1e-7

    def test_outside_it_stays_at_the_ends(self):
        ends = interpolate_poses(self.stamps, self.poses(), self.stamps[[0, -1]] + [-(10**12), 10**12])
        assert_allclose(ends, self.poses()[[0, -1]], atol=1e-12)

    def test_a_change_of_frame_commutes_with_it(self):
        T = se3_exp(random_twists(()))
        query = self.stamps[0] + np.array([300_000_000, 2_000_000_000])
        moved = interpolate_poses(self.stamps, T @ self.poses(), query)
        assert_allclose(moved, T @ interpolate_poses(self.stamps, self.poses(), query), atol=1e-12)

    def test_one_pose_is_everywhere(self):
        out = interpolate_poses(self.stamps[:1], self.poses()[1:2], self.stamps)
        assert_allclose(out, np.repeat(self.poses()[1:2], 3, axis=0))
