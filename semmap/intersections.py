"""Intersections, the roadway graph, and the semantic map that holds both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semmap.geometry import Array

KINDS = ("L", "T", "Y", "X", "multi")
"""Kinds of intersections: a bend, three roadways at right angles or not, four, and more than four."""

NODE_KINDS = ("intersection", "bend", "dead_end", "open_end", "hall")
"""Nodes of the roadway graph: an intersection; a turn too slight to be one; where a roadway ends at rock; where it goes
on but the map does not show it; a hall or yard too wide to be a roadway."""


@dataclass(frozen=True, slots=True, eq=False)
class WallContour:
    """Wall contour descriptors of one place, gravity-aligned, sector 0 from the x axis, counter-clockwise.

    pwcv : (n_sectors,) float32, horizontal distance [m] to the first wall within the radius, 0 without one.
    pwcv_observed : (n_sectors,) bool, false where the sector was not seen (0 then says nothing).
    cwc : (n_layers, n_sectors) float32, the same by height layer above the floor.
    cwc_observed : (n_layers, n_sectors) bool.
    """

    pwcv: NDArray[np.float32]
    pwcv_observed: NDArray[np.bool_]
    cwc: NDArray[np.float32]
    cwc_observed: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Intersection:
    """One roadway intersection.

    id : number, unique in its map.
    p_map : (3,) geometric invariant point on the floor, where the roadway axes meet [m].
    kind : one of `KINDS`.
    branch_bearings : (b,) direction of each roadway that leaves [rad], counter-clockwise from x, ascending
        in [0, 2π).
    branch_widths : (b,) width of each [m].
    quality : how completely and surely it is seen, 0 (nothing to go by) to 1.
    contour : PWCV and CWC as seen from ``p_map``.
    cloud : (n, 3) float32, dense cloud around ``p_map``, relative to ``p_map`` [m].
    """

    id: int
    p_map: Array
    kind: str
    branch_bearings: Array
    branch_widths: Array
    quality: float
    contour: WallContour
    cloud: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class RoadwayGraph:
    """Roadways as a graph: nodes are intersections and ends and bends of roadways, edges the roadways between them.

    node_p_map : (n, 3) on the floor [m].
    node_intersection : (n,) id of the intersection, -1 for every other node.
    node_kind : (n,) str, of `NODE_KINDS`.
    edge_nodes : (m, 2) indices into the nodes.
    edge_length : (m,) along the axis [m].
    edge_width : (m,) median [m].
    edge_height : (m,) median from floor to roof [m], 0 where no roof was seen.
    edge_slope : (m,) mean rise over run from the first node to the second, see `axis_slope`.
    edge_axes : for each edge its axis (k, 3) on the floor from the first node to the second [m].
    edge_profiles : for each edge the width and height (k, 2) at each point of its axis [m], 0 where unknown.
    """

    node_p_map: Array
    node_intersection: NDArray[np.int64]
    node_kind: NDArray[np.str_]
    edge_nodes: NDArray[np.int64]
    edge_length: Array
    edge_width: Array
    edge_height: Array
    edge_slope: Array
    edge_axes: tuple[Array, ...]
    edge_profiles: tuple[Array, ...]


def axis_slope(axis: Array) -> float:
    """Mean slope of a roadway axis (k, 3) from its first point to its last: rise over horizontal run, 0 without run."""
    run = float(np.hypot(*np.diff(axis[:, :2], axis=0).T).sum())
    return float(axis[-1, 2] - axis[0, 2]) / run if run > 0.0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class SemanticMap:
    """The semantic knowledge database of paper 004: every intersection of a mine and how the roadways join.

    The map frame is the prior map's own coordinates (a mine grid keeps its millions of metres, in float64).

    origin : (3,) float64, a round point near the mine: numbers relative to it are small enough for float32.
    settings : what the descriptors depend on, as plain data; with others, descriptors do not compare.
    sources : file name -> sha-256 of the prior map files.
    """

    intersections: tuple[Intersection, ...]
    roadways: RoadwayGraph
    origin: Array
    settings: Mapping[str, Any]
    sources: Mapping[str, str] = field(default_factory=dict)
    frame: str = "map"
    crs: str | None = None

    def __len__(self) -> int:
        return len(self.intersections)

    def by_id(self, id: int) -> Intersection:
        """The intersection numbered ``id``; KeyError where there is none."""
        for intersection in self.intersections:
            if intersection.id == id:
                return intersection
        raise KeyError(id)
