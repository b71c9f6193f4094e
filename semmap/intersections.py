"""Intersections, the roadway graph, and the semantic map that holds both."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any, Self, overload

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

    Those of several places may be stacked: every array then has one more dimension in front.

    pwcv : (n_sectors,) float32, horizontal distance [m] to the first wall within the radius, 0 without one.
    pwcv_observed : (n_sectors,) bool, false where the sector was not seen (0 then says nothing).
    cwc : (n_layers, n_sectors) float32, the same by height layer above the floor.
    cwc_observed : (n_layers, n_sectors) bool.
    """

    pwcv: NDArray[np.float32]
    pwcv_observed: NDArray[np.bool_]
    cwc: NDArray[np.float32]
    cwc_observed: NDArray[np.bool_]

    @classmethod
    def stacked(cls, contours: Sequence[WallContour]) -> WallContour:
        """The contours (n) of several places as one; of none, arrays without rows."""
        if not contours:
            flat, layered = (0, 0), (0, 0, 0)
            none, unseen = np.zeros(flat, np.float32), np.zeros(flat, np.bool_)
            return cls(none, unseen, none.reshape(layered), unseen.reshape(layered))
        return cls(*(np.stack([getattr(one, column.name) for one in contours]) for column in fields(cls)))

    def at(self, rows: int | slice | NDArray[np.int64]) -> WallContour:
        """One of stacked contours, or some of them."""
        return WallContour(self.pwcv[rows], self.pwcv_observed[rows], self.cwc[rows], self.cwc_observed[rows])


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
class IntersectionColumns:
    """Intersections side by side, all of them but contours and clouds; see `Intersection` for what each column means.

    id : (n,) int64. p_map : (n, 3) [m]. kind : (n,) str. quality : (n,).
    branch_offsets : (n + 1,); the branches of row r are ``[offsets[r], offsets[r + 1])`` of
        branch_bearings (b,) [rad] and branch_widths (b,) [m].
    cloud_sizes : (n,) number of points of each cloud.
    """

    id: NDArray[np.int64]
    p_map: Array
    kind: NDArray[np.str_]
    quality: Array
    branch_offsets: NDArray[np.int64]
    branch_bearings: Array
    branch_widths: Array
    cloud_sizes: NDArray[np.int64]

    @classmethod
    def of(cls, intersections: Iterable[Intersection]) -> Self:
        """The columns of some intersections, gone through once."""
        rows = [
            (i.id, i.p_map, i.kind, i.quality, i.branch_bearings, i.branch_widths, len(i.cloud)) for i in intersections
        ]
        ids, p_map, kind, quality, bearings, widths, sizes = zip(*rows, strict=True) if rows else ((),) * 7
        return cls(
            id=np.array(ids, np.int64),
            p_map=np.array(p_map, np.float64).reshape(-1, 3),
            kind=np.array(kind, np.str_),
            quality=np.array(quality, np.float64),
            branch_offsets=np.cumsum([0, *map(len, bearings)]),
            branch_bearings=np.concatenate([np.zeros(0), *bearings]),
            branch_widths=np.concatenate([np.zeros(0), *widths]),
            cloud_sizes=np.array(sizes, np.int64),
        )

    def __len__(self) -> int:
        return len(self.id)

    @property
    def branch_counts(self) -> NDArray[np.int64]:
        """Number of branches of each (n,)."""
        return np.diff(self.branch_offsets)

    def bearings(self, row: int) -> Array:
        """Branch bearings (b,) of one row [rad]."""
        return self.branch_bearings[self.branch_offsets[row] : self.branch_offsets[row + 1]]

    def joined(self, after: Self) -> Self:
        """These rows and then those."""
        mine, theirs = (
            {column.name: getattr(one, column.name) for column in fields(one) if column.name != "branch_offsets"}
            for one in (self, after)
        )
        offsets = np.concatenate([self.branch_offsets, self.branch_offsets[-1] + after.branch_offsets[1:]])
        both = {name: np.concatenate([mine[name], theirs[name]]) for name in mine}
        return type(self)(branch_offsets=offsets, **both)

    def take(self, rows: NDArray[np.int64]) -> Self:
        """The columns of some rows (k,), in their order."""
        counts = self.branch_counts[rows]
        offsets = np.concatenate([[0], np.cumsum(counts)])
        branches = np.arange(offsets[-1]) + np.repeat(self.branch_offsets[rows] - offsets[:-1], counts)
        return type(self)(
            self.id[rows],
            self.p_map[rows],
            self.kind[rows],
            self.quality[rows],
            offsets,
            self.branch_bearings[branches],
            self.branch_widths[branches],
            self.cloud_sizes[rows],
        )


