"""The intersections a scenario has by construction, and their reference file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from semmap.files import written_whole
from semmap.geometry import Array
from tools.simulator.roadways import MineScenario

_NICHE_LENGTH = 8.0
"""[m] a dead end shorter than this is a niche, not a branch, as in the benchmark's reference list."""
_BEARING_DISTANCE = 6.0
"""[m] along a roadway at which its bearing is taken."""
_CORNER_DEG = 45.0
"""[deg] a node of two roadways is an intersection (kind L) if the way turns by more."""


@dataclass(frozen=True, slots=True, eq=False)
class Junction:
    """A reference intersection: floor point (3,) [m, map frame], bearings (b,) of its branches [deg]."""

    id: int
    p_map: Array
    bearings_deg: Array

    @property
    def branches(self) -> int:
        """How many roadways leave."""
        return len(self.bearings_deg)


def junctions_of(scenario: MineScenario) -> tuple[Junction, ...]:
    """All nodes with three branches or more, or two that make a corner."""
    found: list[Junction] = []
    for node in scenario.nodes:
        bearings = _bearings(scenario, node)
        if len(bearings) >= 3 or (len(bearings) == 2 and _turn_deg(bearings) > _CORNER_DEG):
            found.append(Junction(len(found), scenario.node_floor(node), bearings))
    return tuple(found)


def save_junctions(path: str | Path, junctions: tuple[Junction, ...]) -> None:
    """Write ``id,x_m,y_m,branches,bearings_deg,z_m`` lines: ``z_m`` is the floor's height."""
    with written_whole(path) as temporary, temporary.open("w", encoding="utf-8") as out:
        out.write("id,x_m,y_m,branches,bearings_deg,z_m\n")
        for junction in junctions:
            x, y, z = junction.p_map
            bearings = ";".join(f"{bearing:.0f}" for bearing in junction.bearings_deg)
            out.write(f'{junction.id},{x:.2f},{y:.2f},{junction.branches},"{bearings}",{z:.2f}\n')


def _bearings(scenario: MineScenario, node: str) -> Array:
    """Bearings [deg], ascending, of the roadways that leave ``node``, niches left out."""
    degree = {name: sum(name in (r.start, r.end) for r in scenario.roadways) for name in scenario.nodes}
    bearings: list[float] = []
    for roadway in scenario.roadways:
        for here, there in ((roadway.start, roadway.end), (roadway.end, roadway.start)):
            if here != node:
                continue
            axis = scenario.axis(roadway) if here == roadway.start else np.flip(scenario.axis(roadway), axis=0)
            if degree[there] > 1 or _along(axis)[-1] >= _NICHE_LENGTH:
                bearings.append(_bearing(axis))
    return np.sort(np.array(bearings))


def _bearing(axis: Array) -> float:
    """Direction [deg] from the first point to the one six metres along."""
    along = _along(axis)
    ahead = [np.interp(min(_BEARING_DISTANCE, along[-1]), along, axis[:, k]) - axis[0, k] for k in range(2)]
    return float(np.degrees(np.arctan2(ahead[1], ahead[0])) % 360.0)


def _along(axis: Array) -> Array:
    """Distance (k,) along a polyline (k, 3)."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(axis, axis=0), axis=1))])


def _turn_deg(bearings: Array) -> float:
    """By how much the way turns [deg] at a node of two roadways."""
    return float(abs(180.0 - abs(bearings[1] - bearings[0])))
