"""The built-in mines. A seed changes the rock and the floor; of `random` it changes the plan as well."""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from semmap.errors import InputFileError
from tools.simulator.coal_tunnel import LONG_M, coal_tunnel
from tools.simulator.level_plan import level_plan
from tools.simulator.random_plan import random_plan
from tools.simulator.roadheader import CONSUMER, roadway
from tools.simulator.roadways import MineScenario, Point, Roadway
from tools.simulator.walk import covering_walk


def demo(seed: int) -> MineScenario:
    """A small mine with eight different intersections; its route takes three minutes and closes loops."""
    nodes: dict[str, Point] = {
        "portal": (0.0, 0.0, 0.0),
        "b": (26.0, 5.0, -0.4),
        "c": (54.0, -6.0, -1.0),
        "d": (84.0, 6.0, -1.4),
        "e": (80.0, 36.0, -0.6),
        "f": (50.0, 27.0, -0.6),
        "g": (24.0, 34.0, 0.3),
        "h": (54.0, 58.0, 0.2),
        "p": (34.0, 62.0, 0.6),
        "stope": (57.0, -27.0, -1.6),
        "heading": (105.0, 0.0, -1.7),
        "shaft": (2.0, 44.0, 0.8),
        "sump": (101.0, 47.0, -1.0),
        "vent": (22.0, 80.0, 1.0),
    }
    roadways = (
        Roadway("portal", "b", 4.6, 3.4, roughness=0.12),
        Roadway("b", "c", 4.2, 3.2, roughness=0.1, via=((40.0, 2.5, -0.7),)),
        Roadway("c", "d", 5.2, 3.8, roughness=0.14, via=((70.0, -2.5, -1.2),)),
        Roadway("d", "e", 3.8, 3.0, "rectangular", 0.05),
        Roadway("e", "f", 4.4, 3.3, roughness=0.12),
        Roadway("f", "g", 3.6, 3.0, "rectangular", 0.08, via=((37.0, 33.0, -0.1),)),
        Roadway("g", "b", 5.0, 3.6, roughness=0.15),
        Roadway("c", "f", 3.4, 2.9, roughness=0.06, via=((58.0, 10.0, -0.9),)),
        Roadway("f", "h", 4.8, 3.5, roughness=0.15),
        Roadway("h", "e", 4.0, 3.2, roughness=0.1, via=((69.0, 51.0, -0.2),)),
        Roadway("h", "p", 4.2, 3.0, "rectangular", 0.06),
        Roadway("p", "g", 4.6, 3.4, roughness=0.13, via=((25.0, 49.0, 0.5),)),
        Roadway("c", "stope", 5.6, 4.0, roughness=0.15),
        Roadway("d", "heading", 4.4, 3.4, roughness=0.12),
        Roadway("g", "shaft", 4.0, 3.2, roughness=0.1),
        Roadway("e", "sump", 4.6, 3.4, roughness=0.15),
        Roadway("p", "vent", 3.6, 3.0, roughness=0.08),
    )
    route = ("portal", *"bcdehpgfcbgf")
    return MineScenario("demo", nodes, roadways, route, relief=0.25, seed=seed)


def grid(seed: int) -> MineScenario:
    """Room and pillar: twenty crossings at equal distances that look alike."""
    columns, rows, pitch = 5, 4, 18.0
    nodes: dict[str, Point] = {f"{i}.{j}": (pitch * i, pitch * j, 0.0) for i in range(columns) for j in range(rows)}
    across = [Roadway(f"{i}.{j}", f"{i + 1}.{j}") for i in range(columns - 1) for j in range(rows)]
    along = [Roadway(f"{i}.{j}", f"{i}.{j + 1}") for i in range(columns) for j in range(rows - 1)]
    rooms = tuple(
        replace(room, width=5.0, height=3.0, profile="rectangular", roughness=0.06) for room in (*across, *along)
    )
    return _with_walk(MineScenario("grid", nodes, rooms, (), relief=0.15, seed=seed), "0.0")


def ramp(seed: int) -> MineScenario:
    """Two levels joined by a ramp of 15 degrees that climbs over the lower drift."""
    rise = 40.0 * np.tan(np.radians(15.0))
    nodes: dict[str, Point] = {
        "start": (-24.0, 0.0, 0.0),
        "a": (0.0, 0.0, 0.0),
        "b": (40.0, 0.0, 0.0),
        "c": (40.0, 32.0, 0.0),
        "d": (0.0, 32.0, 0.0),
        "end": (62.0, -8.0, 0.0),
        "foot": (20.0, 56.0, 0.0),
        "top": (20.0, 16.0, rise),
        "u1": (20.0, -22.0, rise),
        "u2": (54.0, 16.0, rise + 1.0),
        "u3": (52.0, -24.0, rise + 0.5),
        "u4": (-14.0, 18.0, rise),
        "u5": (-2.0, -30.0, rise - 0.5),
    }
    roadways = (
        Roadway("start", "a"),
        Roadway("a", "b", 5.0, 3.4, roughness=0.12),
        Roadway("b", "c", 4.2, 3.2, roughness=0.08),
        Roadway("c", "d", 4.6, 3.2, roughness=0.12),
        Roadway("d", "a", 4.0, 3.0, "rectangular", 0.08),
        Roadway("b", "end"),
        Roadway("d", "foot", 4.4, 3.4, via=((4.0, 52.0, 0.0),)),
        Roadway("foot", "top", 4.8, 3.6, roughness=0.1),
        Roadway("top", "u1", 4.4, 3.2, roughness=0.12),
        Roadway("top", "u2", 4.2, 3.2, roughness=0.1),
        Roadway("u1", "u3", 4.6, 3.4, roughness=0.15),
        Roadway("u2", "u3", 4.0, 3.0, "rectangular", 0.05),
        Roadway("top", "u4"),
        Roadway("u1", "u5", 3.8, 3.0),
    )
    route = (
        "start",
        "a",
        "b",
        "c",
        "d",
        "foot",
        "top",
        "u2",
        "u3",
        "u1",
        "top",
        "foot",
        "d",
        "a",
        "b",
        "end",
    )
    return MineScenario("ramp", nodes, roadways, route, relief=0.05, seed=seed)


