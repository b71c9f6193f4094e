"""Numbers for the scripts of a page: quantised, compressed, and written so that nothing of them can end the script."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semmap.geometry import Array

STEPS = 1023
"""Ten bits an axis, three axes in 32 bits."""
BATCH = 32
"""Clouds that are compressed together: a page unpacks a batch when one of its clouds is looked at."""


class Blobs:
    """Arrays of a page by name, as the bytes its scripts unpack."""

    def __init__(self) -> None:
        self._parts: dict[str, str] = {}

    def add(self, name: str, values: NDArray[Any]) -> None:
        """Keep an array as little-endian bytes; the scripts know its type."""
        array = np.ascontiguousarray(values)
        raw = array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes()
        self._parts[name] = base64.b64encode(gzip.compress(raw, 6, mtime=0)).decode("ascii")

    def html(self) -> str:
        """One element an array; base64 has no character that HTML knows."""
        return "\n".join(f'<script type="text/plain" id="blob-{k}">{v}</script>' for k, v in self._parts.items())

    def size(self) -> int:
        """Characters of all."""
        return sum(map(len, self._parts.values()))


def json_element(data: Mapping[str, Any]) -> str:
    """Data as an element that scripts parse; what HTML could read as its end is escaped."""
    text = json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":"), default=_plain)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return f'<script type="application/json" id="data">{text}</script>'


def _plain(value: object) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no place in a page")


def numbers(values: Iterable[Any], digits: int) -> list[float | None]:
    """Numbers rounded, None for what is not known."""
    array = np.asarray(list(values), np.float64)
    rounded = np.round(array, digits)
    return [
        value if known else None for value, known in zip(rounded.tolist(), np.isfinite(array).tolist(), strict=True)
    ]


class Clouds:
    """Point clouds in 32 bits a point, `BATCH` to an array, each with the box it lies in.

    The scripts find cloud k in array ``{name}-{k // BATCH}`` from point ``start`` on: ``low + step * (10 bits)``.
    """

    def __init__(self, blobs: Blobs, name: str) -> None:
        self._blobs, self._name = blobs, name
        self._waiting: list[NDArray[np.uint32]] = []
        self._rows: list[list[float]] = []

    def add(self, points: Array) -> None:
        """Add one cloud (n, 3) [m]."""
        low, step, packed = packed_points(points)
        start = sum(map(len, self._waiting))
        self._rows.append([start, len(packed), *low.round(4).tolist(), *step.round(7).tolist()])
        self._waiting.append(packed)
        if len(self._waiting) == BATCH:
            self._write()

    def done(self) -> list[list[float]]:
        """A row for each cloud: start, number of points, low (3), step (3)."""
        if self._waiting:
            self._write()
        return self._rows

    def _write(self) -> None:
        self._blobs.add(f"{self._name}-{(len(self._rows) - 1) // BATCH}", np.concatenate(self._waiting))
        self._waiting = []


def packed_points(points: Array) -> tuple[Array, Array, NDArray[np.uint32]]:
    """Points (n, 3) as the low corner (3,) and step (3,) of a grid, and 32 bits each; sorted, for compression."""
    points = np.asarray(points, np.float64).reshape(-1, 3)
    if not len(points):
        return np.zeros(3), np.zeros(3), np.zeros(0, np.uint32)
    low = points.min(axis=0)
    step = np.maximum(np.ptp(points, axis=0), 1e-6) / STEPS
    x, y, z = np.clip(np.round((points - low) / step), 0, STEPS).astype(np.uint32).T
    return low, step, np.sort(x | y << np.uint32(10) | z << np.uint32(20))


def thinned(points: Array, at_most: int) -> Array:
    """At most so many of the points (n, 3), spread evenly: every k-th of those in order of a coarse grid."""
    if len(points) <= at_most:
        return points
    cells = np.floor((points - points.min(axis=0)) / 1.0).astype(np.int64)
    order = np.lexsort((np.arange(len(points)), *cells.T))
    return np.asarray(points[order[np.linspace(0, len(points) - 1, at_most).astype(np.int64)]])


def simplified(line: Array, tolerance: float) -> NDArray[np.int64]:
    """Indices of the points of a line (n, d) that are enough to draw it, none of the others being farther off than
    ``tolerance`` (Douglas and Peucker)."""
    keep = np.zeros(len(line), np.bool_)
    keep[[0, -1]] = True
    waiting = [(0, len(line) - 1)]
    while waiting:
        first, last = waiting.pop()
        if last - first < 2:
            continue
        off = _off_segment(line[first + 1 : last], line[first], line[last])
        worst = int(np.argmax(off))
        if off[worst] > tolerance:
            middle = first + 1 + worst
            keep[middle] = True
            waiting += [(first, middle), (middle, last)]
    return np.flatnonzero(keep)


def _off_segment(points: Array, start: Array, end: Array) -> Array:
    way = end - start
    square = float(way @ way)
    share = np.clip((points - start) @ way / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(points))
    off: Array = np.linalg.norm(points - start - share[:, None] * way, axis=1)
    return off


def batches(items: Sequence[Any], size: int) -> Iterator[Sequence[Any]]:
    """The items, so many at a time."""
    for k in range(0, len(items), size):
        yield items[k : k + size]
