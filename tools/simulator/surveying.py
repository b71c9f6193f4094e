"""The survey that makes a prior map: points on the rock and on what stands about, without what is cut off."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semmap.errors import InputFileError
from semmap.geometry import Array
from tools.simulator.boxes import Box, Samples
from tools.simulator.clutter import clutter
from tools.simulator.mine import Mine
from tools.simulator.settings import SurveySettings

_OPEN_ABOVE = 2.2
"""[m] above the floor where an open-top model ends."""
_ASIDE, _OFF_THE_WALL = 0.3, 0.5
"""[m] off the surface, and then off what else is near, from where the floor below it is looked for."""
_ROADWAY = 40.0
"""[m] of a route that count as one roadway."""


def survey(mine: Mine, settings: SurveySettings | None = None, *, seed: int, route: Array | None = None) -> Array:
    """Points (n, 3) float64, map frame, of a prior map: with the default settings those of `Mine.sample`.

    route : (k, 3) floor points along which things stand in a mine from a mesh, which has no plan.
    Raises `InputFileError` where things shall stand in such a mine and there is no route.
    """
    settings = settings or SurveySettings()
    rng = np.random.default_rng([seed, 3])
    samples = mine.spread(settings.spacing, rng)
    if settings.vehicles or settings.pallets or settings.posts or settings.conveyors:
        boxes = clutter(mine, _lines(mine, route), settings, np.random.default_rng([seed, 7]))
        samples = samples[~_in_any(samples.points, boxes)] + _on_boxes(mine, boxes, settings.spacing, seed)
    if settings.open_top:
        samples = samples[_above_floor(mine, samples) <= _OPEN_ABOVE]
    return np.asarray(samples.points + settings.noise * rng.normal(size=samples.points.shape))


def _lines(mine: Mine, route: Array | None) -> list[Array]:
    """Floor points (k, 3) along each roadway of the plan, or along pieces of a route."""
    if mine.scenario is not None:
        return [mine.scenario.axis(roadway) + mine.origin for roadway in mine.scenario.roadways]
    if route is None:
        raise InputFileError("has no plan", file=mine.name, field="map", mend="give a route where things may stand")
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=1))])
    pieces = np.split(route, np.searchsorted(along, np.arange(_ROADWAY, along[-1], _ROADWAY)))
    return [piece for piece in pieces if len(piece) > 2]


def _on_boxes(mine: Mine, boxes: list[Box], spacing: float, seed: int) -> Samples:
    """What is to be seen of the boxes' surfaces: neither in the rock nor in another box."""
    rng = np.random.default_rng([seed, 8])
    seen = Samples(np.empty((0, 3)), np.empty((0, 3)))
    for box in boxes:
        samples = box.samples(spacing, rng)
        starts = np.broadcast_to(box.centre, samples.points.shape)
        free = np.isinf(mine.raycaster.free_way(starts, samples.points))
        seen += samples[free & ~_in_any(samples.points, [other for other in boxes if other is not box])]
    return seen


def _in_any(points: Array, boxes: list[Box]) -> NDArray[np.bool_]:
    inside = np.zeros(len(points), bool)
    for box in boxes:
        inside |= box.contains(points)
    return inside


def _above_floor(mine: Mine, samples: Samples) -> Array:
    """Height (n,) [m] above the floor of the roadway that the samples look into."""
    eyes = samples.points + _ASIDE * samples.into_air
    # off the wall beside a roof's edge, whose bulges are in the way down
    away = mine.raycaster.from_rock(eyes)
    eyes += _OFF_THE_WALL * away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    down = np.broadcast_to([0.0, 0.0, -1.0], eyes.shape)
    return np.asarray(mine.raycaster.cast(eyes, down).distances - (eyes - samples.points)[:, 2])
