"""What a large map costs: a mine laid out many times on a grid, built with several workers and tile sizes.

    python -m tools.bench.scale --map MINE/prior_map.laz --copies 32 --workers 1 2 --tiles 20 50

Each build is the command `semmap build` in a process of its own. Memory is that of all its processes together, looked
at every 50 ms; "to one" is the time a point over that of the one mine. Without a map it takes a procedural mine.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from maps.las import save_laz, save_laz_blocks
from maps.prior_map import PriorMap, read_prior_map
from semmap.geometry import Array
from tools.simulator import scenario

_ROWS = 1_000_000
_GAP_M = 60.0
_LOOK_S = 0.05


@dataclass(frozen=True, slots=True)
class Cost:
    """Of one build: time on the clock and of all processors [s], peak of memory [bytes], SHA-256 of what it wrote."""

    workers: int
    tile: float
    seconds: float
    cpu_seconds: float
    peak: int
    sha256: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--map", type=Path, help="point cloud of one mine; a procedural one without")
    parser.add_argument("--copies", type=int, default=32)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--tiles", type=float, nargs="+", default=[20.0, 50.0], help="[m]")
    parser.add_argument("--dir", type=Path, help="where the large map goes for as long as it takes; /tmp without")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.dir) as name:
        directory = Path(name)
        one = options.map or procedural(directory / "one.laz")
        mine = read_prior_map(one)
        many = directory / "many.laz"
        lay_out(mine, options.copies, many)
        print(f"one mine: {len(mine):,} points; {options.copies} of them: {many.stat().st_size / 1e6:.0f} MB of LAZ")
        print("     points workers    tile      clock     a point  to one        CPU  to one  peak memory  content")
        if not compare(one, len(mine), many, options, directory):
            sys.exit("the content depends on tiles or workers")


def compare(one: Path, points: int, many: Path, options: argparse.Namespace, directory: Path) -> bool:
    """Print a line for each build and say whether all of a map wrote the same.

    First the first tile size with all numbers of workers, then the other sizes with the most workers.
    """
    first, most = options.tiles[0], max(options.workers)
    runs = [(workers, first) for workers in options.workers] + [(most, tile) for tile in options.tiles[1:]]
    built(one, directory / "one.h5", *runs[0])  # the first one compiles kernels
    small = {run: built(one, directory / "one.h5", *run) for run in runs[: len(options.workers)]}
    large = {run: built(many, directory / "many.h5", *run) for run in runs}
    for cost in small.values():
        print_line(points, cost, cost, first_of(small))
    for run, cost in large.items():
        scaled = small[run[0], first]
        print_line(points * options.copies, cost, scaled, first_of(large), options.copies)
    return all(cost.sha256 == first_of(costs).sha256 for costs in (small, large) for cost in costs.values())


def first_of(costs: dict[tuple[int, float], Cost]) -> Cost:
    """The one that the others are compared with."""
    return next(iter(costs.values()))


def print_line(points: int, cost: Cost, one: Cost, first: Cost, copies: int = 1) -> None:
    """One build; ``one`` is that of the one mine with as many workers, ``first`` the first of the same map."""
    print(
        f"{points:11,} {cost.workers:7} {cost.tile:5.0f} m {cost.seconds:8.1f} s {cost.seconds / points * 1e6:8.2f} us"
        f" {cost.seconds / one.seconds / copies:8.2f} {cost.cpu_seconds:8.1f} s"
        f" {cost.cpu_seconds / one.cpu_seconds / copies:8.2f} {cost.peak / 1e9:8.2f} GB"
        f"   {'the same' if cost.sha256 == first.sha256 else 'DIFFERENT'}",
        flush=True,
    )


def procedural(path: Path) -> Path:
    """A map of a mine out of the simulator, points 0.1 m apart."""
    save_laz(path, scenario("random", seed=1).sample(spacing=0.1, noise=0.01, seed=1))
    return path


def lay_out(mine: PriorMap, copies: int, path: Path) -> None:
    """Write the mine so many times side by side."""
    size = np.ptp(mine.points[:, :2], axis=0).astype(np.float64)
    step = np.ceil((size + _GAP_M) / 10.0) * 10.0
    save_laz_blocks(path, _copies(mine, copies, step), mine.origin)


def _copies(mine: PriorMap, copies: int, step: Array) -> Iterator[Array]:
    side = int(np.ceil(np.sqrt(copies)))
    for copy in range(copies):
        shift = mine.origin + [copy % side * step[0], copy // side * step[1], 0.0]
        for row in range(0, len(mine), _ROWS):
            yield mine.points[row : row + _ROWS] + shift


def built(cloud: Path, out: Path, workers: int, tile: float) -> Cost:
    """Build a database with `semmap build` and watch what it takes."""
    words = [sys.executable, "-m", "tools.cli", "build", cloud, "--out", out, "--workers", workers, "--tile", tile]
    begin, before = time.perf_counter(), _children_cpu()
    with subprocess.Popen([str(word) for word in words], stdout=subprocess.DEVNULL) as process:
        peak = 0
        while process.poll() is None:
            peak = max(peak, _memory(process.pid))
            time.sleep(_LOOK_S)
    if process.returncode:
        raise SystemExit(f"semmap build ended with {process.returncode}")
    seconds, cpu = time.perf_counter() - begin, _children_cpu() - before
    with out.open("rb") as file:
        return Cost(workers, tile, seconds, cpu, peak, hashlib.file_digest(file, "sha256").hexdigest())


def _children_cpu() -> float:
    used = os.times()
    return used.children_user + used.children_system


def _memory(pid: int) -> int:
    """Resident memory of a process and all below it [bytes]; pages that they share count for each."""
    total = 0
    with suppress(psutil.NoSuchProcess):  # it may just have ended
        for process in [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]:
            with suppress(psutil.NoSuchProcess):
                total += process.memory_info().rss
    return total


if __name__ == "__main__":
    main()
