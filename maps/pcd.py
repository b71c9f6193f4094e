"""PCD point clouds (ascii, binary, binary_compressed) with whatever precision the file has."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from maps._numba_lzf import lzf_decompress
from maps.point_table import PIECE_POINTS, Extent, coordinates, record_blocks, steps, text_blocks
from semmap.errors import InputFileError
from semmap.geometry import Array

_KINDS = {"F": "f", "I": "i", "U": "u"}
_MAX_HEADER_LINES = 50


@dataclass(frozen=True, slots=True)
class _Header:
    """What the lines before the data say; ``dtype`` is one point's row, padding fields included."""

    dtype: np.dtype[Any]
    n_points: int
    encoding: str


def pcd_extent(path: Path) -> Extent:
    """Number of points the header promises. Raises `InputFileError` where the header is wrong."""
    with _open(path) as file:
        header = _read_header(file)
    return Extent(header.n_points, PIECE_POINTS if header.encoding == "binary" else header.n_points)


def pcd_points(path: Path, start: int, stop: int, rows: int) -> Iterator[Array]:
    """Points ``start`` to ``stop``, (up to ``rows``, 3) float64 [m] at a time, those that are not finite included.

    Raises `InputFileError` where the file is cut off or its header is wrong, `CloudError` without x, y or z.
    """
    with _open(path) as file:
        header = _read_header(file)
        coordinates(np.empty(0, header.dtype), path)
        for table in _READERS[header.encoding](file, header, start, stop, rows):
            yield coordinates(table, path)


@contextmanager
def _open(path: Path) -> Iterator[BinaryIO]:
    with path.open("rb") as file:
        try:
            yield file
        except (ValueError, KeyError, IndexError) as reason:
            what = f"is not a readable PCD file ({reason})"
            raise InputFileError(what, file=path, mend="export the cloud again") from None


def _read_header(file: BinaryIO) -> _Header:
    entries: dict[str, list[str]] = {}
    for _ in range(_MAX_HEADER_LINES):
        words = file.readline(65536).decode("ascii").split()
        if not words or words[0].startswith("#"):
            continue
        entries[words[0].upper()] = words[1:]
        if words[0].upper() == "DATA":
            break
    for key in ("FIELDS", "SIZE", "TYPE", "DATA"):
        if key not in entries:
            raise ValueError(f"its header has no {key} line")
    if entries["DATA"][0] not in _READERS:
        raise ValueError(f"unknown DATA {entries['DATA'][0]}")
    if "POINTS" in entries:
        n_points = int(entries["POINTS"][0])
    else:
        n_points = int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0])
    return _Header(_row_dtype(entries), n_points, entries["DATA"][0])


def _row_dtype(entries: dict[str, list[str]]) -> np.dtype[Any]:
    fields, sizes, kinds = entries["FIELDS"], entries["SIZE"], entries["TYPE"]
    counts = entries.get("COUNT", ["1"] * len(fields))
    if not len(fields) == len(sizes) == len(kinds) == len(counts):
        raise ValueError("FIELDS, SIZE, TYPE and COUNT differ in length")
    columns: list[Any] = []
    for k, (name, size, kind, count) in enumerate(zip(fields, sizes, kinds, counts, strict=True)):
        unique = name if name != "_" and name not in fields[:k] else f"_{k}"
        columns.append((unique, f"<{_KINDS[kind.upper()]}{size}", (int(count),) if int(count) != 1 else ()))
    return np.dtype(columns)


def _read_ascii(file: BinaryIO, header: _Header, start: int, stop: int, rows: int) -> Iterator[NDArray[Any]]:
    names = [name for name in header.dtype.names or () if name in ("x", "y", "z")]
    widths = {name: int(np.prod(header.dtype[name].shape)) for name in header.dtype.names or ()}
    first = dict(zip(widths, np.cumsum([0, *widths.values()]).tolist(), strict=False))
    for values in text_blocks(file, header.n_points, [first[name] for name in names], rows):
        table = np.empty(len(values), [(name, np.float64) for name in names])
        for k, name in enumerate(names):
            table[name] = values[:, k]
        yield table


def _read_binary(file: BinaryIO, header: _Header, start: int, stop: int, rows: int) -> Iterator[NDArray[Any]]:
    return record_blocks(file, header.dtype, header.n_points, start, stop, rows)


def _read_compressed(file: BinaryIO, header: _Header, start: int, stop: int, rows: int) -> Iterator[NDArray[Any]]:
    """Columns one after another, LZF-compressed as one block after two sizes."""
    sizes = np.frombuffer(file.read(8), "<u4")
    packed = np.frombuffer(file.read(int(sizes[0])), np.uint8)
    if len(packed) < sizes[0] or sizes[1] != header.n_points * header.dtype.itemsize:
        raise ValueError("its data is cut off")
    data = np.empty(int(sizes[1]), np.uint8)
    if lzf_decompress(packed, data) != len(data):
        raise ValueError("its compressed data is damaged")
    columns = _columns(data, header)
    for low, high in steps(start, stop, rows):
        table = np.empty(high - low, header.dtype)
        for name, values in columns.items():
            table[name] = values[low:high]
        yield table


def _columns(data: NDArray[np.uint8], header: _Header) -> dict[str, NDArray[Any]]:
    """Each field of all points, from the fields one after another."""
    columns: dict[str, NDArray[Any]] = {}
    start = 0
    for name in header.dtype.names or ():
        column = header.dtype[name]
        stop = start + header.n_points * column.itemsize
        columns[name] = data[start:stop].view(column.base).reshape(header.n_points, *column.shape)
        start = stop
    return columns


_READERS = {"ascii": _read_ascii, "binary": _read_binary, "binary_compressed": _read_compressed}
