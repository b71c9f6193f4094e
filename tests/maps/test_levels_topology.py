"""Roadways above each other: intersections, axes and the graph stay on their level, and climb with their floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from synthetic_mine import SyntheticMine, straight, t_junction, x_junction

from maps.build import build_semantic_map
from maps.prior_map import PriorMap
from semmap.geometry import Array
from semmap.intersections import SemanticMap

UP = np.array([0.0, 0.0, 1.0])


def mapped(*clouds: Array) -> SemanticMap:
    return build_semantic_map(PriorMap(np.concatenate(clouds).astype(np.float32), np.zeros(3)))


def rises(semantic_map: SemanticMap) -> Array:
    """Greatest difference in height along each roadway [m]."""
    return np.array([np.ptp(axis[:, 2]) for axis in semantic_map.roadways.edge_axes])


def test_stacked_levels_have_intersections_of_their_own() -> None:
    below, above = x_junction().turned(0.3), t_junction(5.0).turned(0.9)
    both = mapped(below.cloud(), above.cloud(seed=1) + 6.0 * UP)
    found = sorted((i.kind, round(float(i.p_map[2]), 1)) for i in both.intersections)
    assert found == [("T", 6.0), ("X", 0.0)]
    assert rises(both).max() < 0.2
    assert len(both.roadways.edge_nodes) == 7
    alone = {i.kind: i for mine in (below, above) for i in mapped(mine.cloud(seed=int(mine is above))).intersections}
    for one in both.intersections:
        assert_allclose(one.p_map[:2], alone[one.kind].p_map[:2], atol=1e-3)
        assert_allclose(one.contour.pwcv, alone[one.kind].contour.pwcv, atol=0.01)
        assert_allclose(len(one.cloud), len(alone[one.kind].cloud), rtol=1e-3)


@pytest.mark.parametrize("slope", [0.0, 0.26])
def test_a_ramp_that_passes_over_a_drift_meets_nothing(slope: float) -> None:
    drift = straight().cloud()
    ramp = replace(straight(), slope=(slope, 0.0)).cloud(seed=1)[:, [1, 0, 2]] + 6.5 * UP
    crossing = mapped(drift, ramp)
    assert len(crossing) == 0
    roads = crossing.roadways
    assert len(roads.edge_nodes) == 2
    assert_allclose(sorted(np.abs(roads.edge_slope)), [0.0, slope], atol=0.01)
    assert_allclose(roads.edge_length, 40.0 * np.sqrt(1.0 + roads.edge_slope**2), atol=0.8)
    assert_allclose(roads.edge_height, 3.0, atol=0.1)
    assert_allclose(roads.edge_width, 4.0, atol=0.3)


def spiral(turns: float, radius: float = 12.0, width: float = 4.0, slope: float = 0.13) -> Array:
    """Cloud of a decline that winds ``turns`` times over itself, 3 m high, closed at its ends."""
    rng, length = np.random.default_rng(0), 2.0 * np.pi * radius * turns
    count = int(length * 100)
    along, across, up = rng.uniform(0.0, length, (count, 8)), rng.uniform(-0.5, 0.5, (count, 8)), rng.random((count, 8))
    faces = [
        np.stack([along[:, :4].ravel(), width * across[:, :4].ravel(), np.repeat([[0, 0, 3, 3]], count, 0).ravel()]),
        np.stack([along[:, 4], np.full(count, 0.5 * width), 3.0 * up[:, 4]]),
        np.stack([along[:, 5], np.full(count, -0.5 * width), 3.0 * up[:, 5]]),
        np.stack([length * np.arange(2).repeat(1500), width * across[:3000, 6], 3.0 * up[:3000, 6]]),
    ]
    s, off, z = np.concatenate(faces, axis=1)
    angle, r = s / radius, radius + off
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z + slope * s])


def test_a_spiral_decline_is_one_roadway() -> None:
    wound = mapped(spiral(2.4))
    assert len(wound) == 0
    roads = wound.roadways
    assert roads.node_kind.tolist() == ["dead_end", "dead_end"]
    assert_allclose(roads.edge_length, 2.4 * 2.0 * np.pi * 12.0, rtol=0.01)
    assert_allclose(np.abs(roads.edge_slope), 0.13, atol=0.01)
    (profile,) = roads.edge_profiles
    assert_allclose(np.median(profile, axis=0), [4.0, 3.0], atol=0.3)
    (axis,) = roads.edge_axes
    assert_allclose(np.hypot(axis[4:-4, 0], axis[4:-4, 1]), 12.0, atol=0.5)


def test_a_roadway_that_leaves_a_spiral_makes_one_intersection_at_its_height() -> None:
    """The spiral climbs past the drift's mouth; two turns higher and lower nothing leaves it."""
    cloud = spiral(2.4)
    height = 0.13 * 2.0 * np.pi * 12.0
    drift = SyntheticMine(((12.0, 0.0, 45.0, 0.0, 4.0),)).cloud(seed=3) + height * UP
    away = np.hypot(drift[:, 0], drift[:, 1])
    mouth = (np.abs(cloud[:, 1]) < 2.0) & (cloud[:, 0] > 0.0) & (np.abs(cloud[:, 2] - height - 1.5) < 1.4)
    in_ring = (away < 14.0) & (np.abs(drift[:, 1]) > -1.0)
    joined = mapped(cloud[~(mouth & (np.hypot(cloud[:, 0], cloud[:, 1]) > 13.9))], drift[~in_ring])
    (one,) = joined.intersections
    assert len(one.branch_bearings) == 3
    assert_allclose(one.p_map[2], height, atol=0.3)
    assert np.linalg.norm(one.p_map[:2] - [12.5, 0.0]) < 1.5


def test_the_graph_turns_with_the_mine() -> None:
    ladder = SyntheticMine(
        ((-25, 0, 45, 0, 4.5), (0, 0, 0, 20, 3.5), (20, 0, 20, 20, 4.0), (-1.75, 20, 40, 20, 4.0)), slope=(0.1, -0.05)
    )
    straight_on = mapped(ladder.cloud())
    for yaw in (0.4, 1.9):
        turned = mapped(ladder.turned(yaw).cloud(seed=1))
        assert sorted(turned.roadways.node_kind) == sorted(straight_on.roadways.node_kind)
        assert sorted(i.kind for i in turned.intersections) == sorted(i.kind for i in straight_on.intersections)
        for name, off in (("edge_length", 1.5), ("edge_width", 0.3), ("edge_height", 0.1)):
            values = [np.sort(getattr(one.roadways, name)) for one in (turned, straight_on)]
            assert_allclose(*values, atol=off)
        there = straight_on.roadways.node_p_map[:, :2] @ ladder.turned(yaw).R.T
        nearest = np.linalg.norm(there[:, None] - turned.roadways.node_p_map[:, :2], axis=-1).min(axis=1)
        assert nearest.max() < 0.8
