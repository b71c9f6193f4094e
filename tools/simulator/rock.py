"""Where there is rock: a signed field over space, negative in the roadways, positive in the rock.

Each roadway is its profile swept along its axis. Roadways that meet share their floor there, so that it has no
steps; their walls and roofs are joined by a smooth minimum, so that the corners of pillars are rounded; and rock noise
is added whose strength each roadway sets for its own walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from semmap.geometry import Array
from tools.simulator.roadways import MineScenario
from tools.simulator.waves import PlaneWaves

_FAR = 3.0
"""[m] of rock beyond a roadway's walls in which its field still counts."""
_BLEND = 0.6
"""[m] radius of the smooth minimum where roadways meet."""
_SHARED, _STOREY = 4.5, 2.0
"""[m] from a roadway's axis, and above or below its floor, within which its floor counts for one that it meets."""
_ALWAYS = 1e-3
"""Weight of a roadway's own floor where it is far from all axes."""
_AMPLITUDE_REACH = 2.0
"""[m] over which the roughness changes from one roadway's to the next one's."""
_FLOOR_ROUGHNESS = 0.33
_WAVES = 48


@dataclass(frozen=True, slots=True, eq=False)
class SweptRoadway:
    """A roadway as segments: ``starts`` (s, 3), ``steps`` (s, 3) to their ends; section and roughness."""

    starts: Array
    steps: Array
    width: float
    height: float
    profile: Literal["arched", "rectangular"]
    roughness: float

    def reaches(self, low: Array, high: Array) -> bool:
        """Whether a box, corners ``low`` and ``high`` (3,), comes near enough to matter."""
        side = self.width / 2 + _FAR
        below, above = np.array([side, side, _FAR]), np.array([side, side, self.height + _FAR])
        ends = self.starts + self.steps
        bottom, top = np.minimum(self.starts, ends) - below, np.maximum(self.starts, ends) + above
        return bool(((bottom <= high) & (top >= low)).all(axis=1).any())

    def section(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Distance from the axis in plan, and floor height, over a grid: both (nx, ny).

        Each plan position belongs to the nearest segment; its section stands upright, as roadways are dug.
        """
        dx, dy = (
            x[None, :, None] - self.starts[:, 0, None, None],
            y[None, None, :] - self.starts[:, 1, None, None],
        )
        sx, sy = self.steps[:, 0, None, None], self.steps[:, 1, None, None]
        t = np.clip((dx * sx + dy * sy) / np.maximum(sx**2 + sy**2, 1e-12), 0.0, 1.0)
        distance2 = (dx - t * sx) ** 2 + (dy - t * sy) ** 2
        nearest = distance2.argmin(axis=0)[None]
        floor = self.starts[:, 2, None, None] + t * self.steps[:, 2, None, None]
        return (
            np.sqrt(np.take_along_axis(distance2, nearest, 0)[0]),
            np.take_along_axis(floor, nearest, 0)[0],
        )


def profile_distance(u: Array, v: Array, roadway: SweptRoadway) -> Array:
    """Signed distance [m] of points ``u`` beside the axis and ``v`` above the floor, negative inside."""
    a = roadway.width / 2
    if roadway.profile == "rectangular":
        return np.maximum(np.maximum(u - a, -v), v - roadway.height)
    b = min(a, 0.5 * roadway.height)
    springing = roadway.height - b
    w = np.maximum(v - springing, 0.0)
    # distance to an ellipse to first order, exact on it and on the wall below the springing line
    k0, k1 = np.hypot(u / a, w / b), np.hypot(u / a**2, w / b**2)
    on_axis = k1 < 1e-6
    arch = np.where(on_axis, -min(a, b), k0 * (k0 - 1.0) / np.where(on_axis, 1.0, k1))
    return np.maximum(arch, -v)


class RockField:
    """The field of a scenario, evaluated block by block."""

    def __init__(self, scenario: MineScenario) -> None:
        self.roadways = tuple(_swept(scenario, index) for index in range(len(scenario.roadways)))
        self._meets = np.array(
            [[bool({a.start, a.end} & {b.start, b.end}) for b in scenario.roadways] for a in scenario.roadways]
        )
        rng = np.random.default_rng([scenario.seed, 2])
        self._waves = PlaneWaves.draw(rng, scenario.texture, count=_WAVES, dimensions=3)

    def __call__(self, x: Array, y: Array, z: Array) -> Array:
        """Field [m] on the grid of coordinates x, y, z: (nx, ny, nz), negative in the roadways."""
        low, high = np.array([x[0], y[0], z[0]]), np.array([x[-1], y[-1], z[-1]])
        near = [k for k, roadway in enumerate(self.roadways) if roadway.reaches(low, high)]
        if not near:
            return np.full((len(x), len(y), len(z)), _FAR)
        beside, floors = zip(*(self.roadways[k].section(x, y) for k in near), strict=True)
        shared = _shared_floors(np.array(beside), np.array(floors), self._meets[np.ix_(near, near)])
        rise = z - shared[..., None]
        distances = [
            profile_distance(u[:, :, None], v, self.roadways[k]) for k, u, v in zip(near, beside, rise, strict=True)
        ]
        strengths = [_strength(v, self.roadways[k]) for k, v in zip(near, rise, strict=True)]
        field = distances[0]
        for distance, v in zip(distances[1:], rise[1:], strict=True):
            field = _joined(field, distance, v)
        return np.asarray(field + _blend(distances, strengths) * self._waves.on_grid(x, y, z))


def _swept(scenario: MineScenario, index: int) -> SweptRoadway:
    roadway = scenario.roadways[index]
    axis = scenario.axis(roadway)
    return SweptRoadway(
        axis[:-1], np.diff(axis, axis=0), roadway.width, roadway.height, roadway.profile, roadway.roughness
    )


def _shared_floors(beside: Array, floors: Array, meets: NDArray[np.bool_]) -> Array:
    """Floors (r, nx, ny), each with those of the roadways it meets mixed in where they are near in plan and height."""
    nearness = np.maximum(1.0 - beside / _SHARED, 0.0) ** 2
    shared = np.empty_like(floors)
    for k, floor in enumerate(floors):
        level = np.maximum(1.0 - np.abs(floors - floor) / _STOREY, 0.0)
        weights = meets[k][:, None, None] * level * nearness
        weights[k] += _ALWAYS
        shared[k] = (weights * floors).sum(axis=0) / weights.sum(axis=0)
    return shared


def _strength(v: Array, roadway: SweptRoadway) -> Array:
    """Strength (nx, ny, nz) of the rock noise at heights ``v`` above the floor."""
    return np.asarray(roadway.roughness * (_FLOOR_ROUGHNESS + (1.0 - _FLOOR_ROUGHNESS) * np.clip(v, 0.0, 1.0)))


def _joined(a: Array, b: Array, v: Array) -> Array:
    """Minimum of two distances, rounded above the floor (``v`` above it) where they differ by less than the radius."""
    h = np.maximum(_BLEND - np.abs(a - b), 0.0) / _BLEND
    return np.minimum(a, b) - 0.25 * _BLEND * h * h * np.clip(v, 0.0, 1.0)


def _blend(distances: Sequence[Array], strengths: Sequence[Array]) -> Array:
    """Noise strength, each roadway's weighted by how near it is; exactly its own far from others."""
    if len(distances) == 1:
        return strengths[0]
    nearest = np.minimum.reduce(distances)
    weights = [np.maximum(1.0 - (distance - nearest) / _AMPLITUDE_REACH, 0.0) ** 2 for distance in distances]
    total = sum(weights[1:], weights[0])
    return np.asarray(
        sum((w * s for w, s in zip(weights[1:], strengths[1:], strict=True)), weights[0] * strengths[0]) / total
    )