def drift(seed: int) -> MineScenario:
    """A straight, nearly smooth drift of 160 m between two crossings: it all looks the same."""
    nodes: dict[str, Point] = {
        "start": (-34.0, 6.0, 0.0),
        "west": (0.0, 0.0, 0.0),
        "east": (160.0, 0.0, 0.0),
        "wn": (-6.0, 30.0, 0.0),
        "ws": (8.0, -28.0, 0.0),
        "en": (176.0, 24.0, 0.0),
        "es": (168.0, -30.0, 0.0),
        "end": (190.0, -48.0, 0.0),
    }
    roadways = (
        Roadway("start", "west", roughness=0.14),
        Roadway("west", "east", 4.2, 3.2, roughness=0.01),
        Roadway("west", "wn", 3.8, 3.0, roughness=0.12),
        Roadway("west", "ws", 5.0, 3.6, roughness=0.15),
        Roadway("east", "en", 4.6, 3.4, roughness=0.12),
        Roadway("east", "es", 4.0, 3.2, roughness=0.15),
        Roadway("es", "end", roughness=0.12),
    )
    return MineScenario("drift", nodes, roadways, ("start", "west", "east", "es", "end"), relief=0.0, seed=seed)


def pillars(seed: int) -> MineScenario:
    """Room and pillar with pillars of six metres and a few larger ones, another plan for every seed."""
    columns, rows, pitch, wiggle = 6, 5, 12.0, 0.6
    rng = np.random.default_rng([seed, 6])
    nodes: dict[str, Point] = {}
    for i, j in np.ndindex(columns, rows):
        x, y = pitch * np.array([i, j]) + rng.uniform(-wiggle, wiggle, 2)
        nodes[f"{i}.{j}"] = (float(x), float(y), 0.0)
    across = [(f"{i}.{j}", f"{i + 1}.{j}") for i in range(columns - 1) for j in range(rows)]
    along = [(f"{i}.{j}", f"{i}.{j + 1}") for i in range(columns) for j in range(rows - 1)]
    rooms = tuple(
        Roadway(*pair, float(rng.uniform(4.8, 5.6)), 3.0, "rectangular", 0.06)
        for pair in _some_left([*across, *along], rng)
    )
    return _with_walk(MineScenario("pillars", nodes, rooms, (), relief=0.15, seed=seed), "0.0")


def _some_left(pairs: list[tuple[str, str]], rng: np.random.Generator) -> list[tuple[str, str]]:
    """Pairs of nodes without some between nodes of four, so that none has fewer than three left."""
    degree = Counter(node for pair in pairs for node in pair)
    kept: list[tuple[str, str]] = []
    for pair in pairs:
        if rng.uniform() < 0.2 and min(degree[node] for node in pair) == 4:
            degree.subtract(pair)
        else:
            kept.append(pair)
    return kept


def levels(seed: int) -> MineScenario:
    """Three levels with crossings above crossings, a spiral decline and a ramp, another plan for every seed."""
    return _with_walk(level_plan(seed), "portal")


def random(seed: int) -> MineScenario:
    """Another mine for every seed: all widths, profiles and roughnesses between scattered nodes."""
    scenario = random_plan(seed)
    return _with_walk(scenario, next(iter(scenario.nodes)))


SCENARIOS: dict[str, Callable[[int], MineScenario]] = {
    "demo": demo,
    "grid": grid,
    "ramp": ramp,
    "drift": drift,
    "random": random,
    "levels": levels,
    "pillars": pillars,
    "coal-tunnel": coal_tunnel,
    "coal-tunnel-1km": partial(coal_tunnel, length=LONG_M),
    "roadway": roadway,
    "roadway-consumer": partial(roadway, imu=CONSUMER),
}


def plan(name: str, seed: int = 0) -> MineScenario:
    """Plan of the built-in mine ``name``; `InputFileError` with the nearest name where there is none."""
    if name not in SCENARIOS:
        near = difflib.get_close_matches(name, SCENARIOS, n=1, cutoff=0.4)
        known = f"known: {', '.join(SCENARIOS)}, or give a mesh file"
        raise InputFileError(
            "no such scenario or file",
            file=name,
            mend=f"did you mean `{near[0]}`? ({known})" if near else known,
        )
    return SCENARIOS[name](seed)


def _with_walk(scenario: MineScenario, start: str) -> MineScenario:
    return replace(scenario, route=covering_walk(scenario, start))
