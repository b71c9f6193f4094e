"""A random but diggable plan: scattered nodes, roadways that keep apart and do not meet too sharply."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from semmap.geometry import Array
from tools.simulator.roadways import MineScenario, Point, Roadway

_SIDE, _APART, _LONGEST = 120.0, 24.0, 52.0
_SHARPEST_DEG = 55.0
_CLEARANCE = 11.0
"""[m] at least between the axes of roadways that do not meet."""
_LOOPS = 0.55
"""Share of the diggable roadways that are dug although their ends are joined already."""
_TRIALS = 50
_FEWEST_CROSSINGS = 6


def random_plan(seed: int) -> MineScenario:
    """A mine of about 120 m by 120 m without a route, fully set by its seed."""
    rng = np.random.default_rng([seed, 4])
    for _ in range(_TRIALS):
        plan = _scatter(rng)
        edges = _dig(plan, rng)
        degree = np.bincount(np.array(edges).ravel(), minlength=len(plan))
        if (degree >= 3).sum() >= _FEWEST_CROSSINGS:
            return _scenario(plan, edges, degree, rng, seed)
    raise AssertionError("fifty scattered plans have six crossings")


def _scatter(rng: np.random.Generator) -> Array:
    """Plan positions (n, 2), none nearer than `_APART` to another, as many as a few hundred throws place."""
    placed: list[Array] = []
    for throw in rng.uniform(0.0, _SIDE, size=(600, 2)):
        if all(np.linalg.norm(throw - other) > _APART for other in placed):
            placed.append(throw)
    return np.array(placed)


def _dig(plan: Array, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Edges of the largest connected plan: short ones first, loops by chance."""
    corners = Delaunay(plan).simplices
    candidates = {tuple(sorted((int(t[i]), int(t[j])))) for t in corners for i, j in ((0, 1), (1, 2), (0, 2))}
    ordered = sorted(candidates, key=lambda e: float(np.linalg.norm(plan[e[0]] - plan[e[1]])))
    edges: list[tuple[int, int]] = []
    part = np.arange(len(plan))
    for a, b in ordered:
        joined = part[a] == part[b]
        if (joined and rng.uniform() > _LOOPS) or not _diggable(plan, edges, a, b):
            continue
        edges.append((a, b))
        part[part == part[b]] = part[a]
    largest = np.bincount(part).argmax()
    return [edge for edge in edges if part[edge[0]] == largest]


def _diggable(plan: Array, edges: list[tuple[int, int]], a: int, b: int) -> bool:
    if np.linalg.norm(plan[a] - plan[b]) > _LONGEST:
        return False
    for edge in edges:
        shared = {a, b} & set(edge)
        if not shared and _gap(plan[[a, b]], plan[list(edge)]) < _CLEARANCE:
            return False
        if shared and _angle_deg(plan, shared.pop(), (a, b), edge) < _SHARPEST_DEG:
            return False
    return True


def _gap(first: Array, second: Array) -> float:
    """Smallest distance [m] of two straight roadways, (2, 2) each, to a metre or so."""
    t = np.linspace(0.0, 1.0, 30)[:, None]
    p, q = (ends[0] + t * (ends[1] - ends[0]) for ends in (first, second))
    return float(np.linalg.norm(p[:, None] - q[None], axis=2).min())


def _angle_deg(plan: Array, node: int, first: tuple[int, int], second: tuple[int, int]) -> float:
    u, v = (plan[sum(edge) - node] - plan[node] for edge in (first, second))
    return float(np.degrees(np.arccos(np.clip(u @ v / np.linalg.norm(u) / np.linalg.norm(v), -1.0, 1.0))))


def _scenario(
    plan: Array, edges: list[tuple[int, int]], degree: NDArray[np.int64], rng: np.random.Generator, seed: int
) -> MineScenario:
    """Heights, sections and names for a plan; the first node is a dead end where there is one."""
    used = sorted({node for edge in edges for node in edge}, key=lambda node: (degree[node] != 1, node))
    dip = rng.normal(0.0, 0.03, size=2)
    floor = np.column_stack([plan, plan @ dip]).tolist()
    nodes: dict[str, Point] = {f"n{node}": (floor[node][0], floor[node][1], floor[node][2]) for node in used}
    roadways = tuple(_roadway(nodes, f"n{a}", f"n{b}", rng) for a, b in edges)
    return MineScenario("random", nodes, roadways, (), relief=float(rng.uniform(0.1, 0.5)), seed=seed)


def _roadway(nodes: dict[str, Point], start: str, end: str, rng: np.random.Generator) -> Roadway:
    """A roadway of random section, bent a little."""
    p, q = np.array(nodes[start]), np.array(nodes[end])
    aside = np.array([p[1] - q[1], q[0] - p[0], 0.0]) * rng.uniform(-0.06, 0.06)
    x, y, z = (0.5 * (p + q) + aside).tolist()
    width = float(rng.uniform(3.4, 5.6))
    return Roadway(
        start,
        end,
        width,
        float(np.clip(0.75 * width + rng.normal(0.0, 0.2), 2.8, 4.2)),
        "arched" if rng.uniform() < 0.7 else "rectangular",
        float(rng.choice([0.02, 0.06, 0.1, 0.15])),
        ((x, y, z),),
    )
