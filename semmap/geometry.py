"""Rotations and rigid transforms: SO(3) and SE(3) as plain arrays.

Rotation vectors perturb on the right, ``R Exp(θ)``. Twists are ``[θ, ρ]``, rotation first, as in gtsam.
All functions accept leading batch dimensions unless they say otherwise.
"""

from __future__ import annotations

from math import acos, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

Array = NDArray[np.float64]

_SMALL_ANGLE_RAD = 1e-4
_SMALL_SINE = 0.02  # four terms of the arcsine are exact to the last bit up to here


def skew(v: ArrayLike) -> Array:
    """Matrix ``[v]x`` with ``[v]x w = v x w``; (..., 3) -> (..., 3, 3)."""
    v = np.asarray(v, dtype=np.float64)
    if v.ndim == 1:
        x, y, z = v.tolist()
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def so3_exp(theta: ArrayLike) -> Array:
    """Rotation matrix of a rotation vector [rad]; (..., 3) -> (..., 3, 3)."""
    theta = np.asarray(theta, dtype=np.float64)
    if theta.ndim == 1:
        return _one_so3_exp(*theta.tolist())
    angle = np.linalg.norm(theta, axis=-1)[..., None, None]
    a = np.sinc(angle / np.pi)
    b = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    K = skew(theta)
    R: Array = np.eye(3) + a * K + b * (K @ K)
    return R


def _one_so3_exp(x: float, y: float, z: float) -> Array:
    """Rodrigues' formula in plain numbers: for a single vector ten times faster than in arrays."""
    angle2 = x * x + y * y + z * z
    angle = sqrt(angle2)
    if angle < _SMALL_ANGLE_RAD:
        a, b = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        a, b = sin(angle) / angle, 2.0 * sin(0.5 * angle) ** 2 / angle2
    return np.array(
        [
            [1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)],
        ]
    )


def so3_log(R: ArrayLike) -> Array:
    """Rotation vector [rad], angle in [0, pi], of a rotation matrix; (..., 3, 3) -> (..., 3)."""
    R = np.asarray(R, dtype=np.float64)
    if R.ndim == 2:
        return _one_so3_log(R)
    axis = 0.5 * np.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1
    )
    sine = np.sqrt(np.sum(axis * axis, axis=-1, keepdims=True))
    if np.all(sine < _SMALL_SINE) and np.all(np.trace(R, axis1=-2, axis2=-1) > 1.0):
        return np.asarray(
            axis * (1.0 + sine * sine * (1.0 / 6.0 + sine * sine * (3.0 / 40.0 + sine * sine * 5.0 / 112.0)))
        )
    flat = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(flat).reshape(R.shape[:-1])


def _one_so3_log(R: Array) -> Array:
    """The same for one matrix (3, 3), small turns in plain numbers."""
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    x, y, z = 0.5 * (h - f), 0.5 * (c - g), 0.5 * (d - b)
    sine2 = x * x + y * y + z * z
    if sine2 >= _SMALL_SINE * _SMALL_SINE or a + e + i <= 1.0:
        return np.asarray(Rotation.from_matrix(R).as_rotvec())
    k = 1.0 + sine2 * (1.0 / 6.0 + sine2 * (3.0 / 40.0 + sine2 * 5.0 / 112.0))
    return np.array([k * x, k * y, k * z])


def so3_left_jacobian(theta: ArrayLike) -> Array:
    """Left Jacobian ``J`` of SO(3), ``Exp(θ + δ) ≈ Exp(J δ) Exp(θ)``; (..., 3) -> (..., 3, 3)."""
    theta = np.asarray(theta, dtype=np.float64)
    if theta.ndim == 1:
        return _one_left_jacobian(*theta.tolist())
    angle = np.linalg.norm(theta, axis=-1)[..., None, None]
    small = angle < _SMALL_ANGLE_RAD
    safe = np.where(small, 1.0, angle)
    b = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    c = np.where(small, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
    K = skew(theta)
    J: Array = np.eye(3) + b * K + c * (K @ K)
    return J


def _one_left_jacobian(x: float, y: float, z: float) -> Array:
    """The same for one vector, in plain numbers."""
    angle2 = x * x + y * y + z * z
    angle = sqrt(angle2)
    if angle < _SMALL_ANGLE_RAD:
        b, c = 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        b, c = 2.0 * sin(0.5 * angle) ** 2 / angle2, (angle - sin(angle)) / (angle2 * angle)
    return np.array(
        [
            [1.0 - c * (y * y + z * z), c * x * y - b * z, c * x * z + b * y],
            [c * x * y + b * z, 1.0 - c * (x * x + z * z), c * y * z - b * x],
            [c * x * z - b * y, c * y * z + b * x, 1.0 - c * (x * x + y * y)],
        ]
    )


def se3(R: ArrayLike, p: ArrayLike) -> Array:
    """Transform (..., 4, 4) from rotation (..., 3, 3) and translation (..., 3)."""
    R, p = np.asarray(R, dtype=np.float64), np.asarray(p, dtype=np.float64)
    if R.ndim == 2 and p.ndim == 1:
        T = np.zeros((4, 4))
        T[:3, :3], T[:3, 3], T[3, 3] = R, p, 1.0
        return T
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], p.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, p, 1.0
    return T


