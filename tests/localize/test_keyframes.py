"""The stack of the last keyframes: seen things lie where they lay, also when ranges, or the first rock after a smooth
drift, move odom under the robot."""

import numpy as np
import pytest

from localize.filter import ErrorStateFilter
from localize.keyframes import Keyframes, stacked
from localize.odometry import Odometry, OdometryPose
from localize.settings import KeyframeSettings, OdometrySettings
from localize.state import ERROR_DIM, NavState
from semmap.geometry import inverse, se3, so3_exp, transform
from tools.simulator import default_rig

WALL = np.random.default_rng(0).uniform(-8.0, 8.0, size=(400, 3))
"""In the frame of a first, undisturbed odom."""
SETTINGS = KeyframeSettings(voxel=0.001)


def state_at(T_odom_imu, g):
    return NavState(
        R=T_odom_imu[:3, :3], p=T_odom_imu[:3, 3], v=np.zeros(3), gyro_bias=np.zeros(3), accel_bias=np.zeros(3), g=g,
        T_imu_lidar=se3(so3_exp([0.0, 0.1, 0.0]), [0.1, 0.0, 0.2]), T_imu_tag=np.eye(4), T_imu_wheel=np.eye(4),
        T_odom_clone=np.eye(4), T_odom_map=np.eye(4), map_centre=np.zeros(3),
    )  # fmt: skip


def seen(true, odom, before, g):
    """A keyframe at the ``true`` pose that odometry has at ``odom``, ``before`` apart from the last one."""
    state = state_at(odom, g)
    points = transform(inverse(true @ state.T_imu_lidar), WALL)
    return OdometryPose(0, state, np.eye(49), points, 0, 0, True, before, np.eye(6), None)


@pytest.mark.parametrize("seed", range(3))
def test_the_stack_survives_odom_being_moved(seed):
    rng = np.random.default_rng(seed)
    keyframes = Keyframes(SETTINGS)
    true, odom, unmoved, g = np.eye(4), np.eye(4), np.eye(4), np.array([0.0, 0.0, -9.81])
    keyframes.add(seen(true, odom, np.eye(4), g), unmoved)
    for number in range(6):
        step = se3(so3_exp(0.1 * rng.normal(size=3)), [1.0, 0.0, 0.0])
        true, odom, unmoved = true @ step, odom @ step, unmoved @ step
        if number in (2, 4):
            # ranges take back metres of sliding, and lean odom by a little
            moved = se3(so3_exp([0.01, -0.02, 0.05]), rng.normal(size=3))
            odom, g = moved @ odom, moved[:3, :3] @ g
        keyframes.add(seen(true, odom, step, g), unmoved)
    stack = stacked(keyframes.last)
    clouds = [np.sort(cloud, axis=0) for cloud in stack.clouds]
    for cloud in clouds[:-1]:
        np.testing.assert_allclose(cloud, clouds[-1], atol=1e-5)
    np.testing.assert_allclose(stack.T_odom_local[:3, 3], unmoved[:3, 3])
    np.testing.assert_allclose(keyframes.last[-1].up_odom, unmoved[:3, :3] @ odom[:3, :3].T @ [0, 0, 1], atol=0.05)


@pytest.mark.parametrize(("moved_m", "is_motion"), [(0.002, True), (16.0, False)])
def test_what_moves_the_last_keyframe_too_is_motion_only_within_the_error_of_the_way(moved_m, is_motion):
    """The first rock after a smooth drift takes back what odometry slid: pose and last keyframe move together."""
    first, step = se3(so3_exp([0.0, 0.0, 0.4]), [5.0, 1.0, 0.0]), se3(so3_exp([0.0, 0.0, 0.1]), [0.8, 0.0, 0.0])
    moved = se3(np.eye(3), [moved_m, 0.0, 0.0])
    state = state_at(moved @ first @ step, np.array([0.0, 0.0, -9.81]))
    state.T_odom_clone = moved @ first
    rig = default_rig()
    start = ErrorStateFilter(state, np.eye(ERROR_DIM), 0, rig.imu)
    engine = Odometry(rig, OdometrySettings(), KeyframeSettings(), start)
    engine._T_odom_keyframe = first
    way = engine._since_keyframe(step, np.diag(np.repeat([0.001, 0.003], 3) ** 2))
    np.testing.assert_allclose(way, inverse(first) @ moved @ first @ step if is_motion else step, atol=1e-12)
