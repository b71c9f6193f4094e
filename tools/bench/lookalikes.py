"""Mines whose crossings look alike: does it pin to the right ones, notice that it was carried off, start anywhere?

    python -m tools.bench.lookalikes --cache DIR
    python -m tools.bench.lookalikes --cache DIR --kidnap 4
    python -m tools.bench.lookalikes --cache DIR --starts 20

LiDAR and IMU, no wheel, along the route of each mine or ``--metres`` of it, with a map of its rock. A pass through a
stored intersection is constrained if that pins a keyframe within 12 m of it; a pin is false if it puts its keyframe
more than 0.3 m off. A pose in real time is wrong if it is more than 0.3 m off, and further than its covariance allows.

--kidnap : cut and gone on with elsewhere, so many times without a gap and as many times after 4 s of silence.
--starts : begins in motion at random moments, each until a pose is published.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from localize import LocalizationResult, Localizer
from localize.results import Event, Update
from semmap import database
from semmap.geometry import Array
from semmap.intersections import SemanticMap
from semmap.measurements import Measurement
from semmap.rig import Rig
from semmap.trajectory import Trajectory
from tools.bench.drift_mines import MAX_RANGE_M, drifts
from tools.bench.edgar import FALSE_M, Found, measurements, passes, starts
from tools.bench.mines import errors, map_of
from tools.bench.odometry_cache import Recorded
from tools.bench.odometry_recordings import STEADY, Plan, mine_of, recorded
from tools.progress import progress_bar
from tools.simulator import SCENARIOS, MineScenario, Roadway, dig
from tools.tables import text_table

SILENCE_S = 4.0
KIDNAPPED_M = 10.0
"""The robot is carried off at least so far."""
START_M = 400.0
"""Flown from a start, at the most."""
_TELLING = 16.3
"""One of a thousand right poses is off by more than this, squared and normalised."""


def twins(seed: int) -> MineScenario:
    """Twelve crossings of one plan at scattered places: all roadways alike, and straight where they meet."""
    rng = np.random.default_rng([seed, 11])
    columns, rows, straight = 4, 3, 14.0
    nodes = {
        f"{i}.{j}": (55.0 * i + rng.uniform(-6.0, 6.0), 55.0 * j + rng.uniform(-6.0, 6.0), float(rng.normal(0.0, 0.5)))
        for i, j in np.ndindex(columns, rows)
    }

    def between(start: str, end: str, axis: int) -> Roadway:
        step = straight * np.eye(3)[axis]
        first, last = np.array(nodes[start]) + step, np.array(nodes[end]) - step
        via = tuple((float(x), float(y), float(z)) for x, y, z in (first, last))
        return Roadway(start, end, 4.6, 3.2, roughness=0.08, via=via)

    def stub(node: str, axis: int, sign: float) -> Roadway:
        x, y, z = (np.array(nodes[node]) + sign * (straight + 8.0) * np.eye(3)[axis]).tolist()
        nodes[f"{node}{'xy'[axis]}"] = (x, y, z)
        return Roadway(node, f"{node}{'xy'[axis]}", 4.6, 3.2, roughness=0.08)

    roadways = [between(f"{i}.{j}", f"{i + 1}.{j}", 0) for i in range(columns - 1) for j in range(rows)]
    roadways += [between(f"{i}.{j}", f"{i}.{j + 1}", 1) for i in range(columns) for j in range(rows - 1)]
    # those at the rim have headings where the others have neighbours
    roadways += [stub(f"{i}.{j}", 0, sign) for j in range(rows) for i, sign in ((0, -1.0), (columns - 1, 1.0))]
    roadways += [stub(f"{i}.{j}", 1, sign) for i in range(columns) for j, sign in ((0, -1.0), (rows - 1, 1.0))]
    route = [f"{i if j % 2 == 0 else columns - 1 - i}.{j}" for j in range(rows) for i in range(columns)]
    return MineScenario("twins", nodes, tuple(roadways), tuple(route), relief=0.1, seed=seed)


MINES: dict[str, Plan] = {
    "grid": Plan(SCENARIOS["grid"], {}, STEADY),
    "drifts": Plan(drifts, {"max_range": MAX_RANGE_M}, STEADY),
    "pillars": Plan(SCENARIOS["pillars"], {}, STEADY),
    "levels": Plan(SCENARIOS["levels"], {}, STEADY),
    "twins": Plan(twins, {}, STEADY),
    "random": Plan(SCENARIOS["random"], {}, STEADY),
    "demo": Plan(SCENARIOS["demo"], {}, STEADY),
}


@dataclass(frozen=True, slots=True)
class Row:
    """One flight [m]; known_s is when a pose was published first [s]."""

    metres: float
    passes: int
    constrained: int
    pins: int
    false: int
    wrong_poses: int
    known_s: float
    realtime_max: float
    rmse: float


@dataclass(frozen=True, slots=True)
class Kidnap:
    """One cut [s]: gap_s of silence; after how long it was noticed and the place found again, NaN if never; poses
    published that were wrong, and the largest error of all after it was found again [m]."""

    at_s: float
    gap_s: float
    noticed_s: float
    found_s: float
    wrong_poses: int
    error_m: float


def row_of(result: LocalizationResult, updates: list[Update], there: SemanticMap, truth: Trajectory) -> Row:
    """Figures of a flight."""
    told, live = passes(result, there, truth), errors(result.realtime, truth)
    first_ns = result.realtime.stamps_ns[0] if len(result.realtime) else None
    known_s = float("nan") if first_ns is None else float(first_ns - result.odometry.stamps_ns[0]) * 1e-9
    final = errors(result.trajectory, truth)
    return Row(
        truth.length(), told.passes, told.constrained, told.pins, told.false, wrong_poses(updates, truth), known_s,
        float(live.max(initial=0.0)), float(np.sqrt(np.mean(final**2))) if len(final) else float("nan"),
    )  # fmt: skip


def wrong_poses(updates: list[Update], truth: Trajectory) -> int:
    """How many published poses are off by more than is allowed and more than they say."""
    count = 0
    for update, off in zip(updates, _off(updates, truth), strict=True):
        assert update.T_map_imu is not None and update.covariance is not None
        e = update.T_map_imu[:3, :3].T @ off
        count += bool(np.linalg.norm(e) > FALSE_M and e @ np.linalg.solve(update.covariance[3:, 3:], e) > _TELLING)
    return count


def _off(updates: list[Update], truth: Trajectory) -> Array:
    """By how much published poses are off (n, 3) [m]."""
    positions = np.array([u.T_map_imu[:3, 3] for u in updates if u.T_map_imu is not None]).reshape(-1, 3)
    stamps = np.array([u.stamp_ns for u in updates if u.T_map_imu is not None], np.int64)
    return np.asarray(positions - truth.at(stamps)[:, :3, 3])


def run(rig: Rig, there: SemanticMap, stream: Iterator[Measurement]) -> tuple[LocalizationResult, list[Update]]:
    """The result, and what was published."""
    localizer = Localizer(rig, there)
    updates = [update for m in stream if (update := localizer.add(m)) is not None and update.T_map_imu is not None]
    return localizer.finish(), updates


def kidnaps(flight: Recorded, there: SemanticMap, truth: Trajectory, count: int, seed: int) -> Iterator[Kidnap]:
    """Cuts at random places, each without a gap and in a silence."""
    for first, second in _cuts(flight, truth, count, seed):
        for gap_s in (0.0, SILENCE_S):
            yield _kidnap(flight, there, truth, first, second, gap_s)


def _cuts(flight: Recorded, truth: Trajectory, count: int, seed: int) -> Iterator[tuple[int, int]]:
    """Numbers of the scan at which the recording is cut and of the one it goes on with, far from the first."""
    rng, n = np.random.default_rng([seed, 3]), len(flight.stamps_ns)
    positions = truth.at(flight.stamps_ns[:-1])[:, :3, 3]
    while count:
        first, second = int(rng.integers(n // 5, n // 2)), int(rng.integers(n // 2, 4 * n // 5))
        if np.linalg.norm(positions[first] - positions[second]) > KIDNAPPED_M:
            count -= 1
            yield first, second


def _kidnap(flight: Recorded, there: SemanticMap, truth: Trajectory, first: int, second: int, gap_s: float) -> Kidnap:
    cut_ns, on_ns = int(flight.stamps_ns[first]), int(flight.stamps_ns[second])
    back_ns = on_ns - cut_ns - round(gap_s * 1e9)
    result, updates = run(_rig(flight), there, carried_off(flight, first, second, back_ns))
    after = [replace(update, stamp_ns=update.stamp_ns + back_ns) for update in updates if update.stamp_ns > cut_ns]
    noticed = [event["stamp_ns"] for event in result.events if event["stamp_ns"] > cut_ns and _notices(event)]
    again = [update for update in after if noticed and update.stamp_ns - back_ns > noticed[0]]
    return Kidnap(
        (cut_ns - int(flight.stamps_ns[0])) * 1e-9, gap_s,
        (noticed[0] + back_ns - on_ns) * 1e-9 if noticed else float("nan"),
        (again[0].stamp_ns - on_ns) * 1e-9 if again else float("nan"), wrong_poses(after, truth),
        float(np.linalg.norm(_off(again, truth), axis=1).max(initial=0.0)),
    )  # fmt: skip


def _notices(event: Event) -> bool:
    return event["kind"] == "odometry_broken" or (event["kind"] == "state" and event["after"] in ("suspect", "lost"))


def carried_off(flight: Recorded, first: int, second: int, back_ns: int) -> Iterator[Measurement]:
    """The recording before scan number ``first``, then from number ``second`` on with stamps earlier by ``back_ns``."""
    for m in measurements(flight):
        if m.stamp_ns >= flight.stamps_ns[first]:
            break
        yield m
    for m in measurements(flight, second):
        if m.stamp_ns >= flight.stamps_ns[second]:
            yield replace(m, stamp_ns=m.stamp_ns - back_ns)


def _rig(flight: Recorded) -> Rig:
    return Rig.model_validate(flight.about["rig"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mines", nargs="*", default=["grid", "drifts", "pillars", "levels", "twins"], choices=MINES)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--metres", type=float, help="of the route; all of it without")
    parser.add_argument("--kidnap", type=int, default=0, help="cuts a mine instead of its flight")
    parser.add_argument("--starts", type=int, default=0, help="random starts a mine instead of its flight")
    parser.add_argument("--cache", type=Path, default=Path("bench_recordings"))
    options = parser.parse_args()
    rows: list[tuple[str, Row | Kidnap | Found]] = []
    for name in options.mines:
        plan = MINES[name]
        with progress_bar("simulating") as advance:
            flight = recorded(
                name, options.cache, metres=options.metres, seed=options.seed, plan=plan, progress=advance
            )  # fmt: skip
        there, truth = _map_of(plan, options.seed, options.cache / f"{name}-{options.seed}.h5"), _truth(flight)
        if options.kidnap:
            told: Iterable[Row | Kidnap | Found] = kidnaps(flight, there, truth, options.kidnap, options.seed)
        elif options.starts:
            told = starts(flight, there, options.starts, START_M)
        else:
            told = [row_of(*run(_rig(flight), there, measurements(flight)), there, truth)]
        for row in told:
            rows.append((name, row))
            print(name, row, flush=True)
    head = ("mine", *(field.name for field in fields(rows[0][1])))
    Console(width=140).print(text_table(head, [[name, *map(_cell, astuple(row))] for name, row in rows]))


def _map_of(plan: Plan, seed: int, path: Path) -> SemanticMap:
    """The mine's database, kept beside its recording."""
    if not path.exists():
        database.save(map_of(dig(mine_of(plan, seed)), seed), path)
    return database.load(path)


def _truth(flight: Recorded) -> Trajectory:
    return Trajectory("map", *flight.truth())


def _cell(value: float | bool) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
