"""Roadways out of free space: niches go, branches stay, bends are joined, corners are marked."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from synthetic_mine import SyntheticMine, corner, straight, t_junction, x_junction

from maps.columns import columns_of
from maps.corners import corner_of
from maps.free_cells import split_ground_and_walls
from maps.pruning import pruned
from maps.roadways import Roadway
from maps.settings import FreeSpaceSettings, TopologySettings
from maps.topology import Topology, roadway_topology
from maps.views import free_space_of_views
from semmap.geometry import Array

SETTINGS = TopologySettings()


def topology_of(mine: SyntheticMine) -> Topology:
    columns = columns_of(mine.cloud(0.12), FreeSpaceSettings())
    return roadway_topology(split_ground_and_walls(columns, FreeSpaceSettings()), SETTINGS)


def road(a: int, b: int, length: float, half_width: float = 2.0) -> Roadway:
    at = np.arange(0.0, length + 0.1, 0.2)
    return Roadway((a, b), np.stack([at, 0.0 * at, 0.1 * at], axis=-1), np.full(len(at), half_width))


def test_a_straight_roadway_is_one_edge_between_loose_ends() -> None:
    topology = topology_of(straight().turned(0.5))
    assert len(topology.roadways) == 1
    assert_allclose(topology.roadways[0].length, 40.0, atol=3.0)
    assert_allclose(np.median(topology.roadways[0].clearance), 2.0, atol=0.2)
    assert not topology.open_ends


@pytest.mark.parametrize(("depth", "branches"), [(5.0, 1), (14.0, 3)])
def test_a_niche_is_no_branch(depth: float, branches: int) -> None:
    mine = SyntheticMine(((-25.0, 0.0, 25.0, 0.0, 4.0), (0.0, 0.0, 0.0, -2.0 - depth, 3.0)))
    assert len(topology_of(mine).roadways) == branches


def test_a_chamber_as_wide_as_long_is_no_branch() -> None:
    mine = SyntheticMine(((-25.0, 0.0, 25.0, 0.0, 4.0), (0.0, 0.0, 0.0, -10.0, 8.0)))
    assert len(topology_of(mine).roadways) == 1


def test_a_loop_around_a_pillar_block_is_kept() -> None:
    ring = [(0, 0, 20, 0), (20, 0, 20, 20), (20, 20, 0, 20), (0, 20, 0, 0)]
    legs = [(x0 - 1.5 * np.sign(x1 - x0), y0 - 1.5 * np.sign(y1 - y0), x1, y1, 3.0) for x0, y0, x1, y1 in ring]
    mine = SyntheticMine((*legs, (-20.0, 0.0, 1.0, 0.0, 3.0)))
    topology = topology_of(mine)
    degree = sorted(len(roads) for roads in topology.leaving().values())
    assert degree[-1] == 3
    assert len(topology.roadways) == 2 + len(topology.corners)


def test_pruning_takes_the_shortest_first_and_joins_what_is_left() -> None:
    roads = [road(0, 1, 20.0), road(1, 2, 3.0), road(1, 3, 2.0), road(2, 4, 20.0)]
    kept, niches = pruned(roads, frozenset(), SETTINGS)
    assert len(kept) == 1
    (niche,) = niches
    assert 0.0 < niche.standing < 0.3
    assert set(kept[0].nodes) == {0, 4}
    assert len(kept[0].axis) == len(road(0, 1, 20.0).axis) + len(road(1, 2, 3.0).axis) + len(road(2, 4, 20.0).axis) - 2


def test_an_end_that_goes_on_unseen_needs_only_leave_its_mouth() -> None:
    roads = [road(0, 1, 20.0), road(1, 2, 20.0), road(1, 3, 5.0)]
    assert len(pruned(roads, frozenset(), SETTINGS)[0]) == 1
    assert len(pruned(roads, frozenset({3}), SETTINGS)[0]) == 3
    assert len(pruned([*roads[:2], road(1, 3, 3.0)], frozenset({3}), SETTINGS)[0]) == 1


def test_a_loop_on_a_stem_survives_pruning() -> None:
    kept, _ = pruned([road(0, 1, 20.0), road(1, 1, 30.0), road(1, 2, 2.0)], frozenset(), SETTINGS)
    assert sorted(r.nodes for r in kept) == [(0, 1), (1, 1)]


def test_leaving_lists_every_roadway_from_its_node() -> None:
    topology = topology_of(x_junction())
    centre = max(topology.leaving().items(), key=lambda item: len(item[1]))
    assert len(centre[1]) == 4
    for leg in centre[1]:
        assert leg.nodes[0] == centre[0]
        assert_allclose(leg.axis[0], topology.nodes[centre[0]], atol=1.0)


def test_views_mark_where_the_roadway_goes_on_unseen() -> None:
    mine = t_junction()
    space = free_space_of_views([mine.view((x, 0.0), seed=x + 9) for x in (-4, -2, 0)], FreeSpaceSettings())
    topology = roadway_topology(space, SETTINGS)
    loose = [node for node, roads in topology.leaving().items() if len(roads) == 1]
    assert len(loose) == 3
    assert topology.open_ends == frozenset(loose)


def turning(turn_deg: float, radius: float) -> Array:
    """An axis of 40 m that turns left on an arc of the given radius, half way."""
    arc = radius * np.radians(turn_deg)
    s = np.arange(0.0, 40.0, 0.2)
    heading = np.clip((s - 20.0 + 0.5 * arc) / max(arc, 1e-9), 0.0, 1.0) * np.radians(turn_deg)
    return np.cumsum(0.2 * np.stack([np.cos(heading), np.sin(heading), 0.1 + 0.0 * s], axis=-1), axis=0)


@pytest.mark.parametrize(
    ("turn_deg", "radius", "found"), [(90, 1.0, True), (70, 2.0, True), (45, 1.0, False), (90, 20.0, False)]
)
def test_a_corner_is_sharp(turn_deg: float, radius: float, found: bool) -> None:
    axis = turning(turn_deg, radius)
    found_corner = corner_of(Roadway((0, 1), axis, np.full(len(axis), 2.0)), SETTINGS.corner_deg, SETTINGS)
    assert (found_corner is not None) == found
    if found_corner is not None:
        assert np.linalg.norm(found_corner.p - axis[100]) < 1.0
        assert_allclose(found_corner.at, 20.0, atol=1.0)


def test_a_split_gives_back_the_whole() -> None:
    whole = road(0, 1, 12.0)
    first, second = whole.split(5.0, 7)
    assert (first.nodes, second.nodes) == ((0, 7), (7, 1))
    assert_allclose([first.length, second.length], [5.0, 7.0], atol=0.25)
    joined = first.joined(second)
    assert joined.nodes == whole.nodes
    assert_allclose(joined.axis, whole.axis)
    assert_allclose(joined.reversed().reversed().clearance, whole.clearance)


@pytest.mark.parametrize("turn_deg", [75.0, 90.0, 110.0])
def test_the_node_of_a_corner_is_where_the_axes_meet(turn_deg: float) -> None:
    topology = topology_of(corner(turn_deg=turn_deg))
    assert len(topology.corners) == 1
    (node,) = topology.corners
    assert_allclose(topology.nodes[node], [0.0, 0.0, 0.0], atol=0.3)
    assert len(topology.leaving()[node]) == 2
