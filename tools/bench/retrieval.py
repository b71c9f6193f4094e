"""How long one question to a large map takes, and whether the answer is that of scoring every intersection.

    python -m tools.bench.retrieval --rows 100000 --map DB.h5

Two maps of that many intersections are asked: crossings drawn at random, half of them seen only in part; and the
intersections of simulated mines and of the maps given, each many times over, wider and narrower and in other rock.
Questions are views of an intersection of the map from beside its middle, turned, in which up to half of the directions
are hidden; and such views of crossings that are in no map.
"""

from __future__ import annotations

import argparse
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from descriptors.index import ContourIndex, Match
from descriptors.settings import ContourSettings
from descriptors.wall_contour import RAYS_PER_SECTOR
from semmap.database import load
from semmap.geometry import Array
from semmap.intersections import WallContour
from tools.bench.crossings import contours_of, looked_at_from, partly_seen, random_crossings, rock
from tools.bench.mines import map_of
from tools.simulator import scenario

SETTINGS = ContourSettings()
SEEDS = range(1, 7)
"""Of the simulated mines."""
SMALL = 50
"""Intersections of a small map."""
CHECKED = 2
"""Questions of each kind that are also answered by scoring every intersection."""

Question = Callable[[ContourIndex, WallContour], list[Match]]
QUESTIONS: dict[str, Question] = {
    "best 1": lambda index, view: index.best(view, 1),
    "best 5": lambda index, view: index.best(view, 5),
    "best 20": lambda index, view: index.best(view, 20),
    "5 turned, 0.7": lambda index, view: index.turned(view, 0.7, at_most=5),
    "the same, yaw known": lambda index, view: index.turned(view, 0.7, at_most=5, yaw=1.0),
}


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Intersections (n): their contours, and the walls (n, rays) around them [m]."""

    name: str
    contours: WallContour
    walls: Array

    def part(self, rows: slice) -> World:
        return World(self.name, self.contours.at(rows), self.walls[rows])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=100_000)
    parser.add_argument("--views", type=int, default=100, help="questions of each kind")
    parser.add_argument("--map", type=Path, nargs="*", default=[], help="databases whose intersections are used, too")
    options = parser.parse_args()
    for world in (random_world(options.rows), mines_world(options.rows, options.map)):
        print(f"{world.name}: {construction(world)}")
        for size in (options.rows, SMALL):
            report(world.part(slice(size)), options.views)


def random_world(n: int) -> World:
    rng = np.random.default_rng(1)
    walls = random_crossings(n, SETTINGS, rng)
    hidden = np.where(rng.uniform(size=n) < 0.5, rng.uniform(0.0, 0.4, n), 0.0)
    return World("random", contours_of(walls, partly_seen(n, SETTINGS.sectors, hidden, rng), SETTINGS), walls)


def mines_world(n: int, databases: list[Path]) -> World:
    """Intersections of mines, each about n / number of them times; a fifth seen only in part."""
    maps = [load(path) for path in databases] + [map_of(scenario("random", seed=seed), seed) for seed in SEEDS]
    known = np.concatenate([there.contours.pwcv for there in maps])
    rng = np.random.default_rng(2)
    of = np.where(known > 0.0, known, 1.5 * SETTINGS.radius)[rng.integers(len(known), size=n)]
    walls = np.repeat(of * rng.uniform(0.85, 1.15, (n, 1)), RAYS_PER_SECTOR, axis=1)
    walls = looked_at_from(walls, rng.normal(0.0, 0.25, (n, 2)), rng.uniform(0.0, 2.0 * np.pi, n), SETTINGS)
    walls += rock(n, walls.shape[1], rng, 0.25)
    hidden = np.where(rng.uniform(size=n) < 0.2, rng.uniform(0.0, 0.4, n), 0.0)
    seen = partly_seen(n, SETTINGS.sectors, hidden, rng)
    return World(f"mines ({len(known)} intersections)", contours_of(walls, seen, SETTINGS), walls)


def views_of(walls: Array, rng: np.random.Generator) -> list[WallContour]:
    """Views of places (n) from beside their middle, turned, with up to half of the directions hidden."""
    n = len(walls)
    moved = looked_at_from(walls, rng.normal(0.0, 0.2, (n, 2)), rng.uniform(0.0, 2.0 * np.pi, n), SETTINGS)
    moved += rock(n, moved.shape[1], rng, 0.1)
    seen = partly_seen(n, SETTINGS.sectors, rng.uniform(0.0, 0.5, n), rng)
    stacked = contours_of(moved, seen, SETTINGS)
    return [stacked.at(k) for k in range(n)]


def construction(world: World) -> str:
    start = time.perf_counter()
    ContourIndex(world.contours, SETTINGS)
    seconds = time.perf_counter() - start
    tracemalloc.start()
    index = ContourIndex(world.contours, SETTINGS)
    kept, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return f"index of {len(index)} made in {seconds:.2f} s, {kept / 1e6:.0f} MB kept, {peak / 1e6:.0f} MB at most"


def report(world: World, count: int) -> None:
    """A line for each kind of question: milliseconds of the clock and of the processor, median and 95th percentile."""
    rng = np.random.default_rng(3)
    index = ContourIndex(world.contours, SETTINGS)
    rows = rng.integers(len(index), size=count)
    kinds = {
        "known": views_of(world.walls[rows], rng),
        "strange": views_of(random_crossings(count, SETTINGS, rng), rng),
    }
    for kind, views in kinds.items():
        exact = all(is_exhaustive(index, view) for view in views[:CHECKED])
        for name, question in QUESTIONS.items():
            question(index, views[0])
            clock, processor = np.array([milliseconds(question, index, view) for view in views]).T
            print(
                f"{len(index):7d} {kind:8s} {name:20s} {np.median(clock):6.1f} ({np.percentile(clock, 95):5.1f}) ms,"
                f" processor {np.median(processor):6.1f} ({np.percentile(processor, 95):5.1f}) ms,"
                f" {'equal to' if exact else 'DIFFERS from'} scoring all",
                flush=True,
            )


def milliseconds(question: Question, index: ContourIndex, view: WallContour) -> tuple[float, float]:
    clock, processor = time.perf_counter(), time.thread_time()
    question(index, view)
    return 1e3 * (time.perf_counter() - clock), 1e3 * (time.thread_time() - processor)


def is_exhaustive(index: ContourIndex, view: WallContour) -> bool:
    """Whether the best 20 have the rows, the scores and the order of the similarities of all."""
    scores = index.similarities(view)
    order = np.argsort(-scores, kind="stable")[:20]
    return [(match.row, match.pwcv) for match in index.best(view, 20)] == [(row, scores[row]) for row in order]


if __name__ == "__main__":
    main()
