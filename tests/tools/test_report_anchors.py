"""Anchors that tell look-alikes apart: a smallest vertex cover, checked against trying every set."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from tools.report.anchors import propose_anchors

Pairs = list[tuple[int, int]]


def smallest(pairs: Pairs) -> int:
    """Size of the smallest set with one of each pair, by trying them all."""
    nodes = sorted({node for pair in pairs for node in pair})
    for size in range(len(nodes) + 1):
        for some in combinations(nodes, size):
            if all(a in some or b in some for a, b in pairs):
                return size
    raise AssertionError


def random_pairs(rng: np.random.Generator, nodes: int, share: float) -> Pairs:
    return [(a, b) for a, b in combinations(range(nodes), 2) if rng.random() < share]


@pytest.mark.parametrize("seed", range(40))
def test_no_smaller_set_is_enough(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pairs = random_pairs(rng, int(rng.integers(2, 12)), float(rng.uniform(0.1, 0.9)))
    proposal = propose_anchors(pairs)
    assert all(a in proposal.intersections or b in proposal.intersections for a, b in pairs)
    assert proposal.exact
    assert len(proposal.intersections) == proposal.least == smallest(pairs)


def test_groups_do_not_disturb_each_other() -> None:
    star = [(0, k) for k in range(1, 6)]
    ring = [(10 + k, 10 + (k + 1) % 5) for k in range(5)]
    proposal = propose_anchors([*star, *ring])
    assert proposal.intersections[0] == 0 and len(proposal.intersections) == 1 + 3
    assert propose_anchors([]).intersections == ()


def test_a_group_too_large_to_prove_says_so_and_is_covered() -> None:
    rng = np.random.default_rng(1)
    pairs = random_pairs(rng, 220, 0.05)
    proposal = propose_anchors(pairs)
    chosen = set(proposal.intersections)
    assert all(a in chosen or b in chosen for a, b in pairs)
    assert not proposal.exact and proposal.least < len(chosen)


def test_all_alike_needs_all_but_one() -> None:
    proposal = propose_anchors(list(combinations(range(60), 2)))
    assert len(proposal.intersections) == 59
