"""Returns from dust: near the sensor and without structure (paper 002: the LiDAR's weight adapts in dusty roadways).

Rock near the LiDAR lies in thin sheets, dust fills space. Seen in small cubes the returns of rock are a few
centimetres thick at most, rough as it may be, those of dust are as thick as the cube. In clear air hardly a cube is;
where many are, the air is dusty, and what is near counts only where it is a sheet of enough points. Nothing is
remembered: when the dust is gone, the next scan counts whole.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from localize._numba_dust import cubes
from semmap.geometry import Array

_NEAR_M = 6.0
"""Dust that is farther off returns too little; and rock that is farther off may be seen in too few points."""
_CUBE_M = 0.4
_THICK_M = 0.05
"""More than the roughness of rock within a cube and the noise of ranges."""
_FEW = 6
"""Fewer points have no thickness to speak of."""
_SHEET_POINTS, _SHEET_M = 15, 0.04
"""What is rock in dusty air: at 200 mg/m³ six of seven points that pass are; of sheets half as full, every second."""
_DUSTY = 0.05
"""Share of the near returns in thick cubes beyond which the air is dusty; it is below 0.001 in clear air."""
_PART, _FEW_OF_PART, _PERHAPS = 2, 4, 0.25 * _DUSTY
"""Every second return is looked at first; so many have a thickness. A cube of dust that they miss is one with few."""


class Air:
    """What one scan, points (n, 3) in the lidar frame, deskewed or nearly so, says of the air.

    Attributes
    ----------
    dust : share (0 to 1) of the near returns that lie in cubes too thick for rock.
    clear : (n,) whether a return is rock, as far as can be told; all are in clear air.
    """

    def __init__(self, points: Array | NDArray[np.float32]) -> None:
        points = np.ascontiguousarray(points, dtype=np.float64)
        self.dust, self.clear = 0.0, np.ones(len(points), dtype=np.bool_)
        # in clear air a part of the returns tells; where there may be dust all are looked at
        if _share(_cubes(np.ascontiguousarray(points[::_PART])), _FEW_OF_PART) < _PERHAPS:
            return
        found = _cubes(points)
        self.dust = _share(found, _FEW)
        if self.dust > _DUSTY:
            near = found.cube >= 0
            rock = (found.inside >= _SHEET_POINTS) & (found.thickness < _SHEET_M)
            self.clear[near] = rock[found.cube[near]]

    @property
    def dusty(self) -> bool:
        """Whether returns were left out."""
        return self.dust > _DUSTY


class _Cubes(NamedTuple):
    """Points (m,) and thickness (m,) [m] of each cube near the sensor, and the cube (n,) of each point, or -1."""

    inside: NDArray[np.int64]
    thickness: Array
    cube: NDArray[np.int32]


def _cubes(points: Array) -> _Cubes:
    """The cubes that points (n, 3) fall in, near the sensor."""
    n = len(points)
    cube, count, thickness = np.empty(n, np.int32), np.empty(n, np.int64), np.empty(n)
    used = cubes(points, _NEAR_M, _CUBE_M, cube, count, thickness)
    return _Cubes(count[:used], thickness[:used], cube)


def _share(found: _Cubes, few: int) -> float:
    """Share of the points that lie in cubes too thick for rock; fewer points have no thickness."""
    thick = (found.inside >= few) & (found.thickness > _THICK_M)
    return float(found.inside[thick].sum() / max(found.inside.sum(), 1))
