"""Mountings that are off: found where the motion shows them, and known to be unknown where it does not."""

from dataclasses import dataclass

import numpy as np
import pytest

from localize import lidar
from localize.filter import ErrorStateFilter, Information, information, start_covariance
from localize.mountings import estimated_mountings
from localize.settings import ExtrinsicSettings, KeyframeSettings, MountingSettings, OdometrySettings
from localize.slip import WheelFusion
from localize.start import StartingOdometry
from localize.state import LIDAR, POSITION, ROTATION, TAG, WHEEL, NavState
from localize.uwb import TagRange
from semmap.geometry import quaternion_xyzw, se3, skew, so3_exp, so3_log
from semmap.measurements import WheelSpeed
from semmap.rig import ImuBlock, WheelBlock
from tools.simulator import MotionSettings, SimulationSettings, fly, scenario, simulate_measurements

IMU = ImuBlock(topic="/imu", gyro_bias_std=0.002, accel_bias_std=0.03)
G = np.array([0.0, 0.0, -9.80665])
RATE, STEP = 200, 20
OFF = MountingSettings(rotation_std=np.radians(2.0), position_std=0.05)
T_IMU_WHEEL = se3(so3_exp([0.02, -0.05, 0.1]), [-0.4, 0.1, -0.5])
P_IMU_TAG = np.array([0.1, -0.2, 0.5])
ANCHORS = {
    k: np.array(p) for k, p in enumerate([[4.0, 5.0, 2.5], [-6.0, 4.0, 0.0], [3.0, -6.0, 3.0], [-4.0, -5.0, 1.0]])
}


class Vehicle:
    """A wheel that rolls along its own x axis while it turns, pitches and rolls; the imu is fixed to it.

    turns : amplitudes (3,) of roll, pitch and heading [rad].
    """

    def __init__(self, turns):
        self.t = np.arange(0.0, 50.0, 1.0 / RATE)
        phase = np.outer(self.t, [0.9, 1.3, 0.7]) + [0.3, 1.1, 0.0]
        angles = np.asarray(turns) * np.sin(phase)
        axes = np.eye(3)
        R = so3_exp(np.outer(angles[:, 2], axes[2])) @ so3_exp(np.outer(angles[:, 1], axes[1]))
        R = R @ so3_exp(np.outer(angles[:, 0], axes[0]))
        speed = 0.8 + 0.5 * np.sin(0.5 * self.t)
        self.speed = speed
        v = R[:, :, 0] * speed[:, None]
        p = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (v[1:] + v[:-1]), axis=0) / RATE])
        self.R = R @ T_IMU_WHEEL[:3, :3].T
        self.p = p - self.R @ T_IMU_WHEEL[:3, 3]
        self.v = np.gradient(self.p, 1.0 / RATE, axis=0)
        self.gyro = so3_log(np.swapaxes(self.R[:-1], 1, 2) @ self.R[1:]) * RATE
        self.force = np.einsum("nji,nj->ni", self.R, np.gradient(self.v, 1.0 / RATE, axis=0) - G)


@dataclass
class Place:
    """Pose of the imu, as the LiDAR gives it in a mine with rough walls."""

    R: np.ndarray
    p: np.ndarray

    def linearize(self, state: NavState) -> Information:
        r = np.concatenate([so3_log(self.R.T @ state.R), state.p - self.p])
        return information(r, np.eye(6), np.diag(np.square([0.001] * 3 + [0.01] * 3)), np.r_[ROTATION, POSITION])


