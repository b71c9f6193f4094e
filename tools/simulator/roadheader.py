"""The roadway of paper 002, 25 x 5 x 4 m, and a tracked roadheader in it that shakes.

The total station stands at the entry, its centre is near the origin; the heading is at the other end. The machine
stands with its pumps on, drives forward 4.7 m and back in reverse, forward again through a turn, and back in steps.
"""

from __future__ import annotations

from semmap.rig import EarthBlock, ImuBlock, LidarBlock, Rig, TotalStationBlock
from tools.simulator.roadways import MineScenario, Point, Roadway, Robot
from tools.simulator.settings import MotionSettings

_LENGTH, _WIDTH, _HEIGHT = 25.0, 5.0, 4.0
_ROUGHNESS = 0.03
_IMU_HEIGHT = 1.5
EARTH = EarthBlock(latitude_deg=37.87)
TACTICAL = ImuBlock(
    topic="/imu/data", rate_hz=475, gyro_noise=1.5e-6, accel_noise=3e-4, gyro_bias_walk=1e-9, accel_bias_walk=1e-6,
    gyro_bias_std=2.4e-7, accel_bias_std=5e-4, engines=True,
)  # fmt: skip
"""Fibre-optic: 0.005 °/√h, 0.05 °/h, 50 µg; the paper's rate."""
CONSUMER = ImuBlock(
    topic="/imu/data", rate_hz=200, gyro_noise=3e-4, accel_noise=4e-3, gyro_bias_walk=2e-5, accel_bias_walk=3e-4,
    gyro_bias_std=0.002, accel_bias_std=0.03, engines=True,
)  # fmt: skip
MOTION = MotionSettings(
    speed=0.3, max_accel=0.15, max_yaw_rate=0.15, height=_IMU_HEIGHT, still_s=30.0, corner=0.8, wobble_deg=0.4,
    vibration_accel=0.5, vibration_gyro=0.01, pumps=True,
    schedule=(
        (4.7, 4.0), (0.0, 4.0), (7.2, 4.0), (6.0, 1.5), (4.8, 1.5), (3.6, 1.5), (2.4, 1.5), (1.2, 1.5), (0.0, 3.0),
    ),
)  # fmt: skip


def roadway(seed: int, *, imu: ImuBlock = TACTICAL) -> MineScenario:
    """The roadway with its machine."""
    nodes: dict[str, Point] = {"entry": (-2.0, 0.0, 0.0), "face": (_LENGTH - 2.0, 0.0, 0.0)}
    dug = Roadway("entry", "face", _WIDTH, _HEIGHT, "rectangular", _ROUGHNESS)
    way: tuple[Point, ...] = ((8.0, -0.6, 0.0), (11.0, -0.6, 0.0), (12.8, -0.6, 0.0), (15.2, 0.5, 0.0))
    robot = Robot(roadheader_rig(imu), MOTION)
    return MineScenario(
        "roadway", nodes, (dug,), ("entry", "face"), relief=0.0, texture=(0.8, 3.0), seed=seed, robot=robot, way=way
    )


def roadheader_rig(imu: ImuBlock = TACTICAL) -> Rig:
    """LiDAR above the IMU, and a prism with the paper's lever arm (Eq. 22, forward, left and up) for a TS60."""
    lidar = LidarBlock(
        topic="/lidar/points", beams=16, columns=900, rate_hz=10, fov_deg=(-15.0, 15.0), min_range=0.6, max_range=80.0,
        range_std=0.02, p_imu_lidar=(0.05, 0.0, 0.25),
    )  # fmt: skip
    station = TotalStationBlock(
        topic="/total_station/prism", rate_hz=5, position=(-1.0, 0.5, 1.6), point_std=0.002,
        p_imu_prism=(0.0918, 0.8221, 0.384),
    )  # fmt: skip
    return Rig(frame="map", imu=imu, lidar=lidar, total_station=station, earth=EARTH)