class IntersectionTable(Sequence[Intersection]):
    """Intersections kept as columns: each is put together when it is asked for, its cloud read when that is.

    Parameters
    ----------
    columns : all but contours and clouds.
    read_contours : gives the contours of all rows, stacked; called once, when one is first needed.
    read_cloud : gives the cloud (k, 3) float32 of a row; called for each object whose cloud is looked at.
    """

    def __init__(
        self,
        columns: IntersectionColumns,
        read_contours: Callable[[], WallContour],
        read_cloud: Callable[[int], NDArray[np.float32]],
    ) -> None:
        self.columns = columns
        self.read_cloud = read_cloud
        self._read_contours = read_contours
        self._contours: WallContour | None = None

    @classmethod
    def of(cls, intersections: Sequence[Intersection]) -> IntersectionTable:
        """The table of some intersections, or the table that they are."""
        if isinstance(intersections, IntersectionTable):
            return intersections
        columns = IntersectionColumns.of(intersections)
        return cls(columns, partial(_own_contours, intersections), partial(_own_cloud, intersections))

    @property
    def contours(self) -> WallContour:
        """The contours of all rows, stacked."""
        if self._contours is None:
            self._contours = self._read_contours()
        return self._contours

    def take(self, rows: NDArray[np.int64]) -> IntersectionTable:
        """The table of some rows (k,), in their order."""
        return IntersectionTable(
            self.columns.take(rows), partial(_some_contours, self, rows), partial(_some_cloud, self, rows)
        )

    def joined(self, after: IntersectionTable) -> IntersectionTable:
        """These rows and then those; the contours of both must have the same layers and sectors."""
        return IntersectionTable(
            self.columns.joined(after.columns), partial(_both_contours, self, after), partial(_one_cloud, self, after)
        )

    def with_columns(self, columns: IntersectionColumns) -> IntersectionTable:
        """The same contours and clouds with other columns."""
        return IntersectionTable(columns, partial(getattr, self, "contours"), self.read_cloud)

    def __len__(self) -> int:
        return len(self.columns)

    @overload
    def __getitem__(self, row: int) -> Intersection: ...
    @overload
    def __getitem__(self, row: slice) -> IntersectionTable: ...
    def __getitem__(self, row: int | slice) -> Intersection | IntersectionTable:
        rows = range(len(self))[row]
        if isinstance(rows, range):
            return self.take(np.array(rows, np.int64))
        c = self.columns
        branches = slice(c.branch_offsets[rows], c.branch_offsets[rows + 1])
        return _TabledIntersection.of(
            partial(self.read_cloud, rows),
            id=int(c.id[rows]),
            p_map=c.p_map[rows],
            kind=str(c.kind[rows]),
            branch_bearings=c.branch_bearings[branches],
            branch_widths=c.branch_widths[branches],
            quality=float(c.quality[rows]),
            contour=self.contours.at(rows),
        )


def _own_contours(rows: Sequence[Intersection]) -> WallContour:
    return WallContour.stacked([row.contour for row in rows])


def _own_cloud(rows: Sequence[Intersection], row: int) -> NDArray[np.float32]:
    return rows[row].cloud


