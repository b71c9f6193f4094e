"""Returns from dust: near the sensor and without structure (paper 002: the LiDAR's weight adapts in dusty roadways).

Rock near the LiDAR lies in thin sheets, dust fills space. Seen in small cubes the returns of rock are a few
centimetres thick at most, rough as it may be, those of dust are as thick as the cube. In clear air hardly a cube is;
where many are, the air is dusty, and what is near counts only where it is a sheet of enough points. Nothing is
remembered: when the dust is gone, the next scan counts whole.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
_STRIDE = 1 << 12


class Air:
    """What one scan, points (n, 3) in the lidar frame, deskewed or nearly so, says of the air.

    Attributes
    ----------
    dust : share (0 to 1) of the near returns that lie in cubes too thick for rock.
    clear : (n,) whether a return is rock, as far as can be told; all are in clear air.
    """

    def __init__(self, points: Array | NDArray[np.float32]) -> None:
        near = np.flatnonzero(np.einsum("ij,ij->i", points, points) < _NEAR_M**2)
        self.dust, self.clear = 0.0, np.ones(len(points), dtype=np.bool_)
        if not len(near):
            return
        count, thickness, cube = _cubes(np.asarray(points[near], dtype=np.float64))
        thick = (count >= _FEW) & (thickness > _THICK_M)
        self.dust = float(count[thick].sum() / len(near))
        if self.dust > _DUSTY:
            self.clear[near] = ((count >= _SHEET_POINTS) & (thickness < _SHEET_M))[cube]

    @property
    def dusty(self) -> bool:
        """Whether returns were left out."""
        return self.dust > _DUSTY


def _cubes(points: Array) -> tuple[NDArray[np.int64], Array, NDArray[np.int64]]:
    """Points (m,) and thickness (m,) [m] of each cube that points (n, 3) fall in, and the cube (n,) of each."""
    keys = np.floor(points / _CUBE_M).astype(np.int64) @ np.array([1, _STRIDE, _STRIDE**2])
    cube = np.unique(keys, return_inverse=True)[1].astype(np.int64)
    count = np.bincount(cube).astype(np.int64)
    mean = np.column_stack([np.bincount(cube, axis) for axis in points.T]) / count[:, None]
    off = points - mean[cube]
    scatter = np.empty((len(count), 3, 3))
    for a in range(3):
        for b in range(a + 1):
            scatter[:, a, b] = scatter[:, b, a] = np.bincount(cube, off[:, a] * off[:, b]) / count
    return count, np.sqrt(np.maximum(np.linalg.eigvalsh(scatter)[:, 0], 0.0)), cube
