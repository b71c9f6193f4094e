"""The tunnel of paper 000: a short rough outer tunnel, then a long smooth one in which every metre looks like the last.

The total station's centre is the origin, the tunnel runs along x. Anchors, the robot's start and the end of the UWB's
reach are the paper's (section VI). What the paper leaves open is ours: where the outer tunnel ends, the section, and
that the LiDAR sees 30 m only (dust, dark rock), so that in the middle of the inner tunnel neither end is in sight.
"""

from __future__ import annotations

from semmap.rig import LidarBlock, Rig, UwbBlock, WheelBlock
from tools.simulator.rigs import default_rig
from tools.simulator.roadways import MineScenario, Point, Roadway, Robot
from tools.simulator.settings import MotionSettings

LONG_M = 1000.0
"""[m] of inner tunnel in the long version."""

GATE_X = 20.0
"""[m] where the outer tunnel ends and the inner one begins."""

_START: Point = (11.49, -0.019, 0.0)
_IMU_HEIGHT = 0.971
_BEHIND_X = -14.0
_BEFORE_THE_FACE = 4.0
"""[m] from the inner tunnel's end at which the robot stops."""
_WIDTH, _HEIGHT = 4.6, 3.4


def coal_tunnel(seed: int, *, length: float = 75.0) -> MineScenario:
    """The tunnel with ``length`` [m] of inner tunnel, driven from the paper's start nearly to the face."""
    end = GATE_X + length
    nodes: dict[str, Point] = {
        "behind": (_BEHIND_X, 0.0, 0.0),
        "start": _START,
        "gate": (GATE_X, 0.0, 0.0),
        "stop": (end - _BEFORE_THE_FACE, 0.0, 0.0),
        "face": (end, 0.0, 0.0),
    }
    roadways = (
        Roadway("behind", "start", _WIDTH, _HEIGHT, roughness=0.12),
        Roadway("start", "gate", _WIDTH, _HEIGHT, roughness=0.12),
        Roadway("gate", "stop", _WIDTH, _HEIGHT, roughness=0.0),
        Roadway("stop", "face", _WIDTH, _HEIGHT, roughness=0.0),
    )
    robot = Robot(coal_rig(), MotionSettings(speed=0.3, max_yaw_rate=0.2, height=_IMU_HEIGHT, still_s=4.0))
    name = "coal-tunnel" if length < LONG_M else "coal-tunnel-1km"
    return MineScenario(name, nodes, roadways, ("start", "gate", "stop"), relief=0.0, seed=seed, robot=robot)


def coal_rig() -> Rig:
    """The paper's vehicle: 32 beams, a wheel, and a tag within reach of anchors 100 to 103 up to (34.963, 0, 2.249)."""
    lidar = LidarBlock(
        topic="/lidar/points", beams=32, columns=900, rate_hz=10, fov_deg=(-25.0, 15.0), min_range=0.6, max_range=30.0,
        range_std=0.02, p_imu_lidar=(0.05, 0.0, 0.12),
    )  # fmt: skip
    uwb = UwbBlock(
        topic="/uwb/range", rate_hz=10, range_std=0.06, p_imu_tag=(-0.15, 0.0, 0.25),
        anchors={
            100: (11.376, 1.694, 2.249),
            101: (16.678, 1.769, 2.247),
            102: (16.550, -1.453, 2.224),
            103: (11.510, -1.532, 0.115),
        },
        center=(13.963, 0.0, 2.249), max_range=21.0,
    )  # fmt: skip
    wheel = WheelBlock(topic="/wheel/twist", rate_hz=50, speed_std=0.02, p_imu_wheel=(-0.1, 0.0, -0.8))
    return default_rig().model_copy(update={"lidar": lidar, "uwb": uwb, "wheel": wheel})
