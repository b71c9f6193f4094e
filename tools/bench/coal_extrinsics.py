"""Mountings that are off by 5 cm and 2 degrees: found where the motion shows them, known to be unknown where not.

    python -m tools.bench.coal_extrinsics --seeds 3

The straight tunnel excites little, and its anchors are behind the robot soon; the winding `demo` mine, driven with a
nod and with anchors all along, excites all. What counts is that the standard deviation says which is which. A turn of
the wheel about the way it rolls changes nothing that it could be known by, and is left out; so is any of the tag.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from localize import Localizer, LocalizeSettings
from localize.settings import ExtrinsicSettings, MountingSettings, OdometrySettings
from semmap.geometry import Array, quaternion_xyzw, rotation_of_quaternion, so3_exp, so3_log
from semmap.rig import Rig
from tools.simulator import (
    Flight,
    MotionSettings,
    SimulationSettings,
    default_rig,
    fly,
    scenario,
    simulate_measurements,
    with_uwb_along,
)
from tools.tables import text_table

OFF_M, OFF_DEG = 0.05, 2.0
SENSORS = ("lidar", "tag", "wheel")


@dataclass(frozen=True, slots=True)
class Mounting:
    """How far off a mounting is at the end [m, deg], and the largest standard deviations stated [m, deg].

    largest_ratio : of an error to its standard deviation, over the axes.
    """

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
    parser.add_argument("--mines", default=",".join(DRIVES), help="comma-separated, of " + ", ".join(DRIVES))
    options = parser.parse_args()
    seeds = range(1, options.seeds + 1)
    found = [one for mine in options.mines.split(",") for seed in seeds for one in mountings(mine, seed)]
    Console(width=120).print(mounting_table(found))


def _coal_tunnel(seed: int) -> Flight:
    settings = SimulationSettings(duration_s=60.0, rolling=True)
    return fly(scenario("coal-tunnel", seed), settings=settings, seed=seed)


def _demo(seed: int) -> Flight:
    motion = MotionSettings(speed=1.2, wobble_deg=8.0)
    mine = scenario("demo", seed)
    rig = with_uwb_along(default_rig(), mine, mine.scenario.route_floor())
    return fly(mine, rig=rig, settings=SimulationSettings(duration_s=160.0, rolling=True, motion=motion), seed=seed)


DRIVES: dict[str, Callable[[int], Flight]] = {"coal-tunnel": _coal_tunnel, "demo": _demo}


def mountings(mine: str, seed: int) -> Iterator[Mounting]:
    """LiDAR, tag and wheel of one drive, all off at the start and all estimated."""
    flight = DRIVES[mine](seed)
    found = _driven(flight, put_off(flight.rig, seed))
    for sensor, (p, R) in _places(flight.rig).items():
        estimate = found[sensor]
        turned = so3_log(R.T @ rotation_of_quaternion(estimate["q_xyzw"]))
        error = np.concatenate([turned, np.array(estimate["p"]) - p])
        std = np.array([*estimate["rotation_std"], *estimate["p_std"]])
        first = {"lidar": 0, "wheel": 1, "tag": 3}[sensor]
        yield Mounting(
            mine,
            seed,
            sensor,
            float(np.linalg.norm(error[3:])),
            float(np.degrees(np.linalg.norm(error[first:3]))),
            float(std[3:].max()),
            float(np.degrees(std[first:3].max(initial=0.0))),
            float(np.max(np.abs(error[first:]) / std[first:])),
        )


def _places(rig: Rig) -> dict[str, tuple[Array, Array]]:
    """Place (3,) and attitude (3, 3) on the robot, by sensor."""
    assert rig.lidar is not None and rig.wheel is not None and rig.uwb is not None
    T_lidar, T_wheel = rig.lidar.T_imu_lidar, rig.wheel.T_imu_wheel
    return {
        "lidar": (T_lidar[:3, 3], T_lidar[:3, :3]),
        "tag": (np.array(rig.uwb.p_imu_tag), np.eye(3)),
        "wheel": (T_wheel[:3, 3], T_wheel[:3, :3]),
    }


def put_off(rig: Rig, seed: int) -> Rig:
    """The rig with LiDAR, tag and wheel moved and turned, each in a random direction."""
    rng = np.random.default_rng([seed, 12])
    blocks = {}
    for sensor, (p, R) in _places(rig).items():
        turned, moved = (axis / np.linalg.norm(axis) for axis in rng.normal(size=(2, 3)))
        q = quaternion_xyzw(R @ so3_exp(np.radians(OFF_DEG) * turned))
        off = {f"p_imu_{sensor}": tuple((p + OFF_M * moved).tolist())}
        if sensor != "tag":
            off[f"q_imu_{sensor}_xyzw"] = tuple(q.tolist())
        name = "uwb" if sensor == "tag" else sensor
        blocks[name] = getattr(rig, name).model_copy(update=off)
    return rig.model_copy(update=blocks)


def _driven(flight: Flight, rig: Rig) -> dict[str, dict[str, Any]]:
    """What a run with a rig that is off says of its mountings at the end, by sensor."""
    unknown = MountingSettings(rotation_std=np.radians(OFF_DEG), position_std=OFF_M)
    extrinsics = ExtrinsicSettings(lidar=unknown, tag=MountingSettings(position_std=OFF_M), wheel=unknown)
    localizer = Localizer(rig, None, LocalizeSettings(odometry=OdometrySettings(extrinsics=extrinsics)))
    for measurement in simulate_measurements(flight):
        localizer.add(measurement)
    found: dict[str, dict[str, Any]] = localizer.finish().summary["mountings"]
    return found


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
