"""Three production levels above each other, joined by a spiral decline and by a ramp that passes over a drift.

The levels have the same plan but for a metre, so that their crossings lie above each other, and differ in their
headings. West of them the spiral goes down one turn a level; east of them the ramp goes from the first to the second.
"""

from __future__ import annotations

import numpy as np

from semmap.geometry import Array
from tools.simulator.roadways import MineScenario, Point, Roadway

_LEVELS = 3
_SPIRAL_CENTRE = np.array([-28.0, 0.0])
_SPIRAL_RADIUS = (12.5, 14.5)
_DECLINE = 1.0 / 7.0
_RAMP_DEG = 15.0
_RAMP_HEAD = np.array([74.0, 48.0])
_CROSSINGS = {"b": (26.0, 0.0), "c": (54.0, -3.0), "e": (27.0, 28.0), "f": (54.0, 28.0)}
_DRIFTS = (("b", "c"), ("b", "e"), ("c", "f"), ("e", "f"))
_HEADINGS = {"b": (21.0, -22.0), "c": (58.0, -24.0), "e": (24.0, 50.0), "w": (5.0, 32.0)}
"""Ends of dead ends, each of which some levels have; ``w`` leaves ``e`` to the west."""
_OFF = 1.0
"""[m] by which crossings are off those above and below."""


def level_plan(seed: int) -> MineScenario:
    """A mine of three levels without a route, fully set by its seed."""
    rng = np.random.default_rng([seed, 5])
    radius = float(rng.uniform(*_SPIRAL_RADIUS))
    drop = 2.0 * np.pi * radius * _DECLINE
    nodes: dict[str, Point] = {}
    roadways: list[Roadway] = []
    for level in range(_LEVELS):
        _add_level(nodes, roadways, level, -drop * level, rng)
    _add_spiral(nodes, roadways, radius, drop, rng)
    _add_ramp(nodes, roadways, drop, rng)
    return MineScenario("levels", nodes, tuple(roadways), (), relief=0.12, seed=seed)


def _add_level(
    nodes: dict[str, Point], roadways: list[Roadway], level: int, z: float, rng: np.random.Generator
) -> None:
    """A ring of drifts between four crossings, with headings."""
    for name, plan in _CROSSINGS.items():
        nodes[f"{name}{level}"] = _floor(np.array(plan) + rng.uniform(-_OFF, _OFF, 2), z)
    for name in rng.permutation(list(_HEADINGS))[:3].tolist():
        end = f"{name}{level}.end"
        nodes[end] = _floor(np.array(_HEADINGS[name]) + rng.uniform(-2.0, 2.0, 2), z)
        roadways.append(_drift(f"{'e' if name == 'w' else name}{level}", end, rng))
    roadways += [_drift(f"{a}{level}", f"{b}{level}", rng) for a, b in _DRIFTS]


def _add_spiral(
    nodes: dict[str, Point], roadways: list[Roadway], radius: float, drop: float, rng: np.random.Generator
) -> None:
    """The decline, from a portal half a turn above the first level to a quarter below the last, and its accesses."""
    west, z = _SPIRAL_CENTRE - [radius, 0.0], 0.5 * drop
    nodes["portal"] = _floor(west + [-3.0, 26.0], z + 26.0 * _DECLINE)
    nodes["half.0"] = _floor(west, z)
    roadways.append(_decline("portal", "half.0"))
    for level in range(_LEVELS):
        here, there = f"access.{level}", f"half.{level + 1}"
        nodes[here] = _floor(_SPIRAL_CENTRE + [radius, 0.0], -drop * level)
        last = level == _LEVELS - 1
        arc = 0.25 if last else 0.5
        nodes[there] = _on_spiral(radius, drop, level + arc)
        roadways += [
            _decline(f"half.{level}", here, _arc(radius, drop, level - 0.5, level)),
            _decline(here, there, _arc(radius, drop, level, level + arc)),
            _drift(here, f"b{level}", rng),
        ]


def _add_ramp(nodes: dict[str, Point], roadways: list[Roadway], drop: float, rng: np.random.Generator) -> None:
    """From the north-east of the first level over a drift of the second to the south-east of that."""
    foot = _RAMP_HEAD - [0.0, drop / np.tan(np.radians(_RAMP_DEG))]
    nodes |= {
        "n0": (53.0, 48.0, 0.0),
        "n0.end": (50.0, 68.0, 0.0),
        "head": _floor(_RAMP_HEAD, 0.0),
        "head.end": (94.0, 54.0, 0.0),
        "foot": _floor(foot, -drop),
        "foot.end": _floor(foot + [21.0, -4.0], -drop),
        "under": (92.0, 33.5, -drop),
    }
    pairs = (("f0", "n0"), ("n0", "n0.end"), ("n0", "head"), ("head", "head.end"), ("c1", "foot"), ("foot", "foot.end"))
    roadways += [_drift(*pair, rng) for pair in pairs]
    roadways += [Roadway("head", "foot", 4.8, 3.4, roughness=0.1), Roadway("f1", "under", 4.2, 3.0, roughness=0.1)]


def _on_spiral(radius: float, drop: float, turn: float) -> Point:
    """Point of the decline ``turn`` turns below the first level, where it lies due east of the centre."""
    angle = 2.0 * np.pi * turn
    return _floor(_SPIRAL_CENTRE + radius * np.array([np.cos(angle), np.sin(angle)]), -drop * turn)


def _arc(radius: float, drop: float, start: float, end: float) -> tuple[Point, ...]:
    """Points between two turns of the decline, sixteen a turn."""
    steps = round(16 * (end - start))
    return tuple(_on_spiral(radius, drop, start + step / 16) for step in range(1, steps))


def _decline(start: str, end: str, via: tuple[Point, ...] = ()) -> Roadway:
    return Roadway(start, end, 5.0, 4.0, roughness=0.12, via=via)


def _drift(start: str, end: str, rng: np.random.Generator) -> Roadway:
    """A roadway of random section."""
    width = float(rng.uniform(3.8, 5.2))
    height, roughness = float(rng.uniform(2.9, 3.6)), float(rng.choice([0.05, 0.1, 0.15]))
    return Roadway(start, end, width, height, "arched" if rng.uniform() < 0.7 else "rectangular", roughness)


def _floor(plan: Array, z: float) -> Point:
    x, y = plan.tolist()
    return (x, y, float(z))
