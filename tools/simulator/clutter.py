"""What stands about in a mine's roadways: parked vehicles, pallets, posts and conveyors, all made of boxes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from semmap.geometry import Array
from tools.simulator.boxes import Box
from tools.simulator.mine import Mine
from tools.simulator.route import evenly
from tools.simulator.settings import SurveySettings

_ROOTED = 0.3
"""[m] by which things reach into the uneven floor."""
_LOOK = 1.0
"""[m] above the floor from where walls and floor are looked for."""
_OFF_THE_ROCK = 0.05
_PASSAGE = 1.2
"""[m] beside a thing that must be left, both sides together."""
_THROWS = 200
_CONVEYOR_ENDS, _CONVEYOR_STEP, _CONVEYOR_WIDTH = 5.0, 2.0, 1.0
_BELT = (0.5, 0.9)
"""[m] above the floor where a conveyor's belt and rollers are."""

Extent = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Low and high corner of a box, x ahead, y left, z up from the floor [m]."""

_VEHICLE: tuple[Extent, ...] = (
    ((-4.0, -1.3, -_ROOTED), (4.0, 1.3, 1.7)),
    ((0.4, -0.9, 1.6), (2.6, 0.9, 2.5)),
)
"""Body and cab."""


def clutter(mine: Mine, lines: Sequence[Array], settings: SurveySettings, rng: np.random.Generator) -> list[Box]:
    """Boxes of all things, as many of each kind as find room.

    lines : (k, 3) floor points along the roadways in the map frame, a line each.
    """
    things = _conveyors(mine, lines, settings.conveyors, rng)
    kinds = ((settings.vehicles, _vehicle), (settings.pallets, _pallet), (settings.posts, _post))
    for count, make in kinds:
        for _ in range(count):
            thing = _placed(mine, lines, make, things, rng)
            if thing:
                things.append(thing)
    return [box for thing in things for box in thing]


class _Place:
    """A place on a line: floor point ``p`` (3,), heading [rad], and the distances to the walls beside it [m]."""

    def __init__(self, mine: Mine, p: Array, heading: float) -> None:
        self.mine, self.p, self.heading = mine, p, heading
        self.left, self.right = _to_walls(mine, p[None], np.array([heading]))[0]

    def beside(self, offset: float, *, turn: float = 0.0, length: float = 0.0) -> tuple[Array, Array] | None:
        """Origin and axes of a thing ``offset`` to the left, pitched as the floor under its ``length``."""
        c, s = np.cos(self.heading), np.sin(self.heading)
        middle = self.p + offset * np.array([-s, c, 0.0])
        ahead = np.array([np.cos(self.heading + turn), np.sin(self.heading + turn), 0.0])
        ends = middle + 0.4 * length * np.array([[-1.0], [0.0], [1.0]]) * ahead
        floor = _floor_under(self.mine, ends)
        if not np.isfinite(floor).all():
            return None
        x = ahead + [0.0, 0.0, (floor[2] - floor[0]) / (0.8 * length) if length else 0.0]
        return np.array([*middle[:2], floor.mean()]), _axes(x)


def _placed(
    mine: Mine,
    lines: Sequence[Array],
    make: Callable[[_Place, np.random.Generator], list[Box]],
    others: list[list[Box]],
    rng: np.random.Generator,
) -> list[Box]:
    """One thing somewhere along the lines where it fits between rock and the others; empty if nowhere."""
    lengths = np.array([np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in lines])
    for _ in range(_THROWS):
        line = evenly(lines[int(rng.choice(len(lines), p=lengths / lengths.sum()))], 0.5)
        at = int(rng.integers(1, len(line) - 1)) if len(line) > 2 else 0
        step = line[min(at + 1, len(line) - 1)] - line[max(at - 1, 0)]
        thing = make(_Place(mine, line[at], float(np.arctan2(step[1], step[0]))), rng)
        if thing and _fits(mine, thing) and not _collides(thing, others):
            return thing
    return []


def _vehicle(place: _Place, rng: np.random.Generator) -> list[Box]:
    """A loader or truck parked along a wall, cab ahead or behind."""
    return _by_the_wall(place, rng, _VEHICLE, gap=(0.15, 0.5), turn=float(rng.choice([0.0, np.pi])))


def _pallet(place: _Place, rng: np.random.Generator) -> list[Box]:
    """A loaded pallet, not quite straight, by a wall."""
    load: Extent = ((-0.6, -0.5, -_ROOTED), (0.6, 0.5, float(rng.uniform(0.4, 1.5))))
    return _by_the_wall(place, rng, (load,), gap=(0.1, 0.6), turn=float(rng.normal(0.0, 0.2)))


def _by_the_wall(
    place: _Place, rng: np.random.Generator, extents: Sequence[Extent], *, gap: tuple[float, float], turn: float
) -> list[Box]:
    low, high = np.min([e[0] for e in extents], axis=0), np.max([e[1] for e in extents], axis=0)
    width = high[1] - low[1]
    if not width + _PASSAGE < place.left + place.right < np.inf:
        return []
    inset = 0.5 * width + float(rng.uniform(*gap))
    offset = place.left - inset if rng.uniform() < 0.5 else inset - place.right
    pose = place.beside(offset, turn=turn, length=high[0] - low[0])
    return [Box(*pose, np.array(e[0]), np.array(e[1])) for e in extents] if pose else []


def _post(place: _Place, rng: np.random.Generator) -> list[Box]:
    """A prop from floor to roof anywhere across the roadway."""
    side, half = float(rng.uniform(-0.8, 0.8)), 0.5 * float(rng.uniform(0.15, 0.3))
    to_wall = place.left if side > 0.0 else place.right
    pose = place.beside(side * to_wall) if np.isfinite(to_wall) else None
    if pose is None:
        return []
    up = float(place.mine.raycaster.cast(pose[0][None] + [0.0, 0.0, _LOOK], np.array([[0.0, 0.0, 1.0]])).distances[0])
    return [Box(*pose, np.array([-half, -half, -_ROOTED]), np.array([half, half, _LOOK + up - 2.0 * _OFF_THE_ROCK]))]


def _conveyors(mine: Mine, lines: Sequence[Array], count: int, rng: np.random.Generator) -> list[list[Box]]:
    """Belts along a wall of different lines, the longest first, ending before the crossings."""
    trimmed = [_trimmed(line) for line in lines]
    longest = sorted((line for line in trimmed if len(line) > 3), key=lambda line: -len(line))
    return [_conveyor(mine, line, float(rng.choice([-1.0, 1.0]))) for line in longest[:count]]


def _trimmed(line: Array) -> Array:
    """A line at the conveyor's steps, without its ends."""
    ends = round(_CONVEYOR_ENDS / _CONVEYOR_STEP)
    return evenly(line, _CONVEYOR_STEP)[ends:-ends]


