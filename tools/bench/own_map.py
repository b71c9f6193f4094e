"""A map made of a recording alone: loops closed on the way, how true it is, and a second robot that localizes in it.

    python -m tools.bench.own_map --mines demo:1 random:2 ramp:1

A row a mine: the first robot flies its route without a map. What it recorded becomes a point-cloud map and a semantic
database as by `semmap map`. A second robot, with other noise, flies the route backwards and is localized in that. The
map's frame is laid onto the truth by the first flight's best SE(3) fit; the second flight's errors are in that frame.
A view that closed a loop is false if it puts its intersection more than 0.3 m from where it was seen first.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from rich.console import Console

from localize import LocalizationResult, Localizer, LocalizeSettings
from maps.accumulate import ScanMapSettings
from maps.build import build_semantic_map
from maps.prior_map import PriorMap
from semmap.geometry import Array, transform
from semmap.measurements import Measurement
from semmap.rig import Rig
from semmap.trajectory import Trajectory
from tools.mapping import ScanMap
from tools.metrics import associate, best_alignment
from tools.run import stream
from tools.simulator import Mine, SimulationSettings, fly, scenario, simulate_measurements
from tools.tables import text_table

FALSE_M = 0.3
HEAD = (
    "mine", "length m", "odometry m", "loops m", "max m", "views", "false", "surface median m", "p95 m",
    "found/plan", "second RMSE m", "real time max m", "known %",
)  # fmt: skip
_SAMPLE = 100_000


@dataclass(frozen=True, slots=True)
class Loops:
    """Views that closed loops, and those of them that were false."""

    views: int
    false: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mines", nargs="+", default=["demo:1", "random:1", "ramp:1"], metavar="SCENARIO:SEED")
    parser.add_argument("--without", nargs="*", default=[], help="sensors to leave out: wheel")
    parser.add_argument("--seconds", type=float, help="length of both flights")
    options = parser.parse_args()
    rows = [_row(*name.split(":"), options.without, options.seconds) for name in options.mines]
    Console(width=200).print(text_table(HEAD, rows))


def _row(name: str, seed: str, without: list[str], seconds: float | None) -> list[str]:
    mine = scenario(name, seed=int(seed))
    flight = fly(mine, settings=SimulationSettings(duration_s=seconds), seed=int(seed))
    measurements, truth = list(simulate_measurements(flight)), flight.truth()
    rig = flight.rig.without(*without)
    result = _localized(Localizer(rig), measurements)
    fit = best_alignment(associate(result.trajectory, truth))
    points = scan_map_points(rig, measurements, result)
    semantic_map = build_semantic_map(PriorMap(points.astype(np.float32), np.zeros(3)))
    off = surface_errors(mine, transform(fit, points))
    loops = loops_of(result, truth)
    errors, odometry = (_errors(one, truth) for one in (result.trajectory, result.odometry))

    back = fly(mine, _backwards(mine), settings=SimulationSettings(duration_s=seconds), seed=int(seed) + 100)
    second = _localized(Localizer(rig, semantic_map), simulate_measurements(back))
    final, live = (_errors(one, back.truth(), fit) for one in (second.trajectory, second.realtime))
    plan = sum(junction.branches >= 3 for junction in mine.junctions)
    found = sum(len(one.branch_bearings) >= 3 for one in semantic_map.intersections)
    return [
        f"{name} {seed}", f"{truth.length():.0f}", _rms(odometry), _rms(errors), f"{errors.max():.3f}",
        str(loops.views), str(loops.false), f"{np.median(off):.3f}", f"{np.percentile(off, 95):.3f}",
        f"{found}/{plan}", _rms(final), f"{live.max(initial=0.0):.3f}",
        f"{100.0 * len(live) / max(1, second.summary['scans']):.0f}",
    ]  # fmt: skip


def _localized(localizer: Localizer, measurements: Iterable[Measurement]) -> LocalizationResult:
    stream(localizer, measurements)
    return localizer.finish()


def scan_map_points(rig: Rig, measurements: Iterable[Measurement], result: LocalizationResult) -> Array:
    """The points (n, 3) of the map that a localized recording makes, in the run's own frame, as by `semmap map`."""
    scan_map = ScanMap(result, ScanMapSettings())
    alone = LocalizeSettings().without_loops()
    _localized(Localizer(rig, None, alone, on_keyframe=scan_map.add), measurements)
    return np.concatenate(list(scan_map.blocks()))


def _backwards(mine: Mine) -> Array:
    assert mine.scenario is not None
    route: Array = mine.scenario.route_floor()[::-1] + mine.origin
    return route


def surface_errors(mine: Mine, points: Array) -> Array:
    """Distances [m] of map points, in the truth's frame, from the rock; of some where there are many."""
    return mine.raycaster.clearance(points[:: max(1, len(points) // _SAMPLE)])


def loops_of(result: LocalizationResult, truth: Trajectory) -> Loops:
    """What the intersections that were seen again did."""
    first = {event["id"]: event for event in result.events if event["kind"] == "intersection_found"}
    pins = [pin for event in result.events if event["kind"] == "intersection" for pin in event["pins"]]
    at_first = _true_points(truth, [first[pin["id"]]["keyframe_ns"] for pin in pins], [first[p["id"]] for p in pins])
    again = _true_points(truth, [pin["stamp_ns"] for pin in pins], pins)
    return Loops(len(pins), int(np.sum(np.linalg.norm(at_first - again, axis=1) > FALSE_M)))


def _true_points(truth: Trajectory, stamps: list[int], seen: list[dict[str, Array]]) -> Array:
    """Where (n, 3) points ``p_imu`` really are that were seen at some stamps."""
    if not seen:
        return np.zeros((0, 3))
    T = truth.at(np.array(stamps, np.int64))
    p_imu = np.array([one["p_imu"] for one in seen])
    points: Array = np.einsum("nij,nj->ni", T[:, :3, :3], p_imu) + T[:, :3, 3]
    return points


def _errors(trajectory: Trajectory, truth: Trajectory, fit: Array | None = None) -> Array:
    """Position errors (n,) [m] after a given fit, or the best."""
    if not len(trajectory):
        return np.zeros(0)
    pairs = associate(trajectory, truth)
    return pairs.aligned(best_alignment(pairs) if fit is None else fit).position_errors()


def _rms(errors: Array) -> str:
    return f"{np.sqrt(np.mean(errors**2)):.3f}" if len(errors) else "none"


if __name__ == "__main__":
    main()
