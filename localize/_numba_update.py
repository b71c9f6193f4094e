"""Kernels of the filter's update: the one system of equations in it, and how a scan moves what it is taken for."""

import numpy as np
from numba import njit


@njit(cache=True)
def solved(P, columns, A, rhs):
    """``(I + P A)⁻¹ rhs`` (n, k) for A (m, m) that has only ``columns`` (m,) of P (n, n): a system of m."""
    n, m = len(P), len(columns)
    PA, small, right = np.empty((n, m)), np.empty((m, m)), np.empty((m, rhs.shape[1]))
    for i in range(n):
        for j in range(m):
            PA[i, j] = P[i, columns[j]]
    PA = np.dot(PA, A)
    for i in range(m):
        small[i] = PA[columns[i]]
        small[i, i] += 1.0
        right[i] = rhs[columns[i]]
    return rhs - np.dot(PA, np.linalg.solve(small, right))


@njit(cache=True)
def columns_of(R, T_imu_lidar, lever, J):
    """Into J (18, 6), which is 0: how rotation and position of the imu in its own axes go over into those of the state.

    Rows: the pose, the LiDAR's place on the robot, and the map's in odom, turned about a centre that the imu is
    ``lever`` (3,) away from.
    """
    R_lidar_imu = np.ascontiguousarray(T_imu_lidar[:3, :3].T)
    x, y, z = T_imu_lidar[0, 3], T_imu_lidar[1, 3], T_imu_lidar[2, 3]
    mounted = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    x, y, z = lever[0], lever[1], lever[2]
    turned = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    J[:3, :3] = np.eye(3)
    J[3:6, 3:] = R
    J[6:9, :3] = R_lidar_imu
    J[6:9, 3:] = -R_lidar_imu @ mounted
    J[9:12, 3:] = np.eye(3)
    J[12:15, :3] = -R
    J[12:15, 3:] = -turned @ R
    J[15:18, 3:] = -R