def _conveyor(mine: Mine, line: Array, side: float) -> list[Box]:
    step = np.gradient(line[:, :2], axis=0)
    heading = np.arctan2(step[:, 1], step[:, 0])
    to_wall = float(np.median(_to_walls(mine, line, heading)[:, 0 if side > 0.0 else 1]))
    if not np.isfinite(to_wall):
        return []
    offset = side * (to_wall - 0.5 * _CONVEYOR_WIDTH - 0.3)
    stations = line + offset * np.column_stack([-np.sin(heading), np.cos(heading), np.zeros(len(line))])
    stations[:, 2] = _floor_under(mine, stations)
    boxes: list[Box] = []
    for here, there in pairwise(stations):
        if np.isfinite([here[2], there[2]]).all():
            R, half = _axes(there - here), 0.5 * _CONVEYOR_WIDTH
            belt = Box(
                here, R, np.array([0.0, -half, _BELT[0]]), np.array([np.linalg.norm(there - here), half, _BELT[1]])
            )
            leg = Box(here, R, np.array([-0.05, -half, -_ROOTED]), np.array([0.05, half, _BELT[0]]))
            boxes += [belt, leg] if _fits(mine, [belt]) else []
    return boxes


def _axes(x: Array) -> Array:
    """Axes (3, 3) of a thing that looks along ``x`` (3,) and does not lean to a side."""
    x = x / np.linalg.norm(x)
    y = np.array([-x[1], x[0], 0.0]) / np.hypot(x[0], x[1])
    return np.column_stack([x, y, np.cross(x, y)])


def _to_walls(mine: Mine, p: Array, heading: Array) -> Array:
    """Distances (n, 2) [m] to the rock left and right of floor points (n, 3) with their headings (n,)."""
    left = np.column_stack([-np.sin(heading), np.cos(heading), np.zeros(len(p))])
    eyes = p + [0.0, 0.0, _LOOK]
    return np.column_stack([mine.raycaster.cast(eyes, way).distances for way in (left, -left)]).astype(np.float64)


def _floor_under(mine: Mine, p: Array) -> Array:
    """Height (n,) [m] of the floor under points (n, 3) near it; infinite, or NaN, where there is none."""
    eyes = p + [0.0, 0.0, _LOOK]
    down = np.broadcast_to([0.0, 0.0, -1.0], p.shape)
    return np.asarray(eyes[:, 2] - mine.raycaster.cast(eyes, down).distances)


def _fits(mine: Mine, thing: list[Box]) -> bool:
    """Whether no rock is between the middle of any box and its upper corners, nor right beside these."""
    for box in thing:
        upper = box.corners[np.argsort(box.corners[:, 2])[4:]]
        free = mine.raycaster.free_way(np.broadcast_to(box.centre, upper.shape), upper)
        if np.isfinite(free).any() or mine.raycaster.clearance(upper).min() < _OFF_THE_ROCK:
            return False
    return True


def _collides(thing: list[Box], others: list[list[Box]]) -> bool:
    """Whether the spheres round two things meet."""
    return any(_near(box, other) for box in thing for placed in others for other in placed)


def _near(a: Box, b: Box) -> bool:
    reach = 0.5 * (np.linalg.norm(a.high - a.low) + np.linalg.norm(b.high - b.low))
    return bool(np.linalg.norm(a.centre - b.centre) < reach)
