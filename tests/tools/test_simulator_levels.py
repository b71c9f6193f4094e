"""Mines on several levels: what lies above what, how steep it is, and that the truth says so."""

from __future__ import annotations

import csv
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tools.simulator import Mine, MineScenario, Roadway, dig, plan
from tools.simulator.floor import on_floor
from tools.simulator.junctions import junctions_of, save_junctions
from tools.simulator.route import evenly
from tools.simulator.settings import MotionSettings

SEEDS = range(4)


@cache
def three_levels() -> Mine:
    return dig(plan("levels", 1), voxel=0.3)


def gaps(scenario: MineScenario, one: Roadway, other: Roadway) -> tuple[np.ndarray, np.ndarray]:
    """Between points of two axes: in plan, and from the roof of the lower to the floor of the upper."""
    a, b = scenario.axis(one)[:, None], scenario.axis(other)[None]
    rise = b[..., 2] - a[..., 2]
    return np.linalg.norm((b - a)[..., :2], axis=-1), np.abs(rise) - np.where(rise > 0.0, one.height, other.height)


@pytest.mark.parametrize("seed", SEEDS)
def test_there_is_rock_between_roadways_that_do_not_meet(seed: int) -> None:
    scenario = plan("levels", seed)
    for one, other in combinations(scenario.roadways, 2):
        if not {one.start, one.end} & {other.start, other.end}:
            apart, above = gaps(scenario, one, other)
            beside = apart > 0.5 * (one.width + other.width) + 1.5
            assert (beside | (above > 2.0)).all(), (one, other)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_spiral_falls_one_in_seven_for_more_than_a_turn_and_a_half(seed: int) -> None:
    scenario = plan("levels", seed)
    spiral = [r for r in scenario.roadways if r.via]
    axes = [scenario.axis(roadway) for roadway in spiral]
    centre = np.array([-28.0, 0.0])
    turned = sum(np.ptp(np.unwrap(np.arctan2(*(axis[:, :2] - centre).T))) for axis in axes)
    assert turned > 1.5 * 2.0 * np.pi
    fall = sum(axis[0, 2] - axis[-1, 2] for axis in axes)
    run = sum(np.linalg.norm(np.diff(axis[:, :2], axis=0), axis=1).sum() for axis in axes)
    assert fall / run == pytest.approx(1.0 / 7.0, rel=0.05)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_ramp_of_fifteen_degrees_passes_over_a_drift(seed: int) -> None:
    scenario = plan("levels", seed)
    ramp, drift = scenario.between("head", "foot"), scenario.between("f1", "under")
    axis = scenario.axis(ramp)
    climb = np.arctan2(axis[0, 2] - axis[-1, 2], np.linalg.norm((axis[0] - axis[-1])[:2]))
    assert np.degrees(climb) == pytest.approx(15.0, abs=0.5)
    apart, above = gaps(scenario, drift, ramp)
    assert apart.min() < 1.5
    assert above[apart < 4.0].min() > 2.0


@pytest.mark.parametrize("seed", SEEDS)
def test_crossings_lie_above_crossings(seed: int) -> None:
    p = np.array([junction.p_map for junction in junctions_of(plan("levels", seed)) if junction.branches >= 3])
    apart = np.linalg.norm((p[:, None] - p[None])[..., :2], axis=-1)
    rise = p[:, None, 2] - p[None, :, 2]
    assert ((apart < 4.0) & (rise > 8.0)).sum() >= 6


def test_levels_differ_from_seed_to_seed() -> None:
    assert plan("levels", 1) == plan("levels", 1)
    kinds = {tuple(junction.branches for junction in junctions_of(plan("levels", seed))) for seed in range(6)}
    assert len(kinds) > 3
    assert plan("levels", 1).nodes != plan("levels", 2).nodes


def test_the_true_junctions_lie_on_the_floor_of_their_level(tmp_path: Path) -> None:
    mine = three_levels()
    save_junctions(tmp_path / "junctions.csv", mine.junctions)
    with (tmp_path / "junctions.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    written = np.array([[float(row[axis]) for axis in ("x_m", "y_m", "z_m")] for row in rows])
    assert_allclose(written, [junction.p_map for junction in mine.junctions], atol=0.006)
    eyes = written + [0.0, 0.0, 1.5]
    down = mine.raycaster.cast(eyes, np.broadcast_to([0.0, 0.0, -1.0], eyes.shape)).distances
    assert_allclose(down, 1.5, atol=0.15)


@pytest.mark.parametrize("name", ["levels", "ramp"])
def test_the_floor_has_no_steps_where_roadways_meet(name: str) -> None:
    mine = dig(plan(name, 1), voxel=0.3)
    for roadway in mine.scenario.roadways:
        line = evenly(mine.scenario.axis(roadway) + mine.origin, 0.25)
        eyes = line + [0.0, 0.0, 1.2]
        down = mine.raycaster.cast(eyes, np.broadcast_to([0.0, 0.0, -1.0], eyes.shape)).distances
        steps = np.diff(eyes[:, 2] - down)
        assert np.abs(steps).max() < 0.2, roadway


@pytest.mark.parametrize("shift", [-3.0, 3.0])
def test_a_route_over_three_levels_is_put_on_the_floor_of_each(shift: float) -> None:
    route = three_levels().scenario.route_floor()
    put = on_floor(route + [0.0, 0.0, shift], three_levels(), MotionSettings().height)
    ways = [np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(p[:, :2], axis=0).T))]) for p in (put.points, route)]
    true = np.interp(ways[0] / ways[0][-1], ways[1] / ways[1][-1], route[:, 2])
    assert np.abs(put.points[:, 2] - true).max() < 0.6


@pytest.mark.parametrize("seed", SEEDS)
def test_pillars_are_all_crossings_and_corners(seed: int) -> None:
    scenario = plan("pillars", seed)
    junctions = junctions_of(scenario)
    assert len(junctions) == len(scenario.nodes)
    assert sorted({junction.branches for junction in junctions}) == [2, 3, 4]
    assert sum(junction.branches == 2 for junction in junctions) == 4
    assert plan("pillars", seed + 50).nodes != scenario.nodes
