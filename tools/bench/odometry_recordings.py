"""The recordings of the odometry benchmark: mines, sensors and motion, simulated once and cached."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from semmap.errors import SettingsError
from semmap.geometry import Array
from semmap.measurements import ImuSample, Scan
from semmap.rig import LidarBlock, Rig
from tools.bench.odometry_cache import Recorded, RecordedWriter
from tools.simulator import (
    SCENARIOS,
    Mine,
    MineScenario,
    MotionSettings,
    Roadway,
    SensorFaults,
    SimulationSettings,
    default_rig,
    dig,
    fly,
    load_mesh,
    load_route,
    simulate_measurements,
)
from tools.simulator.flight import Flight
from tools.simulator.lidar import beam_directions

TRUTH_RATE_HZ = 200.0
STILL_S = 4.0
"""[s] at rest before the flight: some systems calibrate the IMU in the first three seconds."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Plan:
    """What one recording is: the built-in mine (None: a mesh of one's own), what differs from the default rig's
    LiDAR, motion and faults."""

    mine: Callable[[int], MineScenario] | None
    lidar: Mapping[str, Any]
    motion: MotionSettings
    faults: SensorFaults = field(default_factory=SensorFaults)


def rough_mine(seed: int) -> MineScenario:
    """Six rows of seven crossings, bent and rough roadways of all widths; the route runs along all rows, 2 km."""
    rng = np.random.default_rng([seed, 41])
    pitch, columns, rows = 47.0, 7, 6
    nodes = {}
    for i in range(columns):
        for j in range(rows):
            x, y = (pitch * np.array([i, j]) + rng.uniform(-6.0, 6.0, size=2)).tolist()
            nodes[f"{i}.{j}"] = (x, y, float(rng.normal(0.0, 1.0)))
    route = [f"{i if j % 2 == 0 else columns - 1 - i}.{j}" for j in range(rows) for i in range(columns)]
    across = [(f"{i}.{j}", f"{i}.{j + 1}") for i in range(columns) for j in range(rows - 1)]
    ends = {frozenset(pair): pair for pair in [*pairwise(route), *across]}
    return MineScenario(
        "rough", nodes, tuple(_rough(nodes, *pair, rng) for pair in ends.values()), tuple(route), seed=seed
    )


def _rough(nodes: dict[str, tuple[float, float, float]], start: str, end: str, rng: np.random.Generator) -> Roadway:
    p, q = np.array(nodes[start]), np.array(nodes[end])
    aside = np.array([p[1] - q[1], q[0] - p[0], 0.0]) * rng.uniform(-0.06, 0.06)
    x, y, z = (0.5 * (p + q) + aside).tolist()
    width = float(rng.uniform(3.6, 5.4))
    rough = float(rng.uniform(0.06, 0.15))
    return Roadway(start, end, width, 0.75 * width, roughness=rough, via=((x, y, z),))


def tunnel(seed: int) -> MineScenario:
    """A straight tunnel of 200 m without any roughness between two rough roadways."""
    nodes = {"start": (-40.0, 8.0, 0.0), "west": (0.0, 0.0, 0.0), "east": (200.0, 0.0, 0.0), "end": (240.0, -10.0, 0.0)}
    roadways = (
        Roadway("start", "west", roughness=0.14),
        Roadway("west", "east", 4.4, 3.4, roughness=0.0),
        Roadway("east", "end", roughness=0.14),
    )
    return MineScenario("tunnel", nodes, roadways, ("start", "west", "east", "end"), relief=0.0, seed=seed)


STEADY = MotionSettings(still_s=STILL_S)
_SHAKEN = MotionSettings(still_s=STILL_S, speed=3.0, wobble_deg=3.0, vibration_accel=1.0, vibration_gyro=0.05)


def _as_built_in(name: str) -> Plan:
    """A built-in mine whose own robot goes through it."""
    robot = SCENARIOS[name](0).robot
    assert robot is not None and robot.rig.lidar is not None
    return Plan(SCENARIOS[name], robot.rig.lidar.model_dump(exclude_unset=True), robot.motion)


PLANS: dict[str, Plan] = {
    "mesh": Plan(None, {}, STEADY),
    "rough": Plan(rough_mine, {}, STEADY),
    "dense": Plan(rough_mine, {"beams": 32, "columns": 1800}, STEADY),
    "poor": Plan(
        rough_mine, {"beams": 16, "columns": 450, "range_std": 0.04}, _SHAKEN, SensorFaults(lidar_dropout=0.2)
    ),
    "tunnel": Plan(tunnel, {"max_range": 30.0}, STEADY),
    "coal-tunnel": _as_built_in("coal-tunnel"),
    "coal-tunnel-1km": _as_built_in("coal-tunnel-1km"),
}
"""``mesh``: a mesh and a route of one's own; ``rough``: 2 km with rough walls; ``dense``: 32 beams of 1800 columns;
``poor``: 16 of 450, 4 cm noise, a fifth lost, 3 m/s, shaken; ``tunnel``: it all looks the same, the LiDAR sees 30 m;
``coal-tunnel``, ``coal-tunnel-1km``: the built-in mines, less wheel and UWB.
"""


