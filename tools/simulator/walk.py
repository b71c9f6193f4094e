"""A walk through a plan that passes every roadway between two junctions, without turning round if it can."""

from __future__ import annotations

from collections import deque

import numpy as np

from tools.simulator.roadways import MineScenario

_LONGEST = 700.0
"""[m] after which the walk ends, so that large plans do not make endless recordings."""


def covering_walk(scenario: MineScenario, start: str) -> tuple[str, ...]:
    """Node names of the walk. Dead ends are left out, but for the start."""
    neighbours = _neighbours(scenario)
    wanted = {
        frozenset((a, b)) for a in neighbours for b in neighbours[a] if min(len(neighbours[a]), len(neighbours[b])) > 1
    }
    walk = [start]
    length = 0.0
    while wanted and length < _LONGEST:
        way = _way_to_new(neighbours, wanted, walk)
        for node in way:
            length += float(np.linalg.norm(np.subtract(scenario.nodes[node], scenario.nodes[walk[-1]])))
            wanted.discard(frozenset((walk[-1], node)))
            walk.append(node)
    return tuple(walk)


def _neighbours(scenario: MineScenario) -> dict[str, list[str]]:
    neighbours: dict[str, list[str]] = {node: [] for node in scenario.nodes}
    for roadway in scenario.roadways:
        neighbours[roadway.start].append(roadway.end)
        neighbours[roadway.end].append(roadway.start)
    return neighbours


def _way_to_new(neighbours: dict[str, list[str]], wanted: set[frozenset[str]], walk: list[str]) -> list[str]:
    """Fewest nodes to and through a roadway not yet passed; turning round only if nothing else leads on."""
    came_from = walk[-2] if len(walk) > 1 else None
    for may_turn in (False, True):
        queue: deque[tuple[str | None, str, list[str]]] = deque([(came_from, walk[-1], [])])
        seen: set[tuple[str | None, str]] = set()
        while queue:
            before, here, way = queue.popleft()
            for there in neighbours[here]:
                if (there == before and not may_turn) or (here, there) in seen:
                    continue
                seen.add((here, there))
                if frozenset((here, there)) in wanted:
                    return [*way, there]
                queue.append((here, there, [*way, there]))
    raise AssertionError("a plan is connected")
