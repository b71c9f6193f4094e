"""Semantic maps of surveys that never were: from plans, with exact wall contours, roadway axes and no clouds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from synthetic_mine import SyntheticMine

from descriptors.wall_contour import ray_angles
from maps.settings import MapSettings
from semmap.geometry import Array
from semmap.intersections import Intersection, RoadwayGraph, SemanticMap, WallContour, axis_slope

Plan = Mapping[str, tuple[float, ...]]
WIDTH = 4.0


def survey(
    nodes: Plan,
    roads: Sequence[str],
    *,
    shift: Sequence[float] = (0.0, 0.0, 0.0),
    quality: float = 0.9,
    open_ends: str = "",
    bends: str = "",
    first_id: int = 0,
    wobble: float = 0.0,
) -> SemanticMap:
    """What a survey of the roads finds.

    nodes : name -> (x, y) or (x, y, z) on the floor. roads : each the names of the nodes it passes, in order.
    Where roads meet is an intersection, unless it is one of the ``bends``; open_ends : ends that are not dead ends.
    wobble : how far the axes found swing beside the planned ones [m].
    """
    p = {name: np.resize([*values, 0.0], 3) if len(values) == 2 else np.array(values) for name, values in nodes.items()}
    ends = [name for road in roads for name in (road.split()[0], road.split()[-1])]
    names = sorted(set(ends), key=lambda name: (ends.count(name) < 2, name))
    legs = [(p[a], p[b]) for road in roads for a, b in pairwise(road.split())]
    intersections, number = [], {}
    for name in names:
        if ends.count(name) >= 2 and name not in bends.split():
            number[name] = first_id + len(intersections)
            bearings = _bearings(name, roads, p)
            intersections.append(_intersection(number[name], p[name], bearings, _walls(legs, p[name]), quality))
    moved = np.asarray(shift, dtype=np.float64)
    axes = [_wobbly(np.array(_axis([p[name] for name in road.split()])), wobble) + moved for road in roads]
    row = {name: k for k, name in enumerate(names)}
    graph = RoadwayGraph(
        node_p_map=np.array([p[name] for name in names]).reshape(-1, 3) + moved,
        node_intersection=np.array([number.get(name, -1) for name in names], np.int64),
        node_kind=np.array(
            ["intersection" if name in number else _kind(name, bends, open_ends) for name in names], np.str_
        ),
        edge_nodes=np.array([[row[road.split()[0]], row[road.split()[-1]]] for road in roads], np.int64).reshape(-1, 2),
        edge_length=np.array([np.linalg.norm(np.diff(axis, axis=0), axis=1).sum() for axis in axes]),
        edge_width=np.full(len(axes), WIDTH),
        edge_height=np.full(len(axes), 3.0),
        edge_slope=np.array([axis_slope(axis) for axis in axes]),
        edge_axes=tuple(axes),
        edge_profiles=tuple(np.tile([WIDTH, 3.0], (len(axis), 1)) for axis in axes),
    )
    places = tuple(_moved(one, moved) for one in intersections)
    return SemanticMap(places, graph, np.zeros(3), MapSettings().model_dump(mode="json"))


def _kind(name: str, bends: str, open_ends: str) -> str:
    return "bend" if name in bends.split() else "open_end" if name in open_ends.split() else "dead_end"


def _axis(corners: list[Array]) -> list[Array]:
    """The corners joined by points a metre apart."""
    line = [corners[0]]
    for a, b in pairwise(corners):
        steps = max(1, round(float(np.linalg.norm(b - a))))
        line += [a + (b - a) * k / steps for k in range(1, steps + 1)]
    return line


def _wobbly(axis: Array, wobble: float) -> Array:
    beside = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) @ (axis[-1] - axis[0])
    swing = wobble * np.sin(np.linspace(0.0, 3.0 * np.pi, len(axis)))
    return axis + swing[:, None] * beside / np.linalg.norm(beside)


def _bearings(name: str, roads: Sequence[str], p: Mapping[str, Array]) -> Array:
    away = []
    for words in (road.split() for road in roads):
        away += [p[words[1]] - p[name]] if words[0] == name else []
        away += [p[words[-2]] - p[name]] if words[-1] == name else []
    return np.sort(np.arctan2([d[1] for d in away], [d[0] for d in away]) % (2.0 * np.pi))


def _walls(legs: Sequence[tuple[Array, Array]], p: Array) -> WallContour:
    """Exact to 5 cm: the first step from the place, in each direction, that is on no roadway."""
    settings = MapSettings().contour
    angles = ray_angles(settings).reshape(settings.sectors, -1).mean(axis=1)
    away = np.arange(0.05, settings.radius, 0.05)
    rays = p[:2] + away[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    near = [(*a[:2], *b[:2], WIDTH) for a, b in legs if _distance(p, a, b) < settings.radius + WIDTH]
    rock = SyntheticMine(tuple(near)).inside(rays.reshape(-1, 2)).reshape(rays.shape[:2]) <= 0.0
    pwcv = np.where(rock.any(axis=0), away[rock.argmax(axis=0)], 0.0).astype(np.float32)
    layers = (settings.layers, 1)
    seen = np.ones(len(pwcv), np.bool_)
    return WallContour(pwcv, seen, np.tile(pwcv, layers), np.tile(seen, layers))


def _distance(p: Array, a: Array, b: Array) -> float:
    share = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return float(np.linalg.norm(a + share * (b - a) - p))


def _intersection(number: int, p: Array, bearings: Array, walls: WallContour, quality: float) -> Intersection:
    kind = {2: "L", 3: "T", 4: "X"}.get(len(bearings), "multi")
    cloud = np.full((2, 3), number, np.float32)
    return Intersection(number, p, kind, bearings, np.full(len(bearings), WIDTH), quality, walls, cloud)


def _moved(one: Intersection, shift: Array) -> Intersection:
    rest = (one.kind, one.branch_bearings, one.branch_widths, one.quality, one.contour, one.cloud)
    return Intersection(one.id, one.p_map + shift, *rest)