def drive(vehicle, seed, *, wheel=None, ranges=False):
    """The filter at the end of a drive that begins with mountings 5 cm and 2 degrees off."""
    rng = np.random.default_rng([seed, 9])
    turned, moved = (axis / np.linalg.norm(axis) for axis in rng.normal(size=(2, 3)))
    T_off = se3(T_IMU_WHEEL[:3, :3] @ so3_exp(np.radians(2.0) * turned), T_IMU_WHEEL[:3, 3] + 0.05 * moved)
    state = NavState(
        R=vehicle.R[0], p=vehicle.p[0], v=vehicle.v[0], gyro_bias=np.zeros(3), accel_bias=np.zeros(3), g=G,
        T_imu_lidar=np.eye(4), T_imu_tag=se3(np.eye(3), P_IMU_TAG + 0.05 * moved), T_imu_wheel=T_off,
        T_odom_clone=np.eye(4), T_odom_map=np.eye(4), map_centre=np.zeros(3),
    )  # fmt: skip
    mountings = ExtrinsicSettings(tag=OFF, wheel=OFF)
    P = start_covariance(IMU, tilt_std=0.01, velocity_std=0.1, g=G, mountings=mountings)
    filter = ErrorStateFilter(state, P, 0, IMU)
    if ranges:
        filter.locate(np.eye(4), 1e-6 * np.eye(6))
    white = np.repeat([IMU.gyro_noise, IMU.accel_noise], 3) * np.sqrt(RATE)
    readings = np.hstack([np.vstack([vehicle.gyro, vehicle.gyro[-1:]]), vehicle.force])
    readings = readings + white * rng.normal(size=readings.shape)
    fusion = WheelFusion(WheelBlock(topic="/wheel", p_imu_wheel=(0, 0, 0)), OdometrySettings(sideways_std=0.03))
    for k in range(STEP, len(vehicle.t) - 5, STEP):
        rows = slice(k - STEP, k + 1)
        # the rate from one sample to the next is that in the middle between them
        stamps = np.rint(vehicle.t[rows] * 1e9).astype(np.int64)
        filter.predict(stamps, _middle(readings[:, :3])[rows], readings[rows, 3:])
        filter.update(
            Place(vehicle.R[k] @ so3_exp(0.001 * rng.normal(size=3)), vehicle.p[k] + 0.01 * rng.normal(size=3))
        )
        if wheel:
            gyro = _middle(readings[:, :3])[k]
            noise = 0.02 * rng.normal()
            fusion.take(WheelSpeed(int(stamps[-1]), vehicle.speed[k] + noise), gyro, filter)
        if ranges:
            tag = vehicle.p[k] + vehicle.R[k] @ P_IMU_TAG
            anchor = (k // STEP) % len(ANCHORS)
            distance = np.linalg.norm(tag - ANCHORS[anchor]) + 0.06 * rng.normal()
            filter.update(TagRange(anchor, ANCHORS[anchor], distance, 0.06))
    return filter


def _middle(rates):
    return np.vstack([rates[:1], 0.5 * (rates[1:] + rates[:-1])])


@pytest.mark.parametrize("seed", range(2))
def test_the_wheels_place_is_found_by_turns_about_all_axes(seed):
    filter = drive(Vehicle([0.5, 0.5, 1.5]), seed, wheel=True)
    T, std = filter.state.T_imu_wheel, np.sqrt(np.diag(filter.P)[WHEEL])
    turned = so3_log(T_IMU_WHEEL[:3, :3].T @ T[:3, :3])
    # the roll of an axis that speeds lie along shows in nothing but its lever arm
    assert np.degrees(np.linalg.norm(turned[1:])) < 0.3
    assert np.linalg.norm(T[:3, 3] - T_IMU_WHEEL[:3, 3]) < 0.01
    assert std[3:].max() < 0.01 and np.degrees(std[1:3]).max() < 0.3
    error = np.concatenate([turned, T[:3, 3] - T_IMU_WHEEL[:3, 3]])
    assert (np.abs(error) < 4.0 * std).all()


def test_a_straight_drive_leaves_the_wheels_place_unknown():
    filter = drive(Vehicle([0.0, 0.0, 0.0]), 1, wheel=True)
    std = np.sqrt(np.diag(filter.P)[WHEEL])
    assert (std[3:] > 0.045).all() and std[0] > np.radians(1.9)
    assert (np.degrees(std[1:3]) < 0.3).all()  # pitch and heading of the wheel show in a straight drive as well


@pytest.mark.parametrize("seed", range(2))
def test_the_tags_place_is_found_by_turns_and_unknown_without(seed):
    filter = drive(Vehicle([0.5, 0.5, 1.5]), seed, ranges=True)
    off, std = filter.state.T_imu_tag[:3, 3] - P_IMU_TAG, np.sqrt(np.diag(filter.P)[TAG])[3:]
    assert np.linalg.norm(off) < 0.03 and (np.abs(off) < 4.0 * std).all() and std.max() < 0.012


def test_lever_arm_of_a_turning_vehicle():
    """The imu beside the wheel's axis moves with ω x p, and the wheel does not see it."""
    v = Vehicle([0.3, 0.3, 1.0])
    k = 777
    R, rate = v.R[k], 0.5 * (v.gyro[k] + v.gyro[k - 1])
    at_wheel = T_IMU_WHEEL[:3, :3].T @ (R.T @ v.v[k] - skew(T_IMU_WHEEL[:3, 3]) @ rate)
    np.testing.assert_allclose(at_wheel, [v.speed[k], 0.0, 0.0], atol=1e-4)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_lidars_place_is_found_by_turns_about_all_axes(seed):
    """The whole odometry in a mine, the body rocking by 8 degrees."""
    motion = MotionSettings(wobble_deg=8.0)
    settings = SimulationSettings(duration_s=16.0, motion=motion)
    it = fly(scenario("demo", seed=seed), settings=settings, seed=seed)
    T = it.rig.lidar.T_imu_lidar
    rng = np.random.default_rng(seed)
    turned, moved = (axis / np.linalg.norm(axis) for axis in rng.normal(size=(2, 3)))
    q = tuple(quaternion_xyzw(T[:3, :3] @ so3_exp(np.radians(2.0) * turned)))
    off = {"p_imu_lidar": tuple(T[:3, 3] + 0.05 * moved), "q_imu_lidar_xyzw": q}
    rig = it.rig.model_copy(update={"lidar": it.rig.lidar.model_copy(update=off)}).without("wheel")
    odometry = StartingOdometry(rig, OdometrySettings(extrinsics=ExtrinsicSettings(lidar=OFF)), KeyframeSettings())
    last = [pose for m in simulate_measurements(it) for pose in odometry.add(m)][-1]
    found, std = last.state.T_imu_lidar, np.sqrt(np.diag(last.covariance)[LIDAR])
    error = np.concatenate([so3_log(T[:3, :3].T @ found[:3, :3]), found[:3, 3] - T[:3, 3]])
    assert np.degrees(np.linalg.norm(error[:3])) < 0.3 and np.linalg.norm(error[3:]) < 0.01
    assert (np.abs(error) < 5.0 * std).all()
    assert std[3:].max() < 0.01 and np.degrees(std[:3]).max() < 0.3


def test_what_a_scan_was_mapped_with_it_cannot_measure(state, rng):
    """Matched to a map made from the same pose with the same mounting, it says nothing of either."""
    filter = ErrorStateFilter(state, np.zeros((state.dim, state.dim)), 0, IMU)
    L = rng.normal(size=(36, 36))
    filter.P[:36, :36] = L @ L.T
    filter.centre_map()
    filter.extend_map(np.eye(6))
    columns = lidar._COLUMNS
    J = lidar._columns_of(state)
    np.testing.assert_allclose(J.T @ filter.P[np.ix_(columns, columns)] @ J, 0.0, atol=1e-9)


def test_mountings_are_told_as_a_rig_names_them(state, rng):
    L = rng.normal(size=(state.dim, state.dim))
    P = L @ L.T
    found = estimated_mountings(state, P, ExtrinsicSettings(tag=MountingSettings(position_std=0.05), wheel=OFF))
    assert list(found) == ["tag", "wheel"]
    block = WheelBlock(topic="/wheel", p_imu_wheel=found["wheel"]["p"], q_imu_wheel_xyzw=found["wheel"]["q_xyzw"])
    np.testing.assert_allclose(block.T_imu_wheel, state.T_imu_wheel, atol=1e-12)
    np.testing.assert_allclose(found["tag"]["p"], state.T_imu_tag[:3, 3])
    std = np.sqrt(np.diag(P)[TAG])
    np.testing.assert_allclose([*found["tag"]["rotation_std"], *found["tag"]["p_std"]], std)
    assert estimated_mountings(state, P, ExtrinsicSettings()) == {}
