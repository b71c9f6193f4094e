"""A prior point cloud into a semantic map."""

from __future__ import annotations

from collections.abc import Callable

from maps.describe import Neighbourhoods, describe, description_radius, place_of
from maps.floor_cells import FreeSpace
from maps.free_space import split_ground_and_walls
from maps.graph import roadway_graph
from maps.intersections import Crossing, find_intersections
from maps.prior_map import PriorMap
from maps.settings import MapSettings
from maps.topology import roadway_topology
from semmap.errors import CloudError
from semmap.intersections import Intersection, SemanticMap


def build_semantic_map(
    prior: PriorMap, settings: MapSettings | None = None, *, progress: Callable[[int, int], None] | None = None
) -> SemanticMap:
    """Every intersection of a mine, cut out of its point cloud and described (paper 004, section 3.2).

    progress : called with the steps done and the steps there are.

    Raises
    ------
    CloudError
        Where the cloud is empty or shows no floor.
    """
    settings = settings or MapSettings()
    report = progress or (lambda done, total: None)
    if not len(prior.points):
        raise CloudError("has no points", field="prior map")
    report(0, 4)
    space = split_ground_and_walls(prior.points, settings.free_space).surface()
    report(1, 4)
    topology = roadway_topology(space, settings.topology)
    report(2, 4)
    crossings = find_intersections(topology, space, settings.topology)
    report(3, 4)
    intersections = _described(crossings, prior, space, settings)
    roadways = roadway_graph(topology, crossings, space, prior.origin, settings.topology)
    report(4, 4)
    stored = settings.model_dump(mode="json")
    return SemanticMap(intersections, roadways, prior.origin, stored, prior.sources, crs=prior.crs)


def _described(
    crossings: list[Crossing], prior: PriorMap, space: FreeSpace, settings: MapSettings
) -> tuple[Intersection, ...]:
    """The crossings, numbered from 0, with contours and clouds, in the map frame."""
    neighbourhoods, radius = Neighbourhoods(prior.points), description_radius(settings)
    places = (place_of(crossing, space, settings) for crossing in crossings)
    return tuple(
        describe(number, place, neighbourhoods.around(place.crossing.p, radius), prior.origin, settings)
        for number, place in enumerate(places)
    )
