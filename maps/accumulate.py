"""Clouds added up to a map that is thinned to a voxel size: its memory grows with the mine, not with the recording."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pydantic import PositiveFloat, PositiveInt

from maps._numba_accumulate import BITS, EMPTY, add_up, move
from maps.grid import Points
from semmap.errors import CloudError
from semmap.geometry import Array
from semmap.settings import Settings

_FIRST_SIZE = 1 << 16
_ENOUGH = 1000
"""A mean of so many points gets no better, and the sum stays exact."""
_BLOCK = 1 << 20


class ScanMapSettings(Settings):
    """A map made of a recording's scans."""

    voxel: PositiveFloat = 0.1
    """The map is thinned to one point a voxel of this edge [m]."""
    range: PositiveFloat = 30.0
    """Of each scan, only what is nearer than this to the LiDAR is used: beyond it the attitude's error counts [m]."""
    least_points: PositiveInt = 2
    """Voxels that fewer points fell into are left out: stray returns, and what moves."""


class AccumulatedCloud:
    """Means of the points in each voxel of edge ``voxel`` [m].

    Parameters
    ----------
    origin : (3,) everything must lie within a million voxels of it.
    """

    def __init__(self, voxel: float, origin: Array) -> None:
        self.voxel, self.origin = voxel, np.asarray(origin, np.float64)
        self._count = 0
        self._allocate(_FIRST_SIZE)

    def __len__(self) -> int:
        """Voxels that hold points."""
        return self._count

    def add(self, points: Points) -> None:
        """Add points (n, 3) [m]. Raises `CloudError` for what is not finite, or too far from the origin."""
        relative = np.ascontiguousarray(points, np.float64) - self.origin
        if not np.all(np.abs(relative) < self.voxel * (1 << (BITS - 1))):  # not true of nan
            raise CloudError("is not finite, or too far from the rest", field="points", mend="give a larger voxel")
        size = len(self._keys)
        while size < 2 * (self._count + len(relative)):
            size *= 2
        if size > len(self._keys):
            before = self._keys, self._sums, self._counts
            self._allocate(size)
            move(*before, self._keys, self._sums, self._counts)
        self._count += add_up(relative, self.voxel, _ENOUGH, self._keys, self._sums, self._counts)

    def blocks(self, least_points: int = 1) -> Iterator[Array]:
        """The means (n, 3) [m] of voxels with at least so many points, in the order of their coordinates."""
        slots = np.flatnonzero(self._counts >= least_points)
        slots = slots[np.argsort(self._keys[slots])]
        for k in range(0, len(slots), _BLOCK):
            some = slots[k : k + _BLOCK]
            parts = [self._keys[some] >> shift & ((1 << BITS) - 1) for shift in (2 * BITS, BITS, 0)]
            corners = np.stack(parts, axis=1) - (1 << (BITS - 1))
            means = self._sums[some].astype(np.float64) / self._counts[some, None]
            yield self.origin + self.voxel * (corners + means)

    def _allocate(self, size: int) -> None:
        self._keys = np.full(size, EMPTY, np.int64)
        self._sums, self._counts = np.zeros((size, 3), np.float32), np.zeros(size, np.int32)
