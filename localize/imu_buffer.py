"""IMU samples that wait for the scans they carry, in order of time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from semmap.geometry import Array
from semmap.measurements import ImuSample


class ImuInterval(NamedTuple):
    """Samples over an interval, its two ends among them: stamps (n,), ``gyro`` and ``accel`` (n, 3)."""

    stamps_ns: NDArray[np.int64]
    gyro: Array
    accel: Array


class ImuBuffer:
    """Stamps and values side by side in arrays, so that an interval is a slice of them."""

    def __init__(self) -> None:
        self._stamps = np.empty(1024, np.int64)
        self._values = np.empty((1024, 6))
        self._begin = self._end = 0

    def __len__(self) -> int:
        return self._end - self._begin

    @property
    def last_ns(self) -> int:
        """Stamp of the newest sample; the buffer must not be empty."""
        return int(self._stamps[self._end - 1])

    def append(self, sample: ImuSample) -> None:
        """Take a sample in; it must be newer than the newest."""
        if self._end == len(self._stamps):
            self._make_room()
        self._stamps[self._end] = sample.stamp_ns
        self._values[self._end, :3] = sample.gyro
        self._values[self._end, 3:] = sample.accel
        self._end += 1

    def _make_room(self) -> None:
        kept = slice(self._begin, self._end)
        size = max(1024, 2 * len(self))
        stamps, values = np.empty(size, np.int64), np.empty((size, 6))
        stamps[: len(self)], values[: len(self)] = self._stamps[kept], self._values[kept]
        self._stamps, self._values, self._begin, self._end = stamps, values, 0, len(self)

    def between(self, begin_ns: int, end_ns: int) -> ImuInterval:
        """The samples from ``begin_ns`` to ``end_ns``, interpolated at both; beyond the samples the nearest holds."""
        stamps, values = self._stamps[self._begin : self._end], self._values[self._begin : self._end]
        first, last = np.searchsorted(stamps, begin_ns, "right"), np.searchsorted(stamps, end_ns, "left")
        n = max(int(last - first), 0) + 2
        at, interval = np.empty(n, np.int64), np.empty((n, 6))
        at[0], at[1:-1], at[-1] = begin_ns, stamps[first:last], end_ns
        interval[0], interval[1:-1] = _at(begin_ns, int(first), stamps, values), values[first:last]
        interval[-1] = _at(end_ns, int(last), stamps, values)
        return ImuInterval(at, interval[:, :3], interval[:, 3:])

    def forget_before(self, stamp_ns: int) -> None:
        """Drop what is older than the last sample up to ``stamp_ns``."""
        stamps = self._stamps[self._begin : self._end]
        self._begin += max(0, int(np.searchsorted(stamps, stamp_ns, "right")) - 1)


def _at(stamp_ns: int, after: int, stamps: NDArray[np.int64], values: Array) -> Array:
    """The row of ``values`` (n, 6) at a time before the sample ``after`` and not before the one ahead of it."""
    if after == 0 or after == len(stamps):
        return np.asarray(values[max(after - 1, 0)])
    share = (stamp_ns - stamps[after - 1]) / (stamps[after] - stamps[after - 1])
    return np.asarray(values[after - 1] + share * (values[after] - values[after - 1]))
