"""Whether the robot stands still at the start: told by scans that repeat themselves."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from semmap.geometry import Array
from semmap.measurements import Scan

MOVED_M = 0.04
"""A robot that stands still may have moved by so much without a trace in the ranges [m]."""
_ASKED = 2000
"""Rays of a scan that are compared."""
_SAME_RAY = 0.01
"""Rays of two scans that are no farther apart than this meet the same rock [rad]."""
_USUAL, _REPEATED = 0.95, 0.10
"""Of the differences between scans that follow one another 5 % are larger than their 95 % quantile. Where more than
10 % of those to the first scan are, the robot has moved. Measured: at most 7 % at rest, 15 to 50 % after 0.1 m."""

_LEAST_S = 0.5
"""Over less no motion shows [s]: the second scan differs from the first as any two."""


def still_seconds(scans: Sequence[Scan]) -> float:
    """How long the robot stays where it was in the first scan [s]; 0 where it moves, or they hold or last too little.

    scans : in order of time, not deskewed.

    Noise, dust and a pattern that does not repeat make ranges differ as much from one scan to the next as to the tenth;
    motion makes them differ ever more. Of a steady motion along a tunnel without any structure ranges tell nothing.
    """
    if len(scans) < 2 or any(len(scan.points) < _ASKED // 4 for scan in scans):
        return 0.0
    first, near, still_ns = _Ranges(scans[0]), np.empty(0), scans[0].end_ns
    for before, scan in pairwise(scans):
        near = np.concatenate([near, _Ranges(before).differences(scan)])
        far = first.differences(scan)
        if not len(far) or np.mean(far > np.quantile(near, _USUAL)) > _REPEATED:
            break
        still_ns = scan.end_ns
    still_s = (still_ns - scans[0].end_ns) * 1e-9
    return still_s if still_s >= _LEAST_S else 0.0


class _Ranges:
    """Ranges of a scan by direction."""

    def __init__(self, scan: Scan) -> None:
        self.rays, self.ranges = _polar(scan)
        self.tree = cKDTree(self.rays)

    def differences(self, scan: Scan) -> Array:
        """By how much the ranges of another scan differ along the same rays (m,) [m]."""
        rays, ranges = _polar(scan.thinned(_ASKED))
        away, at = self.tree.query(rays, distance_upper_bound=_SAME_RAY)
        same = np.isfinite(away)
        return np.asarray(np.abs(ranges[same] - self.ranges[at[same]]))


def _polar(scan: Scan) -> tuple[Array, Array]:
    ranges = np.linalg.norm(scan.points.astype(np.float64), axis=1)
    seen = ranges > 0.0
    return scan.points[seen] / ranges[seen, None], ranges[seen]
