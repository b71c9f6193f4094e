"""Vertices of PLY files (ascii, binary of either byte order), float or double; faces are not read."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from maps.point_table import PIECE_POINTS, Extent, coordinates, record_blocks, text_blocks
from semmap.errors import InputFileError
from semmap.geometry import Array

_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MAX_HEADER_LINES = 1000


@dataclass(slots=True)
class _Element:
    """One ``element`` of the header: how many rows of which scalar properties."""

    name: str
    count: int
    properties: list[tuple[str, str]]
    has_list: bool = False


def ply_extent(path: Path) -> Extent:
    """Number of vertices the header promises. Raises `InputFileError` where the header is wrong."""
    with _open(path) as file:
        encoding, elements = _read_header(file)
        count = _vertices(encoding, elements).count
    return Extent(count, count if encoding == "ascii" else PIECE_POINTS)


def ply_points(path: Path, start: int, stop: int, rows: int) -> Iterator[Array]:
    """Vertices ``start`` to ``stop``, (up to ``rows``, 3) float64 [m] at a time, those that are not finite included.

    Raises `InputFileError` where the file is cut off or its header is wrong, `CloudError` without x, y or z.
    """
    with _open(path) as file:
        encoding, elements = _read_header(file)
        vertices = _vertices(encoding, elements)
        for element in elements[: elements.index(vertices)]:
            _skip_rows(file, encoding, element)
        for table in _read_rows(file, encoding, vertices, start, stop, rows):
            yield coordinates(table, path)


@contextmanager
def _open(path: Path) -> Iterator[BinaryIO]:
    with path.open("rb") as file:
        try:
            yield file
        except (ValueError, KeyError, IndexError) as reason:
            what = f"is not a readable PLY file ({reason})"
            raise InputFileError(what, file=path, mend="export the cloud again") from None


def _read_header(file: BinaryIO) -> tuple[str, list[_Element]]:
    encoding, elements = "", list[_Element]()
    for _ in range(_MAX_HEADER_LINES):
        words = file.readline(65536).decode("ascii", "replace").split() or [""]
        if words[0] == "format":
            encoding = words[1]
        elif words[0] == "element":
            elements.append(_Element(words[1], int(words[2]), []))
        elif words[0] == "property" and words[1] == "list":
            elements[-1].has_list = True
        elif words[0] == "property":
            elements[-1].properties.append((words[2], _TYPES[words[1]]))
        elif words[0] == "end_header":
            break
    else:
        raise ValueError("its header does not end")
    if encoding not in _ORDERS:
        raise ValueError(f"unknown format {encoding!r}")
    return encoding, elements


def _vertices(encoding: str, elements: list[_Element]) -> _Element:
    """The element whose rows are the points; nothing before it may be of unknown length."""
    for element in elements:
        if element.has_list and (element.name == "vertex" or encoding != "ascii"):
            raise ValueError(f"a list in element {element.name} comes before the end of the vertices")
        if element.name == "vertex":
            return element
    raise ValueError("it has no element vertex")


def _dtype(encoding: str, element: _Element) -> np.dtype[Any]:
    return np.dtype([(name, _ORDERS[encoding] + code) for name, code in element.properties])


def _skip_rows(file: BinaryIO, encoding: str, element: _Element) -> None:
    if encoding == "ascii":
        for _ in range(element.count):
            file.readline()
    else:
        file.seek(element.count * _dtype(encoding, element).itemsize, io.SEEK_CUR)


def _read_rows(
    file: BinaryIO, encoding: str, element: _Element, start: int, stop: int, rows: int
) -> Iterator[NDArray[Any]]:
    if encoding != "ascii":
        yield from record_blocks(file, _dtype(encoding, element), element.count, start, stop, rows)
        return
    names = [name for name, _ in element.properties]
    for values in text_blocks(file, element.count, range(len(names)), rows):
        table = np.empty(len(values), [(name, np.float64) for name in names])
        for k, name in enumerate(names):
            table[name] = values[:, k]
        yield table
