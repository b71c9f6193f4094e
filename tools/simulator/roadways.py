"""The plan of a simulated mine: nodes, roadways between them, and the axes they follow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from semmap.errors import InputFileError
from semmap.geometry import Array
from semmap.rig import Rig
from tools.simulator.settings import MotionSettings
from tools.simulator.waves import PlaneWaves

_AXIS_STEP = 2.0
_RELIEF_WAVELENGTHS = (20.0, 60.0)

Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Roadway:
    """One roadway between two nodes.

    start, end : names of its nodes; via : floor points in between (a smooth curve goes through them).
    width, height : of the clear section [m]; profile : ``arched`` (elliptic roof) or ``rectangular``.
    roughness : RMS of the rock's roughness on walls and roof [m]; the floor has a third of it.

    A roadway must not pass over itself: put a node between two turns of a spiral.
    """

    start: str
    end: str
    width: float = 4.5
    height: float = 3.3
    profile: Literal["arched", "rectangular"] = "arched"
    roughness: float = 0.1
    via: tuple[Point, ...] = ()


@dataclass(frozen=True, slots=True)
class Robot:
    """What goes through a mine unless somebody says otherwise: its sensors, and how it moves."""

    rig: Rig
    motion: MotionSettings


@dataclass(frozen=True, slots=True)
class MineScenario:
    """A mine on paper.

    nodes : name -> floor point where the axes meet; roadways : between them.
    route : names of the nodes a robot visits, each joined to the next by a roadway.
    relief : RMS of the floor's undulation over 20 to 60 m [m]; texture : wavelengths of the rock's
    roughness [m].
    origin : added to all coordinates, for mines on a national grid. seed : of relief and rock.
    robot : its own, where one belongs to it. way : floor points it goes over, where that is not along the axes.
    """

    name: str
    nodes: Mapping[str, Point]
    roadways: tuple[Roadway, ...]
    route: tuple[str, ...]
    relief: float = 0.3
    texture: tuple[float, float] = (0.7, 6.0)
    origin: Point = (0.0, 0.0, 0.0)
    seed: int = 0
    robot: Robot | None = None
    way: tuple[Point, ...] = ()

    def __post_init__(self) -> None:
        numbers = [*self.nodes.values(), *(point for roadway in self.roadways for point in roadway.via)]
        if not self.roadways or not np.isfinite(numbers).all():
            raise InputFileError("has no roadways or a node that is not finite", field=f"scenario {self.name}")
        for roadway in self.roadways:
            _check_roadway(self, roadway)
        for start, end in zip(self.route[:-1], self.route[1:], strict=True):
            self.between(start, end)

    def between(self, start: str, end: str) -> Roadway:
        """The roadway that joins two nodes. Raises `InputFileError` where there is none."""
        for roadway in self.roadways:
            if {start, end} == {roadway.start, roadway.end}:
                return roadway
        raise InputFileError(
            f"no roadway joins {start} and {end}",
            field=f"scenario {self.name}",
            mend="visit neighbouring nodes",
        )

    def axis(self, roadway: Roadway) -> Array:
        """Floor axis (k, 3) of a roadway, start to end, relative to `origin`, about 2 m a step."""
        corners = np.array([self.nodes[roadway.start], *roadway.via, self.nodes[roadway.end]], dtype=np.float64)
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
        at = np.linspace(0.0, along[-1], max(2, round(along[-1] / _AXIS_STEP) + 1))
        if len(corners) > 2:
            axis = np.column_stack(
                [CubicSpline(along, corners[:, :2])(at), PchipInterpolator(along, corners[:, 2])(at)]
            )
        else:
            axis = corners[0] + (at / along[-1])[:, None] * (corners[1] - corners[0])
        axis[:, 2] += self._relief(axis[:, :2])
        return axis

    def node_floor(self, node: str) -> Array:
        """Floor point (3,) of a node in the map frame, relief included."""
        p = np.array(self.nodes[node], dtype=np.float64)
        p[2] += self._relief(p[None, :2])[0]
        return p + self.origin

    def route_floor(self) -> Array:
        """Floor points (n, 3) of the route in the map frame."""
        if self.way:
            return np.asarray(np.array(self.way) + np.asarray(self.origin))
        parts = [self._leg(start, end) for start, end in zip(self.route[:-1], self.route[1:], strict=True)]
        joined = np.concatenate([parts[0][:1], *(part[1:] for part in parts)])
        return np.asarray(joined + np.asarray(self.origin))

    def _leg(self, start: str, end: str) -> Array:
        roadway = self.between(start, end)
        axis = self.axis(roadway)
        return axis if roadway.start == start else np.flip(axis, axis=0)

    def _relief(self, plan: Array) -> Array:
        """Undulation (n,) of the floor at plan positions (n, 2), one for all roadways, so they meet level."""
        rng = np.random.default_rng([self.seed, 1])
        waves = PlaneWaves.draw(rng, _RELIEF_WAVELENGTHS, count=24, dimensions=2)
        return np.asarray(self.relief * waves(plan))


def _check_roadway(scenario: MineScenario, roadway: Roadway) -> None:
    """Raise `InputFileError` where a roadway cannot be dug."""
    where = f"scenario {scenario.name}: roadway {roadway.start}-{roadway.end}"
    for node in (roadway.start, roadway.end):
        if node not in scenario.nodes:
            raise InputFileError(f"names no known node ({node})", field=where, mend="list it under nodes")
    sizes = [roadway.width, roadway.height, roadway.roughness]
    if not np.isfinite(sizes).all() or min(sizes[:2]) < 1.0 or not 0.0 <= roadway.roughness <= 0.5:
        raise InputFileError("has an impossible size", field=where, mend="width, height >= 1 m, roughness <= 0.5 m")
    if np.allclose(scenario.nodes[roadway.start], scenario.nodes[roadway.end]) and not roadway.via:
        raise InputFileError("has no length", field=where, mend="join two different nodes")
