"""What the benches of pins count, on a straight flight by two intersections whose answers are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from localize import LocalizationResult
from semmap.geometry import se3
from semmap.intersections import Intersection, RoadwayGraph, SemanticMap, WallContour
from semmap.trajectory import Trajectory
from tools.bench.drift_mines import drifts
from tools.bench.edgar import passes, since_pin
from tools.simulator.roadways import MineScenario

SECOND = 1_000_000_000
_NONE = np.zeros(0, np.float32)


def straight(metres: int) -> Trajectory:
    """A metre a second along x."""
    stamps = np.arange(metres + 1) * SECOND
    return Trajectory("map", stamps, np.array([se3(np.eye(3), [float(k), 0.0, 1.3]) for k in range(metres + 1)]))


def mine_of(*x: float) -> SemanticMap:
    contour = WallContour(_NONE, _NONE.astype(bool), _NONE[None], _NONE[None].astype(bool))
    nothing = np.zeros(0)
    intersections = tuple(
        Intersection(k, np.array([at, 1.0, 0.0]), "T", nothing, nothing, 1.0, contour, np.zeros((0, 3), np.float32))
        for k, at in enumerate(x)
    )
    none = nothing.astype(np.int64)
    roads = RoadwayGraph(
        nothing.reshape(0, 3), none, none.astype(str), none.reshape(0, 2), nothing, nothing, nothing, nothing, [], []
    )
    return SemanticMap(intersections, roads, np.zeros(3), {})


def result_of(truth: Trajectory, pins: list[dict[str, object]], off: np.ndarray) -> LocalizationResult:
    poses = truth.poses.copy()
    poses[:, 1, 3] += off
    realtime = replace(truth, poses=poses)
    events = tuple({"stamp_ns": pin["stamp_ns"], "kind": "intersection", "pins": [pin]} for pin in pins)
    return LocalizationResult(realtime, realtime, truth, events, {}, ())


def pin(at_s: int, id: int, p_map: tuple[float, float, float]) -> dict[str, object]:
    return {"stamp_ns": at_s * SECOND, "keyframe": at_s, "id": id, "p_map": list(p_map)}


def test_passes_and_false_pins_are_counted() -> None:
    truth, there = straight(200), mine_of(50.0, 150.0)
    pins = [pin(48, 0, (48.0, 0.01, 1.3)), pin(120, 1, (121.0, 0.0, 1.3))]
    told = passes(result_of(truth, pins, np.zeros(201)), there, truth)
    assert (told.passes, told.constrained, told.pins, told.false) == (2, 1, 2, 1)


def test_errors_are_told_by_the_way_since_the_last_pin() -> None:
    truth = straight(100)
    rows = since_pin(result_of(truth, [pin(0, 0, (0.0, 0.0, 1.3))], np.arange(101) * 0.01), truth)
    assert [row["from_m"] for row in rows] == [0.0, 10.0, 25.0, 50.0, 100.0]
    assert rows[0]["max"] == pytest.approx(0.09) and rows[-1]["max"] == pytest.approx(1.0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_drifts_are_of_the_length_they_should_be(seed: int) -> None:
    mine = drifts(seed)
    assert isinstance(mine, MineScenario)
    x = [mine.nodes[f"c{k}"][0] for k in range(3)]
    assert all(150.0 <= step <= 300.0 for step in np.diff(x))
    assert sum(roadway.roughness == 0.0 for roadway in mine.roadways) == 2
