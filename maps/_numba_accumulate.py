"""Kernel that adds points up by voxel, in a hash table with open addressing. Caller: `maps.accumulate`."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

EMPTY = -1
BITS = 21
"""Of a key for each axis: voxels up to a million from the origin, to either side."""


@numba.njit(cache=True, nogil=True)
def slot_of(key: int, keys: NDArray[np.int64]) -> int:
    """Where ``key`` is in the table of 2^k ``keys``, or the empty slot for it; the table must not be full."""
    mask = len(keys) - 1
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    slot = int(mixed >> np.uint64(32)) & mask
    while keys[slot] != EMPTY and keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@numba.njit(cache=True, nogil=True)
def add_up(
    points: NDArray[np.float64],
    voxel: float,
    enough: int,
    keys: NDArray[np.int64],
    sums: NDArray[np.float32],
    counts: NDArray[np.int32],
) -> int:
    """Add points (n, 3) to the sums of their voxels, at most ``enough`` to each; returns how many voxels are new.

    sums (2^k, 3) are relative to the voxel's corner, in voxels, so that they stay small.
    """
    new = 0
    half = 1 << (BITS - 1)
    scaled = np.empty(3)
    for n in range(points.shape[0]):
        key = 0
        for axis in range(3):
            scaled[axis] = points[n, axis] / voxel
            key = (key << BITS) | (int(np.floor(scaled[axis])) + half)
        slot = slot_of(key, keys)
        if keys[slot] == EMPTY:
            keys[slot] = key
            new += 1
        if counts[slot] < enough:
            for axis in range(3):
                sums[slot, axis] += np.float32(scaled[axis] - np.floor(scaled[axis]))
            counts[slot] += 1
    return new


@numba.njit(cache=True, nogil=True)
def move(
    keys: NDArray[np.int64],
    sums: NDArray[np.float32],
    counts: NDArray[np.int32],
    to_keys: NDArray[np.int64],
    to_sums: NDArray[np.float32],
    to_counts: NDArray[np.int32],
) -> None:
    """Move everything into another, larger table."""
    for old in range(len(keys)):
        if keys[old] != EMPTY:
            slot = slot_of(keys[old], to_keys)
            to_keys[slot], to_counts[slot] = keys[old], counts[old]
            to_sums[slot] = sums[old]
