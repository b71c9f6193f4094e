"""PCD point clouds (ascii, binary, binary_compressed) with whatever precision the file has."""

from __future__ import annotations

import io
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from maps._numba_lzf import lzf_decompress
from semmap.errors import CloudError, InputFileError
from semmap.geometry import Array

_KINDS = {"F": "f", "I": "i", "U": "u"}
_MAX_HEADER_LINES = 50


@dataclass(frozen=True, slots=True)
class _Header:
    """What the lines before the data say; ``dtype`` is one point's row, padding fields included."""

    dtype: np.dtype[Any]
    n_points: int
    encoding: str


def read_pcd(path: str | Path) -> Array:
    """Coordinates (n, 3) float64 [m] of a PCD file, rows that are not finite included.

    Raises `InputFileError` where the file is cut off or its header is wrong, `CloudError` without x, y or z.
    """
    with Path(path).open("rb") as file:
        try:
            header = _read_header(file)
            table = _READERS[header.encoding](file, header)
        except (ValueError, KeyError, IndexError) as reason:
            what = f"is not a readable PCD file ({reason})"
            raise InputFileError(what, file=path, mend="export the cloud again") from None
    return coordinates(table, path)


def coordinates(table: NDArray[Any], path: str | Path) -> Array:
    """Columns x, y, z of a structured array as (n, 3) float64. Raises `CloudError` where one is missing."""
    names = table.dtype.names or ()
    for axis in "xyz":
        if axis not in names:
            raise CloudError("is missing", file=path, field=axis, mend=f"the file has {', '.join(names)}")
    return np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=1)


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


def _read_ascii(file: BinaryIO, header: _Header) -> NDArray[Any]:
    names = [name for name in header.dtype.names or () if name in ("x", "y", "z")]
    widths = {name: int(np.prod(header.dtype[name].shape)) for name in header.dtype.names or ()}
    starts = dict(zip(widths, np.cumsum([0, *widths.values()]).tolist(), strict=False))
    table = np.empty(header.n_points, [(name, np.float64) for name in names])
    if names and header.n_points:
        values = read_numbers(file, header.n_points, [starts[name] for name in names])
        _check_length(len(values), header)
        for k, name in enumerate(names):
            table[name] = values[:, k]
    return table


def read_numbers(file: BinaryIO, n_rows: int, columns: list[int] | None = None) -> Array:
    """Up to ``n_rows`` lines of numbers from here on, as (n, columns) float64."""
    filled = (line for line in io.TextIOWrapper(file, encoding="ascii") if line.strip())
    values: Array = np.loadtxt(islice(filled, n_rows), np.float64, comments=None, usecols=columns, ndmin=2)
    return values


def _read_binary(file: BinaryIO, header: _Header) -> NDArray[Any]:
    data = file.read(header.n_points * header.dtype.itemsize)
    _check_length(len(data) // header.dtype.itemsize, header)
    return np.frombuffer(data, header.dtype, count=header.n_points)


def _read_compressed(file: BinaryIO, header: _Header) -> NDArray[Any]:
    """Columns one after another, LZF-compressed as one block after two sizes."""
    sizes = np.frombuffer(file.read(8), "<u4")
    packed = np.frombuffer(file.read(int(sizes[0])), np.uint8)
    if len(packed) < sizes[0] or sizes[1] != header.n_points * header.dtype.itemsize:
        raise ValueError("its data is cut off")
    data = np.empty(int(sizes[1]), np.uint8)
    if lzf_decompress(packed, data) != len(data):
        raise ValueError("its compressed data is damaged")
    table = np.empty(header.n_points, header.dtype)
    start = 0
    for name in header.dtype.names or ():
        column = header.dtype[name]
        stop = start + header.n_points * column.itemsize
        table[name] = data[start:stop].view(column.base).reshape(header.n_points, *column.shape)
        start = stop
    return table


def _check_length(n_read: int, header: _Header) -> None:
    if n_read < header.n_points:
        raise ValueError(f"cut off after {n_read} of {header.n_points} points")


_READERS = {"ascii": _read_ascii, "binary": _read_binary, "binary_compressed": _read_compressed}
