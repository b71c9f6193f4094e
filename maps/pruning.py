"""Dead ends that are no branches are taken out of a graph of roadways, and what then runs through is joined."""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from maps.roadways import Roadway
from maps.settings import TopologySettings
from semmap.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class Niche:
    """A dead end too short to be a branch.

    mouth : (3,) where it leaves the roadway [m].
    standing : how near it comes to being a branch, see `standing`; below 1.
    """

    mouth: Array
    standing: float


def pruned(
    roads: Iterable[Roadway], open_ends: frozenset[int], settings: TopologySettings
) -> tuple[tuple[Roadway, ...], tuple[Niche, ...]]:
    """The roadways without dead ends that are niches of the wall, the shortest taken first; and these niches."""
    graph, niches = _Graph(roads), []
    queue = [(road.length, number) for number, road in graph.roads.items() if graph.is_spur(road)]
    heapq.heapify(queue)
    while queue:
        _, number = heapq.heappop(queue)
        spur = graph.roads.get(number)
        if spur is None:
            continue
        spur = graph.root_first(spur)
        reached = standing(spur, open_ends, settings)
        if reached >= 1.0:
            continue
        niches.append(Niche(spur.axis[0], reached))
        graph.drop(number)
        for node in spur.nodes:
            graph.dissolve(node)
            for touched in graph.at[node] | {graph.newest}:
                if touched in graph.roads and graph.is_spur(graph.roads[touched]):
                    heapq.heappush(queue, (graph.roads[touched].length, touched))
    for node in list(graph.at):
        graph.dissolve(node)
    return tuple(graph.roads.values()), tuple(niches)


def standing(spur: Roadway, open_ends: frozenset[int], settings: TopologySettings) -> float:
    """How far a dead end, root first, meets what makes it a roadway: 1 and more where it is one.

    It must be long, and longer than wide; or be seen to go on out of its mouth.
    """
    mouth = float(spur.clearance[0])
    if spur.nodes[1] in open_ends:
        return spur.length / (settings.open_branch * mouth)
    width = 2.0 * float(np.median(spur.clearance))
    return min(spur.length / settings.min_branch, (spur.length - mouth) / (settings.min_aspect * width))


class _Graph:
    """Roadways by number, and the numbers of those that touch each node."""

    def __init__(self, roads: Iterable[Roadway]) -> None:
        self.roads: dict[int, Roadway] = {}
        self.at: dict[int, set[int]] = defaultdict(set)
        self.newest = -1
        for road in roads:
            self.add(road)

    def add(self, road: Roadway) -> None:
        self.newest += 1
        self.roads[self.newest] = road
        for node in road.nodes:
            self.at[node].add(self.newest)

    def drop(self, number: int) -> None:
        for node in set(self.roads.pop(number).nodes):
            self.at[node].discard(number)

    def is_spur(self, road: Roadway) -> bool:
        """Whether just one of its ends is loose."""
        return (len(self.at[road.nodes[0]]) == 1) != (len(self.at[road.nodes[1]]) == 1)

    def root_first(self, spur: Roadway) -> Roadway:
        return spur.reversed() if len(self.at[spur.nodes[0]]) == 1 else spur

    def dissolve(self, node: int) -> None:
        """Join the two roadways that meet at ``node``, if there are just two and neither is a loop."""
        if len(self.at[node]) != 2:
            return
        one, other = sorted(self.at[node])
        before, after = self.roads[one], self.roads[other]
        if before.nodes[0] == before.nodes[1] or after.nodes[0] == after.nodes[1]:
            return
        self.drop(one)
        self.drop(other)
        before = before.reversed() if before.nodes[0] == node else before
        after = after if after.nodes[0] == node else after.reversed()
        self.add(before.joined(after))