def recorded(
    name: str,
    cache: Path,
    *,
    mesh: Path | None = None,
    route: Path | None = None,
    metres: float | None = None,
    seed: int = 0,
    plan: Plan | None = None,
    progress: Progress,
) -> Recorded:
    """The recording ``name`` from the cache, simulated first if it is not there.

    Parameters
    ----------
    mesh, route : a mesh file and a CSV of floor points, in place of the recording's own mine.
    metres : length that is recorded; all of the route if None.
    plan : what it is, if it is none of `PLANS`.
    progress : called with (done, total) nanoseconds of the flight.

    Raises `SettingsError` for an unknown name or a mine without mesh and route.
    """
    if plan is None and name not in PLANS:
        raise SettingsError(f"does not know `{name}`", field="--recording", mend=f"known: {', '.join(PLANS)}")
    plan = plan or PLANS[name]
    if (mesh is None) != (route is None) or (mesh is None and plan.mine is None):
        raise SettingsError("needs both", field="--mesh, --route", mend="give a mesh file and a CSV of floor points")
    about = {
        "recording": name,
        "mine": name if mesh is None else mesh.stem,
        "seed": seed,
        "metres": metres,
        "motion": plan.motion.model_dump(),
        "faults": plan.faults.model_dump(),
        "lidar": plan.lidar,
        "files": [_digest(path) for path in (mesh, route) if path is not None],
    }
    key = hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()[:8]
    directory = cache / f"{about['recording']}-{about['mine']}-{key}"
    if not directory.exists():
        mine = load_mesh(mesh) if mesh is not None else dig(mine_of(plan, seed))
        flight = _flight(mine, None if route is None else load_route(route), plan, metres, seed)
        simulate(flight, directory, about, progress)
    return Recorded.open(directory)


def mine_of(plan: Plan, seed: int) -> MineScenario:
    """What a plan without a mesh digs."""
    assert plan.mine is not None
    return plan.mine(seed)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def _flight(mine: Mine, route: Array | None, plan: Plan, metres: float | None, seed: int) -> Flight:
    rig = default_rig().without("wheel")
    assert rig.lidar is not None
    lidar = LidarBlock(**{**rig.lidar.model_dump(exclude_unset=True), **plan.lidar})
    rig = Rig(frame=rig.frame, imu=rig.imu, lidar=lidar)
    settings = SimulationSettings(motion=plan.motion, faults=plan.faults)
    flight = fly(mine, route, rig, settings=settings, seed=seed)
    return flight if metres is None else replace(flight, last_s=_reached_s(flight, metres))


def _reached_s(flight: Flight, metres: float) -> float:
    """Time [s] at which so many metres are flown, a tenth of a second after it."""
    t = np.arange(flight.first_s, flight.last_s, 0.1)
    flown = np.cumsum(np.linalg.norm(np.diff(flight.motion(t).position, axis=0), axis=1))
    return float(t[min(int(np.searchsorted(flown, metres)) + 2, len(t) - 1)])


def simulate(flight: Flight, directory: Path, about: dict[str, object], progress: Progress) -> None:
    """Write the flight's IMU, scans and truth, and what the recording is ``about``."""
    block = flight.rig.lidar
    assert block is not None
    directions = beam_directions(block).transpose(1, 0, 2)
    rate = block.rate_hz or 10.0
    offsets_ns = np.rint(np.arange(block.columns) / block.columns / rate * 1e9).astype(np.int64)
    about = {
        **about,
        "rig": flight.rig.model_dump(exclude_unset=True),
        "T_imu_lidar": block.T_imu_lidar[:3].tolist(),
    }
    imu: list[ImuSample] = []
    first_ns, span_ns = int(flight.stamps(rate)[0]), max(1, round((flight.last_s - flight.first_s) * 1e9))
    with RecordedWriter(directory, directions.astype(np.float32), offsets_ns, about) as out:
        for measurement in simulate_measurements(flight):
            if isinstance(measurement, ImuSample):
                imu.append(measurement)
            elif isinstance(measurement, Scan) and measurement.ring is not None:
                ranges = np.linalg.norm(measurement.points.astype(np.float64), axis=1)
                out.write(measurement.stamp_ns, measurement.ring, measurement.offsets_ns, ranges)
                progress(measurement.stamp_ns - first_ns, span_ns)
        truth = flight.truth(TRUTH_RATE_HZ)
        out.finish(
            (
                np.array([sample.stamp_ns for sample in imu], np.int64),
                np.array([sample.gyro for sample in imu]),
                np.array([sample.accel for sample in imu]),
            ),
            (truth.stamps_ns, truth.poses),
        )
