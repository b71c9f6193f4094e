"""A prior map into a semantic map, end to end: frames, graph, descriptors, and the benchmark mine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from synthetic_mine import SyntheticMine

from descriptors.similarity import similarity
from maps.build import build_semantic_map
from maps.describe import Neighbourhoods, thinned
from maps.prior_map import PriorMap, read_prior_map
from maps.settings import MapSettings
from semmap.errors import CloudError
from semmap.geometry import Array
from semmap.intersections import SemanticMap

MINE = Path(__file__).resolve().parents[3] / "shared" / "data" / "edgar_mine"
LADDER = SyntheticMine(
    (
        (-25.0, 0.0, 45.0, 0.0, 4.5),
        (0.0, 0.0, 0.0, 20.0, 3.5),
        (20.0, 0.0, 20.0, 20.0, 4.0),
        (-1.75, 20.0, 40.0, 20.0, 4.0),
        (20.0, 0.0, 20.0, -25.0, 3.0),
    )
)
"""A loop with a T, an X and a T, a corner, and four dead ends."""


def prior(cloud: Array, origin: Array | None = None) -> PriorMap:
    return PriorMap(cloud.astype(np.float32), np.zeros(3) if origin is None else origin, {"mine.ply": "0" * 64})


@pytest.fixture(scope="module")
def ladder() -> SemanticMap:
    return build_semantic_map(prior(LADDER.cloud()))


def test_every_intersection_is_found_once(ladder: SemanticMap) -> None:
    kinds = {(round(p[0] / 20.0), round(p[1] / 20.0)): i.kind for i in ladder.intersections for p in [i.p_map]}
    assert kinds == {(0, 0): "T", (1, 0): "X", (1, 1): "T", (0, 1): "L"}
    assert_array_equal([i.id for i in ladder.intersections], np.arange(4))


def test_the_graph_joins_them_by_roadways_of_the_right_length(ladder: SemanticMap) -> None:
    roads = ladder.roadways
    assert (roads.node_intersection >= 0).sum() == 4
    assert (roads.node_intersection < 0).sum() == 4
    assert len(roads.edge_nodes) == 8
    at = {i.id: (round(i.p_map[0] / 20.0), round(i.p_map[1] / 20.0)) for i in ladder.intersections}
    between = {
        frozenset(at[int(roads.node_intersection[n])] for n in ends): length
        for ends, length in zip(roads.edge_nodes, roads.edge_length, strict=True)
        if (roads.node_intersection[ends] >= 0).all()
    }
    assert set(between) == {
        frozenset(pair) for pair in ({(0, 0), (1, 0)}, {(1, 0), (1, 1)}, {(1, 1), (0, 1)}, {(0, 1), (0, 0)})
    }
    assert_allclose(list(between.values()), 20.0, atol=1.5)
    for ends, axis in zip(roads.edge_nodes, roads.edge_axes, strict=True):
        assert_allclose(axis[[0, -1]], roads.node_p_map[ends])
        assert np.abs(axis[:, 2]).max() < 0.05


def test_contours_show_all_round_and_clouds_lie_around_the_point(ladder: SemanticMap) -> None:
    settings = MapSettings()
    for i in ladder.intersections:
        assert i.contour.pwcv.shape == (settings.contour.sectors,)
        assert i.contour.cwc.shape == (settings.contour.layers, settings.contour.sectors)
        assert i.contour.pwcv_observed.mean() > 0.97
        assert i.contour.pwcv.max() <= settings.contour.radius
        assert i.cloud.dtype == np.float32
        assert 1000 < len(i.cloud) < 60000
        assert np.hypot(i.cloud[:, 0], i.cloud[:, 1]).max() < settings.cloud_radius
        assert -0.1 < i.cloud[:, 2].min() < 0.1


def test_mine_grid_coordinates_lose_nothing(ladder: SemanticMap) -> None:
    origin = np.array([3_512_000.0, 5_704_000.0, -800.0])
    far = build_semantic_map(prior(LADDER.cloud(), origin))
    for near, moved in zip(ladder.intersections, far.intersections, strict=True):
        assert_allclose(moved.p_map - origin, near.p_map, atol=1e-6)
        assert_array_equal(moved.contour.pwcv, near.contour.pwcv)
    assert_allclose(far.roadways.node_p_map - origin, ladder.roadways.node_p_map, atol=1e-6)


def test_a_turned_mine_gives_the_same_places_and_contours(ladder: SemanticMap) -> None:
    yaw = 0.62
    turned = build_semantic_map(prior(LADDER.turned(yaw).cloud(seed=3)))
    for i in ladder.intersections:
        expected = LADDER.turned(yaw).R @ i.p_map[:2]
        twin = min(turned.intersections, key=lambda other: float(np.linalg.norm(other.p_map[:2] - expected)))
        assert np.linalg.norm(twin.p_map[:2] - expected) < 0.35
        assert twin.kind == i.kind
        match = similarity(i.contour, twin.contour)
        assert match.score > 0.85
        assert abs(match.yaw - yaw) < np.radians(2.0) or i.kind == "X"


def test_two_builds_are_equal(ladder: SemanticMap) -> None:
    again = build_semantic_map(prior(LADDER.cloud()))
    for a, b in zip(ladder.intersections, again.intersections, strict=True):
        assert_array_equal(a.p_map, b.p_map)
        assert_array_equal(a.cloud, b.cloud)
        assert_array_equal(a.contour.cwc, b.contour.cwc)


def test_settings_and_sources_are_kept_and_progress_is_told() -> None:
    settings = MapSettings(cloud_voxel=0.3, cloud_radius=6.0)
    calls: list[tuple[int, int]] = []
    semantic_map = build_semantic_map(
        prior(LADDER.cloud(0.2)), settings, progress=lambda done, total: calls.append((done, total))
    )
    assert MapSettings.model_validate(dict(semantic_map.settings)) == settings
    assert semantic_map.sources == {"mine.ply": "0" * 64}
    assert all(np.hypot(*i.cloud[:, :2].T).max() < 6.0 for i in semantic_map.intersections)
    assert calls[0][0] == 0
    assert calls[-1][0] == calls[-1][1]


def test_a_map_without_intersections_is_empty_and_one_without_floor_an_error() -> None:
    single = build_semantic_map(prior(SyntheticMine(((0.0, 0.0, 40.0, 0.0, 4.0),)).cloud()))
    assert len(single) == 0
    assert len(single.roadways.edge_nodes) == 1
    with pytest.raises(CloudError, match="no points"):
        build_semantic_map(prior(np.zeros((0, 3))))


def test_neighbourhoods_agree_with_a_search_of_all_points() -> None:
    points = np.random.default_rng(4).uniform([-40, -30, -6], [50, 20, 15], (20000, 3)).astype(np.float32)
    index = Neighbourhoods(points)
    for p in ([0.0, 0.0, 0.0], [-44.0, 10.0, 2.0], [49.0, -31.0, 0.0], [200.0, 0.0, 0.0]):
        here = np.array(p)
        near = np.hypot(*(points[:, :2].astype(float) - here[:2]).T) < 7.0
        assert_array_equal(index.around(here, 7.0), points[near].astype(float))


def test_thinning_keeps_one_mean_for_each_voxel() -> None:
    points = np.random.default_rng(5).uniform(-1.0, 1.0, (5000, 3))
    thin = thinned(points, 0.5)
    assert len(thin) == 64
    centres = np.floor(thin / 0.5)
    assert len(np.unique(centres, axis=0)) == 64
    assert_allclose(thin.mean(axis=0), points.mean(axis=0), atol=0.02)


@pytest.mark.skipif(not MINE.is_dir(), reason="the benchmark mine is not beside the repository (shared/data)")
def test_benchmark_mine() -> None:
    """Recall, precision, place and branches against the 36 reference junctions (issue 3)."""
    rows = [line.split(",") for line in (MINE / "junctions.csv").read_text().splitlines()[1:]]
    reference = np.array([[float(row[1]), float(row[2])] for row in rows])
    branches = np.array([int(row[3]) for row in rows])
    found = build_semantic_map(read_prior_map(MINE / "prior_map.laz")).intersections
    p = np.array([one.p_map[:2] for one in found])
    distance = np.linalg.norm(reference[:, None] - p, axis=-1)
    recalled = distance.min(axis=1) < 4.0
    assert recalled.mean() >= 0.95
    assert (distance.min(axis=0) < 4.0).mean() >= 0.85
    assert np.median(distance.min(axis=1)[recalled]) < 1.0
    nearest = [len(found[k].branch_bearings) for k in distance.argmin(axis=1)]
    assert (np.array(nearest) == branches)[recalled].mean() >= 0.9
