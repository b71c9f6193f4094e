"""The semantic database file: a `SemanticMap` as HDF5, column by column.

The only file that knows h5py. Layout of schema version 2 (i intersections, b branches, e roadways)::

    /                     attributes format, schema_version, frame, origin (3,), crs (absent where unknown),
                          sources and settings (JSON)
    /intersections/       id (i,), p_map (i, 3), kind (i,), branch_offsets (i+1,), branch_bearings (b,),
                          branch_widths (b,), quality (i,), pwcv (i, sectors), pwcv_observed, cwc (i, layers, sectors),
                          cwc_observed, cloud_offsets (i+1,), cloud_points (n, 3)
    /roadways/            node_p_map (k, 3), node_intersection (k,), node_kind (k,), edge_nodes (e, 2),
                          edge_length (e,), edge_width (e,), edge_height (e,), edge_slope (e,),
                          axis_offsets (e+1,), axis_points (m, 3), axis_profile (m, 2)

What belongs to row ``r`` of a ragged column lies in ``[offsets[r], offsets[r + 1])``.

Version 1 had no quality, node_kind, edge_height, edge_slope and axis_profile. It is read with the quality counted from
the masks, nodes that are no intersections as dead ends, slopes from the axes, heights and profiles unknown (0).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from semmap.errors import DatabaseError
from semmap.files import written_whole
from semmap.geometry import Array
from semmap.intersections import (
    KINDS,
    NODE_KINDS,
    Intersection,
    RoadwayGraph,
    SemanticMap,
    WallContour,
    axis_slope,
)

FORMAT = "semmap-database"
SCHEMA_VERSION = 2

_CHUNK_ROWS = 16384
_KIND_BYTES = 16
_MAX_PACKING = 1100  # gzip packs no tighter; a file that claims to would fill the memory with nothing
_REBUILD = "build it again with `semmap build`"
_LIBRARY_ERRORS = (OSError, RuntimeError, LookupError, ValueError, TypeError, ArithmeticError, MemoryError)


def save(semantic_map: SemanticMap, path: str | Path) -> None:
    """Write a semantic map as a database file, whole or not at all. The same map gives the same bytes.

    Raises `DatabaseError` where `load` would refuse it, `InputFileError` where it cannot be written.
    """
    _check_uniform_contours(semantic_map.intersections, path)
    with _naming(path), written_whole(path) as temporary, h5py.File(temporary, "w") as file:
        _write_attributes(file, semantic_map)
        _write_intersections(file.create_group("intersections"), semantic_map.intersections)
        _write_roadways(file.create_group("roadways"), semantic_map.roadways)
        _read_map(file)


def _check_uniform_contours(intersections: Sequence[Intersection], path: str | Path) -> None:
    shapes = {(place.contour.pwcv.shape, place.contour.cwc.shape) for place in intersections}
    if len(shapes) > 1:
        raise DatabaseError("contours differ in sectors or layers", file=path, mend="use one setting for all")


def _write_attributes(file: Any, semantic_map: SemanticMap) -> None:
    file.attrs["format"] = FORMAT
    file.attrs["schema_version"] = SCHEMA_VERSION
    file.attrs["frame"] = semantic_map.frame
    file.attrs["origin"] = np.asarray(semantic_map.origin, dtype=np.float64)
    file.attrs["sources"] = _json(dict(semantic_map.sources))
    file.attrs["settings"] = _json(dict(semantic_map.settings))
    if semantic_map.crs is not None:
        file.attrs["crs"] = semantic_map.crs


def _json(value: dict[str, Any]) -> str:
    return json.dumps(value, sort_keys=True, allow_nan=False)


def _write_intersections(group: Any, places: Sequence[Intersection]) -> None:
    _write(group, "id", np.array([place.id for place in places], np.int64))
    _write(group, "p_map", np.array([place.p_map for place in places], np.float64).reshape(-1, 3))
    _write(group, "kind", np.array([place.kind.encode() for place in places], f"S{_KIND_BYTES}"))
    _write_ragged(group, "branch", "bearings", [place.branch_bearings for place in places], np.float64, ())
    _write(group, "branch_widths", _joined([place.branch_widths for place in places], np.float64, ()))
    _write(group, "quality", np.array([place.quality for place in places], np.float64))
    for name, dtype, dimensions in _CONTOUR_COLUMNS:
        rows = [getattr(place.contour, name) for place in places]
        _write(group, name, np.array(rows, dtype) if rows else np.empty((0,) * (dimensions + 1), dtype))
    _write_ragged(group, "cloud", "points", [place.cloud for place in places], np.float32, (3,))


def _write_roadways(group: Any, roadways: RoadwayGraph) -> None:
    _write(group, "node_p_map", np.asarray(roadways.node_p_map, np.float64).reshape(-1, 3))
    _write(group, "node_intersection", np.asarray(roadways.node_intersection, np.int64))
    _write(group, "node_kind", np.char.encode(roadways.node_kind, "ascii").astype(f"S{_KIND_BYTES}"))
    _write(group, "edge_nodes", np.asarray(roadways.edge_nodes, np.int64).reshape(-1, 2))
    _write(group, "edge_length", np.asarray(roadways.edge_length, np.float64))
    _write(group, "edge_width", np.asarray(roadways.edge_width, np.float64))
    _write(group, "edge_height", np.asarray(roadways.edge_height, np.float64))
    _write(group, "edge_slope", np.asarray(roadways.edge_slope, np.float64))
    _write_ragged(group, "axis", "points", roadways.edge_axes, np.float64, (3,))
    _write(group, "axis_profile", _joined(roadways.edge_profiles, np.float64, (2,)))


def _write_ragged(
    group: Any, owner: str, name: str, rows: Sequence[NDArray[Any]], dtype: Any, row_shape: tuple[int, ...]
) -> None:
    lengths = [len(row) for row in rows]
    _write(group, f"{owner}_offsets", np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64))
    _write(group, f"{owner}_{name}", _joined(rows, dtype, row_shape))


def _joined(rows: Sequence[NDArray[Any]], dtype: Any, row_shape: tuple[int, ...]) -> NDArray[Any]:
    parts = [np.asarray(row, dtype).reshape(-1, *row_shape) for row in rows]
    return np.concatenate([np.empty((0, *row_shape), dtype), *parts])


def _write(group: Any, name: str, data: NDArray[Any]) -> None:
    if len(data) > _CHUNK_ROWS:
        options: dict[str, Any] = {
            "chunks": (_CHUNK_ROWS, *data.shape[1:]),
            "shuffle": True,
            "compression": "gzip",
        }
    else:
        options = {}
    group.create_dataset(name, data=data, track_times=False, **options)


def load(path: str | Path) -> SemanticMap:
    """Read a database file and check all of it: links, types, shapes, ranges, and that its parts agree.

    Raises
    ------
    DatabaseError
        Where the file is missing, no semantic database, of another version, damaged, or contradicts itself.
    """
    if not Path(path).is_file():
        raise DatabaseError("no such file", file=path, mend="check the path, or build it with `semmap build`")
    if not h5py.is_hdf5(path):
        raise DatabaseError("is not a semantic database (not HDF5)", file=path, mend=_REBUILD)
    with _naming(path), _opened(path) as file:
        return _read_map(file)


def _read_map(file: Any) -> SemanticMap:
    version = _read_version(file)
    intersections = _read_intersections(_Group(file, "intersections"), version)
    roadways = _read_roadways(_Group(file, "roadways"), {place.id for place in intersections}, version)
    return SemanticMap(
        intersections=intersections,
        roadways=roadways,
        origin=_read_origin(file),
        settings=_read_json(file, "settings"),
        sources=_read_json(file, "sources"),
        frame=_read_text(file, "frame"),
        crs=_read_text(file, "crs") if "crs" in file.attrs else None,
    )


@contextmanager
def _naming(path: str | Path) -> Iterator[None]:
    """Faults found in the block name the file and a mend."""
    try:
        yield
    except DatabaseError as error:
        raise DatabaseError(error.what, file=path, field=error.field, mend=error.mend or _REBUILD) from None


@contextmanager
def _opened(path: str | Path) -> Iterator[Any]:
    """The file, open to read; whatever the library makes of a damaged one becomes one `DatabaseError`."""
    try:
        with h5py.File(path, "r") as file:
            yield file
    except _LIBRARY_ERRORS as reason:
        text = str(reason).splitlines()[0] if str(reason) else type(reason).__name__
        raise DatabaseError(f"is damaged ({text})", mend=f"copy it again or {_REBUILD}") from None


def _read_version(file: Any) -> int:
    if "format" not in file.attrs or _read_text(file, "format") != FORMAT:
        raise DatabaseError("is an HDF5 file, but not a semantic database")
    version = file.attrs.get("schema_version")
    if not isinstance(version, np.integer):
        raise DatabaseError("is not a whole number", field="schema_version")
    if not 1 <= version <= SCHEMA_VERSION:
        what = f"is of schema version {version}, this program reads 1 to {SCHEMA_VERSION}"
        raise DatabaseError(what, field="schema_version")
    return int(version)


def _read_text(file: Any, name: str) -> str:
    value = file.attrs.get(name)
    if not isinstance(value, str):
        raise DatabaseError("is missing or not text", field=name)
    return value


def _read_json(file: Any, name: str) -> dict[str, Any]:
    try:
        value = json.loads(_read_text(file, name))
    except json.JSONDecodeError:
        raise DatabaseError("is not JSON", field=name) from None
    if not isinstance(value, dict):
        raise DatabaseError("is not a mapping", field=name)
    return value


def _read_origin(file: Any) -> Array:
    origin = file.attrs.get("origin")
    if not isinstance(origin, np.ndarray) or origin.dtype.kind != "f" or origin.shape != (3,):
        raise DatabaseError("is not three numbers", field="origin")
    if not np.isfinite(origin).all():
        raise DatabaseError("is not finite", field="origin")
    return origin.astype(np.float64)


class _Group:
    """A group of columns; every access checks the link, the type, the shape, and that numbers are finite."""

    def __init__(self, file: Any, name: str) -> None:
        self._name = name
        if not isinstance(file.get(name, getlink=True), h5py.HardLink) or not isinstance(file[name], h5py.Group):
            raise DatabaseError("is missing or not a group", field=name)
        self._group = file[name]

    def fault(self, name: str, what: str) -> DatabaseError:
        return DatabaseError(what, field=f"{self._name}/{name}")

    def column(self, name: str, dtype: Any, shape: tuple[int | None, ...]) -> NDArray[Any]:
        """A data set of exactly ``dtype``; None in ``shape`` stands for any length."""
        if not isinstance(self._group.get(name, getlink=True), h5py.HardLink):
            raise self.fault(name, "is missing or a link to elsewhere")
        data = self._group[name]
        if not isinstance(data, h5py.Dataset) or data.is_virtual or data.external:
            raise self.fault(name, "is not a data set of this file")
        if data.dtype != np.dtype(dtype):
            raise self.fault(name, f"is of type {data.dtype}, not {np.dtype(dtype)}")
        fits = len(data.shape) == len(shape) and all(w in (None, n) for n, w in zip(data.shape, shape, strict=True))
        if not fits:
            wanted = ", ".join("any" if n is None else str(n) for n in shape)
            raise self.fault(name, f"has shape {data.shape}, not ({wanted})")
        if data.nbytes > _MAX_PACKING * data.id.get_storage_size():
            raise self.fault(name, f"claims {data.nbytes} bytes and holds {data.id.get_storage_size()}")
        values: NDArray[Any] = data[()]
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise self.fault(name, "holds NaN or infinity")
        return values

    def ragged(self, owner: str, name: str, dtype: Any, rows: int, row_shape: tuple[int, ...]) -> list[NDArray[Any]]:
        """The rows of a ragged column."""
        offsets = self.column(f"{owner}_offsets", np.int64, (rows + 1,))
        values = self.column(f"{owner}_{name}", dtype, (None, *row_shape))
        if offsets[0] != 0 or offsets[-1] != len(values) or (np.diff(offsets) < 0).any():
            raise self.fault(f"{owner}_offsets", f"do not divide the {len(values)} rows of {owner}_{name}")
        return np.split(values, offsets[1:-1]) if rows else []


_CONTOUR_COLUMNS = (
    ("pwcv", np.float32, 1),
    ("pwcv_observed", np.bool_, 1),
    ("cwc", np.float32, 2),
    ("cwc_observed", np.bool_, 2),
)


def _read_intersections(group: _Group, version: int) -> tuple[Intersection, ...]:
    ids = group.column("id", np.int64, (None,))
    n = len(ids)
    if len(np.unique(ids)) != n or (ids < 0).any():
        raise group.fault("id", "holds an id twice, or a negative one")
    p_map = group.column("p_map", np.float64, (n, 3))
    kinds = _read_kinds(group, "kind", n, KINDS)
    bearings = group.ragged("branch", "bearings", np.float64, n, ())
    widths = _split_like(bearings, group.column("branch_widths", np.float64, (sum(map(len, bearings)),)))
    contours = _read_contours(group, n)
    clouds = group.ragged("cloud", "points", np.float32, n, (3,))
    _check_branches(group, bearings, widths)
    quality = _read_quality(group, n) if version > 1 else [float(c.cwc_observed.mean()) for c in contours]
    rows = zip(ids.tolist(), p_map, kinds, bearings, widths, quality, contours, clouds, strict=True)
    return tuple(Intersection(*row) for row in rows)


def _read_kinds(group: _Group, name: str, n: int, known: Sequence[str]) -> list[str]:
    kinds = [kind.decode("ascii", "replace") for kind in group.column(name, f"S{_KIND_BYTES}", (n,))]
    if unknown := set(kinds) - set(known):
        raise group.fault(name, f"holds {unknown.pop()!r}, which is none of {', '.join(known)}")
    return kinds


def _read_quality(group: _Group, n: int) -> list[float]:
    quality = group.column("quality", np.float64, (n,))
    if ((quality < 0.0) | (quality > 1.0)).any():
        raise group.fault("quality", "is not between 0 and 1")
    return list(quality.tolist())


def _split_like(rows: Sequence[NDArray[Any]], values: NDArray[Any]) -> list[NDArray[Any]]:
    return np.split(values, np.cumsum([len(row) for row in rows])[:-1]) if rows else []


def _check_branches(group: _Group, bearings: Sequence[Array], widths: Sequence[Array]) -> None:
    for rows in bearings:
        if (np.diff(rows) < 0).any() or (rows < 0).any() or (rows > 2.0 * np.pi).any():
            raise group.fault("branch_bearings", "are not ascending from 0 to 2 pi")
    if any((rows < 0).any() for rows in widths):
        raise group.fault("branch_widths", "holds a negative width")


def _read_contours(group: _Group, n: int) -> list[WallContour]:
    shape = group.column("cwc", np.float32, (n, None, None)).shape
    shapes = {1: (n, shape[2]), 2: shape}
    columns = {name: group.column(name, dtype, shapes[rank]) for name, dtype, rank in _CONTOUR_COLUMNS}
    for name in ("pwcv", "cwc"):
        if (columns[name] < 0).any():
            raise group.fault(name, "holds a negative distance")
    return [WallContour(**{name: values[k] for name, values in columns.items()}) for k in range(n)]


def _read_roadways(group: _Group, ids: set[int], version: int) -> RoadwayGraph:
    node_p_map = group.column("node_p_map", np.float64, (None, 3))
    node_intersection = group.column("node_intersection", np.int64, (len(node_p_map),))
    if not set(node_intersection.tolist()) <= ids | {-1}:
        raise group.fault("node_intersection", "names an intersection that is not there")
    edge_nodes = group.column("edge_nodes", np.int64, (None, 2))
    if ((edge_nodes < 0) | (edge_nodes >= len(node_p_map))).any():
        raise group.fault("edge_nodes", "names a node that is not there")
    n = len(edge_nodes)
    axes = tuple(group.ragged("axis", "points", np.float64, n, (3,)))
    if version > 1:
        kinds = _read_node_kinds(group, node_intersection)
        height = _read_lengths(group, "edge_height", (n,))
        slope = group.column("edge_slope", np.float64, (n,))
        profile = _read_lengths(group, "axis_profile", (sum(map(len, axes)), 2))
    else:
        kinds = np.where(node_intersection < 0, "dead_end", "intersection")
        height, slope = np.zeros(n), np.array([axis_slope(axis) for axis in axes])
        profile = np.zeros((sum(map(len, axes)), 2))
    return RoadwayGraph(
        node_p_map=node_p_map,
        node_intersection=node_intersection,
        node_kind=kinds,
        edge_nodes=edge_nodes,
        edge_length=_read_lengths(group, "edge_length", (n,)),
        edge_width=_read_lengths(group, "edge_width", (n,)),
        edge_height=height,
        edge_slope=slope,
        edge_axes=axes,
        edge_profiles=tuple(_split_like(axes, profile)),
    )


def _read_node_kinds(group: _Group, node_intersection: NDArray[np.int64]) -> NDArray[np.str_]:
    kinds = np.array(_read_kinds(group, "node_kind", len(node_intersection), NODE_KINDS), dtype=np.str_)
    if ((kinds == "intersection") != (node_intersection >= 0)).any():
        raise group.fault("node_kind", "does not agree with node_intersection")
    return kinds


def _read_lengths(group: _Group, name: str, shape: tuple[int | None, ...]) -> Array:
    lengths = group.column(name, np.float64, shape)
    if (lengths < 0).any():
        raise group.fault(name, "holds a negative number")
    return lengths
