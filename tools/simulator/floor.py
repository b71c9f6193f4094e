"""The floor under a route: where the heights of a route's points do not fit a mesh, its own floor is followed.

A route drawn on a floor plan has no heights, and one made for another version of a mesh has wrong ones. On the
vertical through each place the mesh may have floors of several levels, so the whole route is fitted at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from semmap.errors import InputFileError
from semmap.geometry import Array
from tools.simulator.clearance import NEEDED, is_enclosed
from tools.simulator.mine import Mine
from tools.simulator.raycaster import Columns
from tools.simulator.route import CONTROL_STEP, evenly, smoothed

_FITS, _MOSTLY = 0.5, 0.9
"""[m] that the given heights may be off the floor over this share of the route."""
_SMOOTHING = 2.0
"""[m], 1σ, along the route, so that a rough floor does not shake the path."""
_FARNESS = 0.01
"""Weight of a floor's distance from the given height against changes of that distance on the way."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorRoute:
    """Floor points (n, 3) of a route, and by how much its heights were moved at most to get there [m]."""

    points: Array
    shift: float


def on_floor(route: Array, mine: Mine, height: float) -> FloorRoute:
    """Put a route on the floor of a mine, unless it lies there already.

    Parameters
    ----------
    route : (n, 3) floor points in the map frame, or (n, 2) without heights.
    height : above the floor at which the robot will go [m]; only floors with so much head-room count.

    Where there are floors of several levels, the route stays on one: as near to the given heights as can be, or,
    without heights, where it climbs least, the lowest of equals. Between places without a floor the height above
    the given points is interpolated; a route without any floor keeps its heights.

    Raises
    ------
    InputFileError
        If a route without heights has no floor under it.
    """
    has_heights = route.shape[1] == 3
    line = evenly(route if has_heights else np.column_stack([route, np.zeros(len(route))]), CONTROL_STEP)
    floors = _floors(line, mine, height)
    if not len(floors.owners):
        if has_heights:
            return FloorRoute(route, 0.0)
        mend = "check the route's coordinates, or give heights"
        raise InputFileError("has no floor of the mine under it", file=mine.name, field="route", mend=mend)
    shift = _followed(floors, line[:, 2], _FARNESS if has_heights else 0.0)
    if has_heights and _fits(shift, height):
        return FloorRoute(route, 0.0)
    line[:, 2] += shift
    line[:, 2] = smoothed(line, _SMOOTHING)[:, 2]
    return FloorRoute(line, float(np.abs(shift).max()) if has_heights else 0.0)


def _floors(line: Array, mine: Mine, height: float) -> Columns:
    """The rock with head-room above it, and rock round it: not the top of a lower level's roof."""
    columns = mine.raycaster.columns(line[:, :2])
    roofed = np.append(np.diff(columns.owners) == 0, False)
    room = np.where(roofed, np.roll(columns.heights, -1) - columns.heights, np.inf)
    high = room >= height + NEEDED
    owners, heights = columns.owners[high], columns.heights[high]
    enclosed = is_enclosed(mine, np.column_stack([line[owners, :2], heights + height]))
    return Columns(owners[enclosed], heights[enclosed])


def _followed(floors: Columns, given: Array, farness: float) -> Array:
    """Offsets (n,) [m] of one floor under a route from its given heights (n,).

    The floors are chosen by dynamic programming: the sum of the offset's changes, and a little of the
    offsets themselves, is least.
    """
    places, starts = np.unique(floors.owners, return_index=True)
    offsets = np.split(floors.heights - given[floors.owners], starts[1:])
    cost, origins = farness * np.abs(offsets[0]), []
    for before, here in pairwise(offsets):
        ways = cost[:, None] + np.abs(here - before[:, None])
        origins.append(np.argmin(ways, axis=0))
        cost = np.min(ways, axis=0) + farness * np.abs(here)
    chosen = [int(np.argmin(cost))]
    for origin in reversed(origins):
        chosen.append(int(origin[chosen[-1]]))
    followed = [offset[index] for offset, index in zip(offsets, reversed(chosen), strict=True)]
    return np.asarray(np.interp(np.arange(len(given)), places, followed))


def _fits(shift: Array, height: float) -> bool:
    """Do the given heights lie on the floor nearly everywhere, and nowhere so far off that there is no room?"""
    off = np.abs(shift)
    return bool(np.quantile(off, _MOSTLY) <= min(_FITS, 0.5 * height) and off.max() <= height - NEEDED)
