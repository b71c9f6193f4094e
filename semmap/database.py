"""The semantic database file: a `SemanticMap` as HDF5, column by column.

Layout of schema version 2 (i intersections, b branches, k nodes, e roadways)::

    /                     attributes format, schema_version, frame, origin (3,), crs (absent where unknown),
                          sources and settings (JSON)
    /intersections/       id (i,), p_map (i, 3), kind (i,), branch_offsets (i+1,), branch_bearings (b,),
                          branch_widths (b,), quality (i,), pwcv (i, sectors), pwcv_observed, cwc (i, layers, sectors),
                          cwc_observed, cloud_offsets (i+1,), cloud_points (n, 3)
    /roadways/            node_p_map (k, 3), node_intersection (k,), node_kind (k,), edge_nodes (e, 2),
                          edge_length (e,), edge_width (e,), edge_height (e,), edge_slope (e,),
                          axis_offsets (e+1,), axis_points (m, 3), axis_profile (m, 2)

What belongs to row ``r`` of a ragged column lies in ``[offsets[r], offsets[r + 1])``. The clouds, nearly all of a file,
are chunked, shuffled and compressed; everything else lies in one piece.

Version 1 had no quality, node_kind, edge_height, edge_slope and axis_profile. It is read with the quality counted from
the masks, nodes that are no intersections as dead ends, slopes from the axes, heights and profiles unknown (0).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semmap import hdf5
from semmap.errors import DatabaseError
from semmap.files import written_whole
from semmap.geometry import Array
from semmap.hdf5 import Group
from semmap.intersections import (
    KINDS,
    NODE_KINDS,
    Intersection,
    IntersectionColumns,
    IntersectionTable,
    RoadwayGraph,
    SemanticMap,
    WallContour,
    axis_slope,
)
from semmap.ragged import Ragged

FORMAT = "semmap-database"
SCHEMA_VERSION = 2

_CONTOUR_TYPES = {"pwcv": np.float32, "pwcv_observed": np.bool_, "cwc": np.float32, "cwc_observed": np.bool_}


def save(semantic_map: SemanticMap, path: str | Path) -> None:
    """Write a semantic map as a database file, whole or not at all. The same map gives the same bytes.

    The intersections are gone through once, and of their clouds no more than one is kept: a map larger than memory may
    hand them over as a sequence that makes each when it is asked for.

    Raises `DatabaseError` where `load` would refuse it, `InputFileError` where it cannot be written.
    """
    with hdf5.naming(path), written_whole(path) as temporary, hdf5.created(temporary) as file:
        _write_attributes(file, semantic_map)
        _write_intersections(file.create_group("intersections"), semantic_map.intersections)
        _write_roadways(file.create_group("roadways"), semantic_map.roadways)
        columns = _read_columns(Group(file, "intersections"), SCHEMA_VERSION)
        _read_contours(Group(file, "intersections"), len(columns))
        _read_roadways(Group(file, "roadways"), columns.id, SCHEMA_VERSION)


def _write_attributes(file: Any, semantic_map: SemanticMap) -> None:
    file.attrs["format"] = FORMAT
    file.attrs["schema_version"] = SCHEMA_VERSION
    file.attrs["frame"] = semantic_map.frame
    file.attrs["origin"] = np.asarray(semantic_map.origin, dtype=np.float64)
    hdf5.write_json(file, "sources", dict(semantic_map.sources))
    hdf5.write_json(file, "settings", dict(semantic_map.settings))
    if semantic_map.crs is not None:
        file.attrs["crs"] = semantic_map.crs


def _write_intersections(group: Any, places: Iterable[Intersection]) -> None:
    """The clouds as they come, then the columns of everything else."""
    bare, sizes, no_points = [], [0], np.zeros((0, 3), np.float32)
    with hdf5.Appender(group, "cloud_points", np.float32, (3,)) as clouds:
        for place in places:
            _check_ragged(place)
            clouds.append(np.asarray(place.cloud, np.float32))
            sizes.append(len(place.cloud))
            bare.append(replace(place, cloud=no_points))
    columns = IntersectionColumns.of(bare)
    for name in ("id", "p_map", "branch_offsets", "branch_bearings", "branch_widths", "quality"):
        hdf5.write_column(group, name, getattr(columns, name))
    hdf5.write_kinds(group, "kind", columns.kind)
    hdf5.write_column(group, "cloud_offsets", np.cumsum(sizes))
    _write_contours(group, [place.contour for place in bare])


def _check_ragged(place: Intersection) -> None:
    """Refuse what no check of whole columns would find."""
    if place.branch_widths.shape != place.branch_bearings.shape:
        raise DatabaseError("has not one width a branch", field=f"intersection {place.id}")
    if place.cloud.ndim != 2 or place.cloud.shape[1] != 3 or not np.isfinite(place.cloud).all():
        raise DatabaseError("has a cloud that is not (n, 3) finite numbers", field=f"intersection {place.id}")


def _write_contours(group: Any, contours: Sequence[WallContour]) -> None:
    if len({(one.pwcv.shape, one.cwc.shape) for one in contours}) > 1:
        raise DatabaseError("contours differ in sectors or layers", mend="use one setting for all")
    stacked = WallContour.stacked(contours)
    for name, dtype in _CONTOUR_TYPES.items():
        hdf5.write_column(group, name, np.asarray(getattr(stacked, name), dtype))


def _write_roadways(group: Any, roadways: RoadwayGraph) -> None:
    if [len(axis) for axis in roadways.edge_axes] != [len(profile) for profile in roadways.edge_profiles]:
        raise DatabaseError("do not have one row a point of the axis", field="roadways/axis_profile")
    hdf5.write_column(group, "node_p_map", np.asarray(roadways.node_p_map, np.float64).reshape(-1, 3))
    hdf5.write_column(group, "node_intersection", np.asarray(roadways.node_intersection, np.int64))
    hdf5.write_kinds(group, "node_kind", roadways.node_kind)
    hdf5.write_column(group, "edge_nodes", np.asarray(roadways.edge_nodes, np.int64).reshape(-1, 2))
    for name in ("edge_length", "edge_width", "edge_height", "edge_slope"):
        hdf5.write_column(group, name, np.asarray(getattr(roadways, name), np.float64))
    hdf5.write_column(group, "axis_offsets", np.cumsum([0, *map(len, roadways.edge_axes)]))
    hdf5.write_column(group, "axis_points", np.concatenate([np.zeros((0, 3)), *roadways.edge_axes]))
    hdf5.write_column(group, "axis_profile", np.concatenate([np.zeros((0, 2)), *roadways.edge_profiles]))


def load(path: str | Path) -> SemanticMap:
    """Open a database file: links, types, shapes and ranges are checked, and that its parts agree.

    The contours are read when they are first needed and each cloud when it is looked at; what they hold is checked
    then. The file must stay as it is until then: one that was changed or removed since is a `DatabaseError`.

    Raises
    ------
    DatabaseError
        Where the file is missing, no semantic database, of another version, damaged, or contradicts itself.
    """
    if not Path(path).is_file():
        raise DatabaseError("no such file", file=path, mend="check the path, or build it with `semmap build`")
    stamp = hdf5.Stamp.of(path)
    with stamp.opened() as file:
        return _read_map(file, stamp)


def _read_map(file: Any, stamp: hdf5.Stamp) -> SemanticMap:
    version = _read_version(file)
    columns = _read_columns(Group(file, "intersections"), version)
    return SemanticMap(
        intersections=IntersectionTable(
            columns,
            _StoredContours(stamp, len(columns)),
            _StoredClouds(stamp, np.concatenate([[0], np.cumsum(columns.cloud_sizes)])),
        ),
        roadways=_read_roadways(Group(file, "roadways"), columns.id, version),
        origin=hdf5.read_numbers(file, "origin", 3),
        settings=hdf5.read_json(file, "settings"),
        sources=hdf5.read_json(file, "sources"),
        frame=hdf5.read_text(file, "frame"),
        crs=hdf5.read_text(file, "crs") if "crs" in file.attrs else None,
    )


def _read_version(file: Any) -> int:
    if "format" not in file.attrs or hdf5.read_text(file, "format") != FORMAT:
        raise DatabaseError("is an HDF5 file, but not a semantic database")
    version = hdf5.read_whole_number(file, "schema_version")
    if not 1 <= version <= SCHEMA_VERSION:
        what = f"is of schema version {version}, this program reads 1 to {SCHEMA_VERSION}"
        raise DatabaseError(what, field="schema_version")
    return version


@dataclass(frozen=True, slots=True)
class _StoredContours:
    """Reads the contours of all intersections of a file."""

    stamp: hdf5.Stamp
    rows: int

    def __call__(self) -> WallContour:
        with self.stamp.opened() as file:
            return _read_contours(Group(file, "intersections"), self.rows)


@dataclass(frozen=True, slots=True)
class _StoredClouds:
    """Reads the cloud of one intersection of a file."""

    stamp: hdf5.Stamp
    offsets: NDArray[np.int64]

    def __call__(self, row: int) -> NDArray[np.float32]:
        begin, end, total = self.offsets[[row, row + 1, -1]].tolist()
        with self.stamp.opened() as file:
            return Group(file, "intersections").rows("cloud_points", np.float32, (total, 3), slice(begin, end))


def _read_columns(group: Group, version: int) -> IntersectionColumns:
    """All but contours and clouds, of which the shapes are checked."""
    ids = group.column("id", np.int64, (None,))
    n = len(ids)
    if len(np.unique(ids)) != n or (ids < 0).any():
        raise group.fault("id", "holds an id twice, or a negative one")
    _check_contour_shapes(group, n)
    (branches,) = group.shape("branch_bearings", np.float64, (None,))
    (points, _) = group.shape("cloud_points", np.float32, (None, 3))
    columns = IntersectionColumns(
        id=ids,
        p_map=group.column("p_map", np.float64, (n, 3)),
        kind=group.kinds("kind", n, KINDS),
        quality=group.column("quality", np.float64, (n,)) if version > 1 else _seen_share(_read_contours(group, n)),
        branch_offsets=group.offsets("branch", n, "bearings", branches),
        branch_bearings=group.column("branch_bearings", np.float64, (branches,)),
        branch_widths=group.at_least_0("branch_widths", (branches,)),
        cloud_sizes=np.diff(group.offsets("cloud", n, "points", points)),
    )
    _check_ranges(group, columns)
    return columns


def _seen_share(contours: WallContour) -> Array:
    """Share (n,) of the cells of each CWC that were observed."""
    seen = contours.cwc_observed
    return seen.reshape(len(seen), -1).mean(axis=1) if seen.size else np.zeros(len(seen))


def _check_ranges(group: Group, columns: IntersectionColumns) -> None:
    if ((columns.quality < 0.0) | (columns.quality > 1.0)).any():
        raise group.fault("quality", "is not between 0 and 1")
    bearings = columns.branch_bearings
    owner = np.repeat(np.arange(len(columns)), columns.branch_counts)
    falls = (np.diff(bearings) < 0.0) & (np.diff(owner) == 0)
    if falls.any() or (bearings < 0.0).any() or (bearings > 2.0 * np.pi).any():
        raise group.fault("branch_bearings", "are not ascending from 0 to 2 pi")


def _check_contour_shapes(group: Group, n: int) -> None:
    _, layers, sectors = group.shape("cwc", np.float32, (n, None, None))
    group.shape("cwc_observed", np.bool_, (n, layers, sectors))
    for name in ("pwcv", "pwcv_observed"):
        group.shape(name, _CONTOUR_TYPES[name], (n, sectors))


def _read_contours(group: Group, n: int) -> WallContour:
    contours = WallContour(
        group.column("pwcv", np.float32, (n, None)),
        group.column("pwcv_observed", np.bool_, (n, None)),
        group.column("cwc", np.float32, (n, None, None)),
        group.column("cwc_observed", np.bool_, (n, None, None)),
    )
    for name in ("pwcv", "cwc"):
        if (getattr(contours, name) < 0.0).any():
            raise group.fault(name, "holds a negative distance")
    return contours


def _read_roadways(group: Group, ids: NDArray[np.int64], version: int) -> RoadwayGraph:
    node_p_map = group.column("node_p_map", np.float64, (None, 3))
    node_intersection = group.column("node_intersection", np.int64, (len(node_p_map),))
    if not np.isin(node_intersection, np.append(ids, -1)).all():
        raise group.fault("node_intersection", "names an intersection that is not there")
    edge_nodes = group.column("edge_nodes", np.int64, (None, 2))
    if ((edge_nodes < 0) | (edge_nodes >= len(node_p_map))).any():
        raise group.fault("edge_nodes", "names a node that is not there")
    n = len(edge_nodes)
    points = group.column("axis_points", np.float64, (None, 3))
    offsets = group.offsets("axis", n, "points", len(points))
    axes = Ragged(points, offsets)
    known = version > 1
    profile = group.at_least_0("axis_profile", (len(points), 2)) if known else np.zeros((len(points), 2))
    return RoadwayGraph(
        node_p_map=node_p_map,
        node_intersection=node_intersection,
        node_kind=_read_node_kinds(group, node_intersection, version),
        edge_nodes=edge_nodes,
        edge_length=group.at_least_0("edge_length", (n,)),
        edge_width=group.at_least_0("edge_width", (n,)),
        edge_height=group.at_least_0("edge_height", (n,)) if known else np.zeros(n),
        edge_slope=group.column("edge_slope", np.float64, (n,)) if known else np.array([axis_slope(a) for a in axes]),
        edge_axes=axes,
        edge_profiles=Ragged(profile, offsets),
    )


def _read_node_kinds(group: Group, node_intersection: NDArray[np.int64], version: int) -> NDArray[np.str_]:
    if version == 1:
        return np.where(node_intersection < 0, "dead_end", "intersection")
    kinds = group.kinds("node_kind", len(node_intersection), NODE_KINDS)
    if ((kinds == "intersection") != (node_intersection >= 0)).any():
        raise group.fault("node_kind", "does not agree with node_intersection")
    return kinds
