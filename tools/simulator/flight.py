"""A flight: one robot with its rig, on its way through one mine, for a stretch of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semmap.errors import InputFileError, SettingsError
from semmap.geometry import Array
from semmap.rig import Rig
from semmap.trajectory import Trajectory
from tools.simulator.clearance import check_inside, kept_clear
from tools.simulator.floor import FloorRoute, on_floor
from tools.simulator.mine import Mine
from tools.simulator.motion import Motion
from tools.simulator.progress import Progress, ignored
from tools.simulator.rigs import default_rig
from tools.simulator.roadways import Robot
from tools.simulator.route import checked_route, control_points
from tools.simulator.settings import MotionSettings, SensorFaults, SimulationSettings

EPOCH_NS = 1_000_000_000_000
"""Stamp of the moment the robot's motion begins: robots' clocks do not start at zero."""
TRUTH_RATE_HZ = 50.0

Stamps = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """What every sensor needs to know.

    mine, motion, rig, faults : where, how, with what, and what goes wrong.
    first_s, last_s : the recorded stretch of the motion's time [s]. seed : of every sensor's errors.
    floor_shift : by how much the route's heights were moved at most to lie on the mine's floor [m].
    """

    mine: Mine
    motion: Motion
    rig: Rig
    faults: SensorFaults
    first_s: float
    last_s: float
    seed: int
    floor_shift: float = 0.0

    def stamps(self, rate_hz: float, *, phase: float = 0.0) -> Stamps:
        """Stamps (n,) [ns] at a rate over the recorded stretch, beginning ``phase`` periods into it."""
        count = int(np.floor((self.last_s - self.first_s) * rate_hz - phase + 1e-9)) + 1
        seconds = self.first_s + (np.arange(max(count, 0)) + phase) / rate_hz
        return np.asarray(EPOCH_NS + np.rint(seconds * 1e9).astype(np.int64))

    def times(self, stamps_ns: Stamps) -> Array:
        """Motion times (n,) [s] of stamps."""
        return np.asarray((stamps_ns - EPOCH_NS) * 1e-9)

    def rng(self, sensor: int) -> np.random.Generator:
        """A sensor's own random numbers, so that leaving one sensor out changes no other."""
        return np.random.default_rng([self.seed, 10, sensor])

    def truth(self, rate_hz: float = TRUTH_RATE_HZ) -> Trajectory:
        """True poses of the IMU in the map frame."""
        stamps = self.stamps(rate_hz)
        return Trajectory("map", stamps, self.motion(self.times(stamps)).poses())


def fly(
    mine: Mine,
    route: ArrayLike | None = None,
    rig: Rig | None = None,
    *,
    settings: SimulationSettings | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Flight:
    """Plan a flight through a mine.

    Parameters
    ----------
    mine : where.
    route : (n, 3) floor points in the map frame, or (n, 2) without heights; the scenario's own if None. Heights
        that do not fit the mine's floor are replaced by it, see `on_floor`.
    rig : the robot's sensors; the scenario's own robot's, or `default_rig`, if None.
    settings : motion, faults, start and duration; see `driven_settings`.
    seed : of wobble and sensor errors.
    progress : called with (done, total) while the path is kept clear of the rock.

    Raises
    ------
    InputFileError
        If there is no route, it is too short, not finite, or leaves the mine.
    SettingsError
        If the recording would start after the flight has ended.
    """
    settings, rig = driven_settings(mine, settings), rig or robot_of(mine).rig
    way = _floor_route(mine, route, settings.motion.height)
    controls = kept_clear(control_points(way.points, settings.motion), mine, progress or ignored)
    motion = Motion(controls, settings.motion, seed)
    check_inside(mine, motion, settings.motion.height)
    last = motion.duration_s if settings.duration_s is None else settings.start_s + settings.duration_s
    if settings.start_s >= motion.duration_s:
        raise SettingsError(
            f"is after the end of the flight ({motion.duration_s:.1f} s)",
            field="start_s",
            mend="start earlier",
        )
    return Flight(
        mine,
        motion,
        rig,
        settings.faults,
        settings.start_s,
        min(last, motion.duration_s),
        seed,
        way.shift,
    )


def robot_of(mine: Mine) -> Robot:
    """The scenario's own robot, or else the default one."""
    if mine.scenario is not None and mine.scenario.robot is not None:
        return mine.scenario.robot
    return Robot(default_rig(), MotionSettings())


def driven_settings(mine: Mine, settings: SimulationSettings | None) -> SimulationSettings:
    """The settings with the motion of the mine's own robot wherever ``settings`` do not set it themselves."""
    settings = settings or SimulationSettings()
    own, said = (one.model_dump(exclude_unset=True) for one in (robot_of(mine).motion, settings.motion))
    return settings.model_copy(update={"motion": MotionSettings(**{**own, **said})})


def _floor_route(mine: Mine, route: ArrayLike | None, height: float) -> FloorRoute:
    """The scenario's own route, which lies on its floor, or a given one put there."""
    if route is not None:
        return on_floor(checked_route(np.asarray(route, dtype=np.float64)), mine, height)
    if mine.scenario is None:
        raise InputFileError("needs a route", file=mine.name, field="route", mend="give --route CSV")
    return FloorRoute(checked_route(mine.scenario.route_floor()), 0.0)