def _both_contours(first: IntersectionTable, after: IntersectionTable) -> WallContour:
    if not len(first) or not len(after):
        return first.contours if len(first) else after.contours
    a, b = first.contours, after.contours
    return WallContour(
        np.concatenate([a.pwcv, b.pwcv]),
        np.concatenate([a.pwcv_observed, b.pwcv_observed]),
        np.concatenate([a.cwc, b.cwc]),
        np.concatenate([a.cwc_observed, b.cwc_observed]),
    )


def _one_cloud(first: IntersectionTable, after: IntersectionTable, row: int) -> NDArray[np.float32]:
    return first.read_cloud(row) if row < len(first) else after.read_cloud(row - len(first))


def _some_contours(table: IntersectionTable, rows: NDArray[np.int64]) -> WallContour:
    return table.contours.at(rows)


def _some_cloud(table: IntersectionTable, rows: NDArray[np.int64], row: int) -> NDArray[np.float32]:
    return table.read_cloud(int(rows[row]))


class _TabledIntersection(Intersection):
    """An intersection whose cloud is read when it is first looked at."""

    __slots__ = ("_read_cloud",)
    _read_cloud: Callable[[], NDArray[np.float32]]

    @classmethod
    def of(cls, read_cloud: Callable[[], NDArray[np.float32]], **values: Any) -> Self:
        """With all ``values`` but the cloud."""
        one = cls.__new__(cls)
        for name, value in {**values, "_read_cloud": read_cloud}.items():
            object.__setattr__(one, name, value)
        return one

    def __getattr__(self, name: str) -> Any:
        """Python asks this for what is not set: that is the cloud, until it was read."""
        if name != "cloud":
            raise AttributeError(name)
        object.__setattr__(self, "cloud", self._read_cloud())
        return self.cloud


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
    edge_axes: Sequence[Array]
    edge_profiles: Sequence[Array]


def axis_slope(axis: Array) -> float:
    """Mean slope of a roadway axis (k, 3) from its first point to its last: rise over horizontal run, 0 without run."""
    run = float(np.hypot(*np.diff(axis[:, :2], axis=0).T).sum())
    return float(axis[-1, 2] - axis[0, 2]) / run if run > 0.0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class SemanticMap:
    """The semantic knowledge database of paper 004: every intersection of a mine and how the roadways join.

    The map frame is the prior map's own coordinates (a mine grid keeps its millions of metres, in float64).

    intersections : a tuple, or an `IntersectionTable` that puts them together when they are asked for. What is needed
        of all of them is at hand as columns: `columns`, `p_map`, `contours`.
    origin : (3,) float64, a round point near the mine: numbers relative to it are small enough for float32.
    settings : what the descriptors depend on, as plain data; with others, descriptors do not compare.
    sources : file name -> sha-256 of the prior map files.
    """

    intersections: Sequence[Intersection]
    roadways: RoadwayGraph
    origin: Array
    settings: Mapping[str, Any]
    sources: Mapping[str, str] = field(default_factory=dict)
    frame: str = "map"
    crs: str | None = None
    _row_of_id: dict[int, int] = field(default_factory=dict, init=False, repr=False)

    def __len__(self) -> int:
        return len(self.intersections)

    @property
    def columns(self) -> IntersectionColumns:
        """All intersections side by side but contours and clouds; of a tuple, made anew each time."""
        return IntersectionTable.of(self.intersections).columns

    @property
    def p_map(self) -> Array:
        """Invariant points (n, 3) of all intersections [m]."""
        return self.columns.p_map

    @property
    def contours(self) -> WallContour:
        """Wall contours of all intersections, stacked; of a tuple, made anew each time."""
        return IntersectionTable.of(self.intersections).contours

    def by_id(self, id: int) -> Intersection:
        """The intersection numbered ``id``; KeyError where there is none."""
        if not self._row_of_id:
            self._row_of_id.update({number: row for row, number in enumerate(self.columns.id.tolist())})
        return self.intersections[self._row_of_id[id]]
