"""What a large database costs: writing it row by row, opening it, and looking at what a localizer looks at.

    python -m tools.bench.database --intersections 10000 --points 4000

The mine is a grid of made-up crossings; only sizes matter here. Times are medians; files are in the cache.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import overload

import numpy as np

from maps.settings import MapSettings
from semmap import database
from semmap.intersections import Intersection, RoadwayGraph, SemanticMap, WallContour

SPACING_M = 30.0


class MadeUpIntersections(Sequence[Intersection]):
    """Crossings on a grid with ``side`` a row; each is made when it is asked for and forgotten after."""

    def __init__(self, side: int, points: int) -> None:
        self._side, self._points = side, points

    def __len__(self) -> int:
        return self._side**2

    @overload
    def __getitem__(self, row: int) -> Intersection: ...
    @overload
    def __getitem__(self, row: slice) -> Sequence[Intersection]: ...
    def __getitem__(self, row: int | slice) -> Intersection | Sequence[Intersection]:
        if isinstance(row, slice):
            return tuple(self[k] for k in range(len(self))[row])
        if row >= len(self):
            raise IndexError(row)
        rng = np.random.default_rng(row)
        return Intersection(
            id=row,
            p_map=SPACING_M * np.array([row // self._side, row % self._side, 0.0]),
            kind="X",
            branch_bearings=0.5 * np.pi * np.arange(4.0),
            branch_widths=rng.uniform(3.0, 6.0, 4),
            quality=float(rng.random()),
            contour=_contour(rng),
            cloud=rng.normal(0.0, 5.0, (self._points, 3)).astype(np.float32),
        )


def _contour(rng: np.random.Generator) -> WallContour:
    settings = MapSettings().contour
    cells = (settings.layers, settings.sectors)
    cwc = rng.uniform(0.0, settings.radius, cells).astype(np.float32)
    return WallContour(cwc[0], rng.random(cells[1]) < 0.9, cwc, rng.random(cells) < 0.9)


def made_up_map(side: int, points: int) -> SemanticMap:
    """A grid of ``side`` by ``side`` crossings with a roadway between all neighbours."""
    number = np.arange(side**2).reshape(side, side)
    edges = np.concatenate(
        [
            np.stack([number[:-1], number[1:]], -1).reshape(-1, 2),
            np.stack([number[:, :-1], number[:, 1:]], -1).reshape(-1, 2),
        ]
    )
    p_map = SPACING_M * np.stack([number // side, number % side, 0 * number], axis=-1).reshape(-1, 3).astype(float)
    along = np.linspace(0.0, 1.0, round(SPACING_M) + 1)[:, None]
    roadways = RoadwayGraph(
        node_p_map=p_map,
        node_intersection=number.ravel(),
        node_kind=np.full(side**2, "intersection"),
        edge_nodes=edges,
        edge_length=np.full(len(edges), SPACING_M),
        edge_width=np.full(len(edges), 4.0),
        edge_height=np.full(len(edges), 3.0),
        edge_slope=np.zeros(len(edges)),
        edge_axes=tuple(p_map[a] + along * (p_map[b] - p_map[a]) for a, b in edges),
        edge_profiles=tuple(np.full((len(along), 2), 4.0) for _ in edges),
    )
    return SemanticMap(MadeUpIntersections(side, points), roadways, np.zeros(3), MapSettings().model_dump(mode="json"))


def look_like_a_localizer(path: Path) -> None:
    """All positions and contours, and twenty clouds."""
    semantic_map = database.load(path)
    assert len(semantic_map.p_map) == len(semantic_map.contours.pwcv)
    for row in np.linspace(0, len(semantic_map) - 1, 20).astype(int).tolist():
        assert len(semantic_map.intersections[row].cloud)


def main() -> None:
    """Print one line a figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--intersections", type=int, default=10_000)
    parser.add_argument("--points", type=int, default=4_000, help="of each cloud")
    wanted = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mine.h5"
        semantic_map = made_up_map(round(wanted.intersections**0.5), wanted.points)
        begin = time.perf_counter()
        database.save(semantic_map, path)
        seconds = time.perf_counter() - begin
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
        print(f"{len(semantic_map)} intersections, {len(semantic_map.roadways.edge_nodes)} roadways")
        print(f"{path.stat().st_size / 2**20:.0f} MB, written in {seconds:.1f} s, {peak:.0f} MB of memory at most")
        opened, rng = database.load(path), np.random.default_rng(0)
        rows = iter(rng.integers(0, len(opened), 10_000).tolist())
        report("open", lambda: database.load(path), 20)
        report("open, read all contours", lambda: database.load(path).contours, 10)
        report("one intersection with its cloud", lambda: opened.intersections[next(rows)].cloud, 200)
        report("one intersection by its id", lambda: opened.by_id(next(rows)), 200)
        report("what a localizer needs, with 20 clouds", lambda: look_like_a_localizer(path), 10)


def report(what: str, job: Callable[[], object], goes: int) -> None:
    """Print the median of what a job takes [ms], by the clock and of the processor: others may be at work as well."""
    clock, processor = [], []
    for _ in range(goes):
        begin = time.perf_counter(), time.process_time()
        job()
        clock.append(1e3 * (time.perf_counter() - begin[0]))
        processor.append(1e3 * (time.process_time() - begin[1]))
    print(f"{what:40} {np.median(clock):8.2f} ms  (processor {np.median(processor):.2f})")


if __name__ == "__main__":
    main()
