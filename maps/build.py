"""A prior point cloud into a semantic map: in memory, or tile by tile with as many workers as there are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import TypeVar

from maps.columns import Columns
from maps.describe import Place, describe, description_radius, place_of
from maps.engine import Engine, ThisProcess
from maps.free_cells import split_ground_and_walls
from maps.graph import roadway_graph
from maps.intersections import find_intersections
from maps.prior_map import PriorMap
from maps.settings import FreeSpaceSettings, MapSettings
from maps.tiles import Part, Surroundings, TiledMap
from maps.topology import roadway_topology
from semmap.errors import CloudError
from semmap.geometry import Array
from semmap.intersections import Intersection, SemanticMap

Progress = Callable[[int, int], None]
Item = TypeVar("Item")

_PERCENT = 100
_COLUMNS, _FLOOR, _TOPOLOGY = 25, 50, 60
"""About how far a build is after these steps [percent]."""


def build_semantic_map(
    prior: PriorMap, settings: MapSettings | None = None, *, progress: Progress | None = None
) -> SemanticMap:
    """Every intersection of a mine, cut out of its point cloud and described (paper 004, section 3.2).

    progress : called with the percent done and 100.

    Raises
    ------
    CloudError
        Where the cloud is empty or shows no floor.
    """
    settings = settings or MapSettings()
    mine = TiledMap.in_memory(prior, settings.free_space.cell)
    return build_from_tiles(mine, settings, ThisProcess(), progress=progress)


def build_from_tiles(
    mine: TiledMap, settings: MapSettings, engine: Engine, *, progress: Progress | None = None
) -> SemanticMap:
    """The same for a map in tiles, see `maps.tile_files.tiled`: the same map, whatever tiles and engine."""
    parts, report = mine.parts(), progress or (lambda done, total: None)
    if not parts:
        raise CloudError("has no points", field="prior map")
    made = engine.map(partial(_columns_of, settings.free_space), parts)
    columns = Columns.joined(list(_counted(made, len(parts), report, 0, _COLUMNS)))
    space = split_ground_and_walls(columns, settings.free_space)
    del columns
    report(_FLOOR, _PERCENT)
    topology = roadway_topology(space, settings.topology)
    crossings = find_intersections(topology, space, settings.topology)
    report(_TOPOLOGY, _PERCENT)
    radius = description_radius(settings)
    jobs = (
        (number, place_of(crossing, space, settings), mine.around(crossing.p, radius))
        for number, crossing in enumerate(crossings)
    )
    described = engine.map(partial(_described, mine.origin, settings), jobs)
    intersections = tuple(_counted(described, len(crossings), report, _TOPOLOGY, _PERCENT))
    roadways = roadway_graph(topology, crossings, space, mine.origin, settings.topology)
    stored = settings.model_dump(mode="json")
    return SemanticMap(intersections, roadways, mine.origin, stored, mine.sources, crs=mine.crs)


def _columns_of(settings: FreeSpaceSettings, part: Part) -> Columns:
    return part.columns(settings)


def _described(origin: Array, settings: MapSettings, job: tuple[int, Place, Surroundings]) -> Intersection:
    number, place, surroundings = job
    return describe(number, place, surroundings.points(), origin, settings)


def _counted(items: Iterable[Item], count: int, report: Progress, start: int, stop: int) -> Iterator[Item]:
    """The items; ``report`` is told that the work goes from ``start`` to ``stop`` percent as they come."""
    report(start, _PERCENT)
    for done, item in enumerate(items, 1):
        yield item
        report(start + (stop - start) * done // count, _PERCENT)
    report(stop, _PERCENT)
