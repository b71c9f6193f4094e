"""Where UWB anchors would tell look-alike intersections apart: a smallest vertex cover of the graph of look-alikes.

An anchor that is heard at an intersection names it; of two that look alike one with an anchor is enough, for the other
is then the one where none is heard. Every pair therefore needs an anchor at one of its two ends at least.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

Neighbours = dict[int, set[int]]

_MOST_STEPS = 20_000
"""Branchings of the exact search of one group of look-alikes; beyond, the best cover found is given, as not proven."""


@dataclass(frozen=True, slots=True)
class Proposal:
    """Intersections to put an anchor at, by number, ascending.

    exact : no smaller set is enough. least : so many are needed at least.
    """

    intersections: tuple[int, ...]
    exact: bool
    least: int


def propose_anchors(pairs: Iterable[tuple[int, int]]) -> Proposal:
    """The smallest set of intersections that has one of each of the ``pairs``.

    Exact for each connected group of look-alikes that branch and bound gets through, greedy for the others.
    """
    chosen: set[int] = set()
    least, exact = 0, True
    for group in _groups(_neighbours(pairs)):
        cover, proven, bound = _cover(group)
        chosen |= cover
        exact &= proven
        least += bound
    return Proposal(tuple(sorted(chosen)), exact, least)


def _neighbours(pairs: Iterable[tuple[int, int]]) -> Neighbours:
    graph: Neighbours = {}
    for a, b in pairs:
        if a != b:
            graph.setdefault(a, set()).add(b)
            graph.setdefault(b, set()).add(a)
    return graph


def _groups(graph: Neighbours) -> Iterator[Neighbours]:
    """The connected parts, by their lowest number."""
    left = set(graph)
    for start in sorted(graph):
        if start not in left:
            continue
        group, waiting = {start}, [start]
        while waiting:
            new = graph[waiting.pop()] - group
            group |= new
            waiting += new
        left -= group
        yield {one: graph[one] for one in group}


def _cover(graph: Neighbours) -> tuple[set[int], bool, int]:
    """A cover of one group, whether it is a smallest one, and a number below which there is none."""
    search = _Search(_greedy(graph))
    search.branch(_copy(graph), set())
    if search.steps < _MOST_STEPS:
        return search.best, True, len(search.best)
    return search.best, False, _matching(graph)


class _Search:
    """Branch and bound: an intersection is in the cover, or all its look-alikes are."""

    def __init__(self, first: set[int]) -> None:
        self.best, self.steps = first, 0

    def branch(self, graph: Neighbours, chosen: set[int]) -> None:
        """Look for smaller covers of ``graph`` together with what was ``chosen`` on the way."""
        waiting = [(graph, chosen)]
        while waiting and self.steps < _MOST_STEPS:
            graph, chosen = waiting.pop()
            self.steps += 1
            _take_leaves(graph, chosen)
            if len(chosen) + _matching(graph) >= len(self.best):
                continue
            if not graph:
                self.best = chosen
                continue
            most = max(sorted(graph), key=lambda one: len(graph[one]))
            others = set(graph[most])
            without, within = _copy(graph), graph
            for one in others:
                _remove(without, one)
            _remove(within, most)
            waiting += [(without, chosen | others), (within, chosen | {most})]


def _greedy(graph: Neighbours) -> set[int]:
    """The one with the most look-alikes, again and again; then what turned out not to be needed goes."""
    left, cover = _copy(graph), []
    while left:
        most = max(sorted(left), key=lambda one: len(left[one]))
        cover.append(most)
        _remove(left, most)
    chosen = set(cover)
    for one in cover:
        if graph[one] <= chosen - {one}:
            chosen.discard(one)
    return chosen


def _take_leaves(graph: Neighbours, chosen: set[int]) -> None:
    """Whoever has a single look-alike: that one is as good a choice as any."""
    leaves = [one for one in sorted(graph) if len(graph[one]) == 1]
    while leaves:
        leaf = leaves.pop()
        if len(graph.get(leaf, ())) != 1:
            continue
        (mate,) = graph[leaf]
        others = set(graph[mate])
        chosen.add(mate)
        _remove(graph, mate)
        leaves += sorted(one for one in others if len(graph.get(one, ())) == 1)


def _matching(graph: Neighbours) -> int:
    """Pairs that share no intersection: each needs an anchor of its own."""
    used: set[int] = set()
    count = 0
    for one in sorted(graph, key=lambda one: (len(graph[one]), one)):
        if one in used:
            continue
        mate = min((other for other in graph[one] if other not in used), default=None)
        if mate is not None:
            used |= {one, mate}
            count += 1
    return count


def _remove(graph: Neighbours, one: int) -> None:
    """Take an intersection out, and those that are left without look-alikes."""
    for other in graph.pop(one, set()):
        graph[other].discard(one)
        if not graph[other]:
            del graph[other]


def _copy(graph: Neighbours) -> Neighbours:
    return {one: set(others) for one, others in graph.items()}