def inverse(T: ArrayLike) -> Array:
    """Inverse of rigid transforms (..., 4, 4)."""
    T = np.asarray(T, dtype=np.float64)
    if T.ndim == 2:
        return se3(T[:3, :3].T, -(T[:3, 3] @ T[:3, :3]))
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    return se3(R_t, -(R_t @ T[..., :3, 3:])[..., 0])


def transform(T: ArrayLike, points: ArrayLike) -> Array:
    """Points (n, 3) taken through one rigid transform (4, 4)."""
    T = np.asarray(T, dtype=np.float64)
    moved: Array = np.asarray(points, dtype=np.float64) @ T[:3, :3].T + T[:3, 3]
    return moved


def se3_exp(xi: ArrayLike) -> Array:
    """Transform of a twist ``[θ, ρ]``; (..., 6) -> (..., 4, 4)."""
    xi = np.asarray(xi, dtype=np.float64)
    theta, rho = xi[..., :3], xi[..., 3:]
    return se3(so3_exp(theta), (so3_left_jacobian(theta) @ rho[..., None])[..., 0])


def se3_log(T: ArrayLike) -> Array:
    """Twist ``[θ, ρ]`` of a transform; (..., 4, 4) -> (..., 6)."""
    T = np.asarray(T, dtype=np.float64)
    theta = so3_log(T[..., :3, :3])
    rho = np.linalg.solve(so3_left_jacobian(theta), T[..., :3, 3:])[..., 0]
    return np.concatenate([theta, rho], axis=-1)


def adjoint(T: ArrayLike) -> Array:
    """Adjoint (..., 6, 6) with ``T Exp(ξ) T⁻¹ = Exp(Ad ξ)`` for twists ``[θ, ρ]``."""
    T = np.asarray(T, dtype=np.float64)
    R = T[..., :3, :3]
    Ad = np.zeros((*T.shape[:-2], 6, 6))
    Ad[..., :3, :3] = Ad[..., 3:, 3:] = R
    Ad[..., 3:, :3] = skew(T[..., :3, 3]) @ R
    return Ad


def rotation_angle(R: ArrayLike) -> Array:
    """Angle [rad] of rotation matrices (..., 3, 3), paper 004 Eq. 9."""
    R = np.asarray(R, dtype=np.float64)
    if R.ndim == 2:
        return np.asarray(acos(min(max(0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0), -1.0), 1.0)))
    trace = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2]
    return np.asarray(np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0)))


def yaw_rotation(yaw: float) -> Array:
    """Rotation (3, 3) about z by ``yaw`` [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def yaw_of(R: ArrayLike) -> float:
    """Heading [rad] of the x axis of one rotation (3, 3) in the horizontal plane."""
    R = np.asarray(R, dtype=np.float64)
    return float(np.arctan2(R[1, 0], R[0, 0]))


def rotation_between(a: ArrayLike, b: ArrayLike) -> Array:
    """Smallest rotation R (3, 3) with ``R a ∥ b`` for two non-zero vectors (3,)."""
    u, v = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    u, v = u / np.linalg.norm(u), v / np.linalg.norm(v)
    axis, cosine = np.cross(u, v), float(u @ v)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        if cosine > 0.0:
            return np.eye(3)
        other = np.cross(u, [1.0, 0.0, 0.0] if abs(u[0]) < 0.9 else [0.0, 1.0, 0.0])
        return so3_exp(np.pi * other / np.linalg.norm(other))
    return so3_exp(axis / sine * np.arctan2(sine, cosine))


def quaternion_xyzw(R: ArrayLike) -> Array:
    """Unit quaternions x y z w (..., 4) of rotation matrices (..., 3, 3), for files only."""
    R = np.asarray(R, dtype=np.float64)
    return np.asarray(Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat()).reshape(*R.shape[:-2], 4)


def rotation_of_quaternion(q_xyzw: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions x y z w (..., 4) of any non-zero length."""
    q = np.asarray(q_xyzw, dtype=np.float64)
    return np.asarray(Rotation.from_quat(q.reshape(-1, 4)).as_matrix()).reshape(*q.shape[:-1], 3, 3)


def interpolate_poses(stamps_ns: NDArray[np.int64], poses: Array, query_ns: NDArray[np.int64]) -> Array:
    """Poses (m, 4, 4) at ``query_ns`` (m,): linear in position, geodesic in rotation.

    That is paper 002, Eq. 27, on the group instead of on matrices.

    ``stamps_ns`` (n,) must increase strictly; queries outside are clamped to the ends.
    """
    if len(stamps_ns) == 1:
        return np.repeat(np.asarray(poses, dtype=np.float64), len(query_ns), axis=0)
    t = (stamps_ns - stamps_ns[0]) * 1e-9
    q = np.clip((query_ns - stamps_ns[0]) * 1e-9, t[0], t[-1])
    R = Slerp(t, Rotation.from_matrix(poses[:, :3, :3]))(q).as_matrix()
    p = np.stack([np.interp(q, t, poses[:, axis, 3]) for axis in range(3)], axis=-1)
    return se3(R, p)
