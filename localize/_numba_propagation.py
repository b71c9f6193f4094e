"""Kernels of the inertial propagation and of the deskew that follows from it."""

import numpy as np
from numba import njit


@njit(cache=True)
def exp_so3(theta, R):
    """Rotation of a rotation vector into R (3, 3)."""
    x, y, z = theta[0], theta[1], theta[2]
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-12:
        a, b = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        angle = np.sqrt(angle2)
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle2
    R[0, 0] = 1.0 - b * (y * y + z * z)
    R[0, 1] = -a * z + b * x * y
    R[0, 2] = a * y + b * x * z
    R[1, 0] = a * z + b * x * y
    R[1, 1] = 1.0 - b * (x * x + z * z)
    R[1, 2] = -a * x + b * y * z
    R[2, 0] = -a * y + b * x * z
    R[2, 1] = a * x + b * y * z
    R[2, 2] = 1.0 - b * (x * x + y * y)


@njit(cache=True)
def propagate(
    R, p, v, gyro_bias, accel_bias, g, P, t, gyro, accel, densities, track_R, track_p, track_v, track_w, track_a
):  # fmt: skip
    """Carry state and covariance over the IMU samples at times t (n,) [s]; R, p, v and P change in place.

    track_* (n, ...) receive the state at each sample, the body rate [rad/s] and the acceleration in odom [m/s²] of
    the interval that begins there: what the deskew interpolates with. densities: squares of gyro noise, accel noise,
    gyro bias walk, accel bias walk.
    """
    n = len(t)
    # only rotation, position and velocity move by themselves; biases and gravity drive them
    F = np.zeros((9, 18))
    for i in range(3):
        F[3 + i, 3 + i] = F[6 + i, 6 + i] = 1.0
    moved = np.empty((9, P.shape[1]))
    dR, half = np.empty((3, 3)), np.empty((3, 3))
    for k in range(n):
        track_R[k], track_p[k], track_v[k] = R, p, v
        if k == n - 1:
            track_w[k] = gyro[k] - gyro_bias
            track_a[k] = R @ (accel[k] - accel_bias) + g
            break
        dt = t[k + 1] - t[k]
        w = 0.5 * (gyro[k] + gyro[k + 1]) - gyro_bias
        f = 0.5 * (accel[k] + accel[k + 1]) - accel_bias
        exp_so3(0.5 * dt * w, half)
        R_mid = R @ half
        a = R_mid @ f + g
        track_w[k], track_a[k] = w, a

        exp_so3(dt * w, dR)
        for i in range(3):
            for j in range(3):
                F[i, j] = dR[j, i]
                F[6 + i, 12 + j] = -dt * R_mid[i, j]
                F[3 + i, 12 + j] = -0.5 * dt * dt * R_mid[i, j]
            F[i, 9 + i] = -dt
            F[3 + i, 6 + i] = F[6 + i, 15 + i] = dt
            F[3 + i, 15 + i] = 0.5 * dt * dt
            # -R [f]x: how a tilt turns the specific force
            F[6 + i, 0] = -dt * (R_mid[i, 1] * f[2] - R_mid[i, 2] * f[1])
            F[6 + i, 1] = -dt * (R_mid[i, 2] * f[0] - R_mid[i, 0] * f[2])
            F[6 + i, 2] = -dt * (R_mid[i, 0] * f[1] - R_mid[i, 1] * f[0])
            for j in range(3):
                F[3 + i, j] = 0.5 * dt * F[6 + i, j]
        np.dot(F, P[:18], moved)
        P[:9, :9] = np.dot(np.ascontiguousarray(moved[:, :18]), F.T)
        P[:9, 9:] = moved[:, 9:]
        P[9:, :9] = moved[:, 9:].T
        for i in range(3):
            P[i, i] += densities[0] * dt
            P[6 + i, 6 + i] += densities[1] * dt
            P[3 + i, 3 + i] += densities[1] * dt**3 / 3.0
            P[3 + i, 6 + i] += densities[1] * dt**2 / 2.0
            P[6 + i, 3 + i] += densities[1] * dt**2 / 2.0
            P[9 + i, 9 + i] += densities[2] * dt
            P[12 + i, 12 + i] += densities[3] * dt

        p += dt * v + 0.5 * dt * dt * a
        v += dt * a
        R[:, :] = R @ dR


@njit(cache=True)
def deskew(points, t_points, t, track_R, track_p, track_v, track_w, track_a, R_imu_lidar, p_imu_lidar, out):
    """Points (n, 3) of the lidar, each at its time [s], as the lidar at the track's last pose would see them.

    Between two samples the turn is small, so its sine and cosine are series; they are exact to 1e-9 up to 0.3 rad.
    """
    last = len(t) - 1
    # rotation, and place, speed and acceleration seen from the lidar at the end, of the imu at each sample
    R_end = np.ascontiguousarray((track_R[last] @ R_imu_lidar).T)
    R, p = np.empty((last + 1, 3, 3)), np.empty((last + 1, 3))
    v, a = np.empty((last + 1, 3)), np.empty((last + 1, 3))
    for k in range(last + 1):
        R[k] = R_end @ track_R[k]
        p[k] = R_end @ (track_p[k] - track_p[last]) - R_imu_lidar.T @ p_imu_lidar
        v[k], a[k] = R_end @ track_v[k], R_end @ track_a[k]
    k = 0
    for i in range(len(points)):
        time = t_points[i]
        while k > 0 and t[k] > time:
            k -= 1
        while k < last and t[k + 1] <= time:
            k += 1
        dt = time - t[k]
        wx, wy, wz = dt * track_w[k, 0], dt * track_w[k, 1], dt * track_w[k, 2]
        angle2 = wx * wx + wy * wy + wz * wz
        if angle2 < 0.09:
            sine = 1.0 - angle2 * (1.0 / 6.0 - angle2 * (1.0 / 120.0 - angle2 / 5040.0))
            cosine = 0.5 - angle2 * (1.0 / 24.0 - angle2 * (1.0 / 720.0 - angle2 / 40320.0))
        else:
            angle = np.sqrt(angle2)
            sine, cosine = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle2
        lx, ly, lz = points[i, 0], points[i, 1], points[i, 2]
        x = R_imu_lidar[0, 0] * lx + R_imu_lidar[0, 1] * ly + R_imu_lidar[0, 2] * lz + p_imu_lidar[0]
        y = R_imu_lidar[1, 0] * lx + R_imu_lidar[1, 1] * ly + R_imu_lidar[1, 2] * lz + p_imu_lidar[1]
        z = R_imu_lidar[2, 0] * lx + R_imu_lidar[2, 1] * ly + R_imu_lidar[2, 2] * lz + p_imu_lidar[2]
        # Rodrigues: q + sine w x q + cosine w x (w x q)
        cx, cy, cz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        x += sine * cx + cosine * (wy * cz - wz * cy)
        y += sine * cy + cosine * (wz * cx - wx * cz)
        z += sine * cz + cosine * (wx * cy - wy * cx)
        for r in range(3):
            out[i, r] = R[k, r, 0] * x + R[k, r, 1] * y + R[k, r, 2] * z + p[k, r] + dt * (v[k, r] + 0.5 * dt * a[k, r])
