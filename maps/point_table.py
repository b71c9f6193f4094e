"""Rows of points in files: blocks of a table of numbers, as text or as packed records."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from semmap.errors import CloudError
from semmap.geometry import Array

PIECE_POINTS = 2_000_000
"""Points that are worth a task of their own, in files that can be read from anywhere."""


class Extent(NamedTuple):
    """How long a file is: ``rows`` (points; scans of an E57 file), of which ``at_once`` are read in one go."""

    rows: int
    at_once: int


def steps(start: int, stop: int, rows: int) -> Iterator[tuple[int, int]]:
    """``start`` to ``stop`` in steps of at most ``rows``."""
    return ((low, min(low + rows, stop)) for low in range(start, stop, rows))


def coordinates(table: NDArray[Any], path: str | Path) -> Array:
    """Columns x, y, z of a structured array as (n, 3) float64. Raises `CloudError` where one is missing."""
    names = table.dtype.names or ()
    for axis in "xyz":
        if axis not in names:
            raise CloudError("is missing", file=path, field=axis, mend=f"the file has {', '.join(names)}")
    return np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=1)


def text_blocks(file: BinaryIO, count: int, columns: Sequence[int], rows: int) -> Iterator[Array]:
    """The next ``count`` lines of numbers, (up to ``rows``, columns) float64 at a time.

    Raises `ValueError` where there are fewer, or they are no numbers.
    """
    filled = (line for line in io.TextIOWrapper(file, encoding="ascii") if line.strip())
    for low, high in steps(0, count, rows):
        lines = list(islice(filled, high - low))
        check_count(low + len(lines), high, count)
        yield np.loadtxt(lines, np.float64, comments=None, usecols=columns, ndmin=2)


def record_blocks(
    file: BinaryIO, dtype: np.dtype[Any], count: int, start: int, stop: int, rows: int
) -> Iterator[NDArray[Any]]:
    """Records ``start`` to ``stop`` of the ``count`` that begin here, up to ``rows`` at a time.

    Raises `ValueError` where the file ends before them.
    """
    file.seek(start * dtype.itemsize, io.SEEK_CUR)
    for low, high in steps(start, stop, rows):
        data = file.read((high - low) * dtype.itemsize)
        n = len(data) // dtype.itemsize
        check_count(low + n, high, count)
        yield np.frombuffer(data, dtype, count=n)


def check_count(found: int, expected: int, count: int) -> None:
    """Raise `ValueError` if rows are missing."""
    if found < expected:
        raise ValueError(f"cut off after {found} of {count} points")
