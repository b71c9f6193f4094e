"""Mountings that are off by 5 cm and 2 degrees: found where the motion shows them, known to be unknown where not.

    python -m tools.bench.coal_extrinsics --seeds 3

The straight tunnel excites little; the winding `demo` mine, driven with a nod, does. What counts is that the standard
deviation says which is which. LiDAR and wheel; the tag's place needs ranges all round.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table

from localize.odometry import OdometryPose
from localize.settings import ExtrinsicSettings, KeyframeSettings, MountingSettings, OdometrySettings
from localize.start import StartingOdometry
from localize.state import LIDAR, WHEEL
from semmap.geometry import Array, quaternion_xyzw, so3_exp, so3_log
from semmap.rig import Rig
from tools.simulator import Flight, MotionSettings, SimulationSettings, fly, scenario, simulate_measurements
from tools.tables import text_table

OFF_M, OFF_DEG = 0.05, 2.0
MOTIONS = {
    "coal-tunnel": SimulationSettings(duration_s=60.0),
    "demo": SimulationSettings(duration_s=40.0, motion=MotionSettings(speed=1.2, wobble_deg=4.0)),
}


@dataclass(frozen=True, slots=True)
class Mounting:
    """How far off a mounting is at the end [m, deg], and the largest standard deviations stated [m, deg]."""

    mine: str
    seed: int
    sensor: str
    metres: float
    degrees: float
    std_m: float
    std_deg: float
    largest_ratio: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    found = [one for mine in MOTIONS for seed in range(1, options.seeds + 1) for one in mountings(mine, seed)]
    Console(width=120).print(mounting_table(found))


def mountings(mine: str, seed: int) -> Iterator[Mounting]:
    """LiDAR and wheel of one drive, both off at the start and both estimated."""
    flight = fly(scenario(mine, seed), settings=MOTIONS[mine], seed=seed)
    last = _driven(flight, put_off(flight.rig, seed))
    assert flight.rig.lidar is not None and flight.rig.wheel is not None
    for sensor, true, estimate, columns in (
        ("lidar", flight.rig.lidar.T_imu_lidar, last.state.T_imu_lidar, LIDAR),
        ("wheel", flight.rig.wheel.T_imu_wheel, last.state.T_imu_wheel, WHEEL),
    ):
        std = np.sqrt(np.diag(last.covariance)[columns])
        error = np.concatenate([so3_log(true[:3, :3].T @ estimate[:3, :3]), estimate[:3, 3] - true[:3, 3]])
        yield Mounting(
            mine,
            seed,
            sensor,
            float(np.linalg.norm(error[3:])),
            float(np.degrees(np.linalg.norm(error[:3]))),
            float(std[3:].max()),
            float(np.degrees(std[:3].max())),
            float(np.max(np.abs(error) / std)),
        )


def put_off(rig: Rig, seed: int) -> Rig:
    """The rig with LiDAR and wheel moved and turned, each in a random direction."""
    assert rig.lidar is not None and rig.wheel is not None
    rng = np.random.default_rng([seed, 12])
    lidar = _off(rig.lidar.T_imu_lidar, "lidar", rng)
    wheel = _off(rig.wheel.T_imu_wheel, "wheel", rng)
    return rig.model_copy(
        update={"lidar": rig.lidar.model_copy(update=lidar), "wheel": rig.wheel.model_copy(update=wheel)}
    )


def _off(T: Array, sensor: str, rng: np.random.Generator) -> dict[str, tuple[float, ...]]:
    turned, moved = (axis / np.linalg.norm(axis) for axis in rng.normal(size=(2, 3)))
    q = quaternion_xyzw(T[:3, :3] @ so3_exp(np.radians(OFF_DEG) * turned))
    return {f"p_imu_{sensor}": tuple((T[:3, 3] + OFF_M * moved).tolist()), f"q_imu_{sensor}_xyzw": tuple(q.tolist())}


def _driven(flight: Flight, rig: Rig) -> OdometryPose:
    """The last pose of the odometry with a rig that is off."""
    unknown = MountingSettings(rotation_std=np.radians(OFF_DEG), position_std=OFF_M)
    settings = OdometrySettings(extrinsics=ExtrinsicSettings(lidar=unknown, wheel=unknown))
    odometry = StartingOdometry(rig, settings, KeyframeSettings())
    return [pose for m in simulate_measurements(flight) for pose in odometry.add(m)][-1]


def mounting_table(found: list[Mounting]) -> Table:
    """One row a mounting."""
    rows = [
        [one.mine, str(one.seed), one.sensor, f"{one.metres:.3f}", f"{one.std_m:.3f}", f"{one.degrees:.2f}"]
        + [f"{one.std_deg:.2f}", f"{one.largest_ratio:.1f}"]
        for one in found
    ]
    head = ("drive", "seed", "sensor", "off [m]", "sigma [m]", "off [deg]", "sigma [deg]", "most sigmas")
    title = f"Mountings, {OFF_M:g} m and {OFF_DEG:g} deg off at the start; sigma: of the worst axis"
    return text_table(head, rows, title=title, left=3)


if __name__ == "__main__":
    main()
