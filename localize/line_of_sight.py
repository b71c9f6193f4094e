"""Whether rock that the LiDAR has seen lies between two places: what is heard without a detour has a free way."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from semmap.geometry import Array

_VOXEL_M = 0.2
_END_M = 0.5
"""Nearer than this to either end nothing counts: anchors hang on rock, tags sit on robots."""
_END_SHARE = 0.15
"""And at the far end this part of the way: an anchor low on a wall is seen along the floor."""
_LONGEST_M = 200.0
"""What lies farther along a way is not looked at: no LiDAR sees so far in a mine."""
_BITS = 21
"""Of a voxel's number along each axis."""
_VIEWS = 200
"""The last views that are kept."""


class SightLines:
    """Voxels of rock, in one frame, and straight ways through them."""

    def __init__(self) -> None:
        self._rock: deque[NDArray[np.int64]] = deque(maxlen=_VIEWS)

    def add(self, points: Array | NDArray[np.float32]) -> None:
        """Rock was seen at ``points`` (n, 3)."""
        self._rock.append(np.unique(_voxels(points)))

    def blocked(self, begin: Array, end: Array) -> NDArray[np.bool_]:
        """Whether the ways from ``begin`` (n, 3) to ``end`` (n, 3) pass through rock."""
        way = end - begin
        metres = np.linalg.norm(way, axis=1)
        last = np.maximum(_END_M, _END_SHARE * metres)
        steps = np.arange(_END_M, min(float(metres.max(initial=_END_M)), _LONGEST_M), 0.5 * _VOXEL_M)
        at = begin[:, None] + (steps / np.maximum(metres, 1e-9)[:, None])[..., None] * way[:, None]
        rock = np.concatenate([np.zeros(0, np.int64), *self._rock])
        hit = np.isin(_voxels(at.reshape(-1, 3)), rock).reshape(len(begin), len(steps))
        return np.asarray((hit & (steps < metres[:, None] - last[:, None])).any(axis=1))


def _voxels(points: Array | NDArray[np.float32]) -> NDArray[np.int64]:
    """Numbers (n,) of the voxels that points (n, 3) lie in; such as are a hundred kilometres apart may share one."""
    cells = np.floor(points / _VOXEL_M).astype(np.int64) & ((1 << _BITS) - 1)
    return np.asarray((cells[:, 0] << 2 * _BITS) | (cells[:, 1] << _BITS) | cells[:, 2])
