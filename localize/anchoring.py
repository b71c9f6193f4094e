"""Where odom lies in the map, from UWB ranges or prism fixes alone, in motion, with no first guess.

Gravity is known, so four numbers are sought: heading and translation (paper 000, LIU mode: alignment with G).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from semmap.geometry import Array, se3, yaw_rotation

_STARTS = 12
"""Headings from which the ranges' solver starts."""
_HUBER = 1.5
_BAD_PART = 0.3
"""More outliers than this and the solution is not believed."""
_FITS = 3
"""Fits of fixes, each without those that the one before did not explain."""
_SAME_M = 0.5
"""Solutions closer than this, at the track's middle, are one."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """``T_map_level`` (4, 4) of a gravity-levelled odom, with the standard deviation of heading [rad] and place [m]."""

    T_map_level: Array
    yaw_std: float
    position_std: float

    def sure(self, *, yaw_std: float, position_std: float) -> bool:
        """Whether it is known this well."""
        return self.yaw_std < yaw_std and self.position_std < position_std


def align_fixes(p_level: Array, p_map: Array, std: float, odometry_std: float = 0.0) -> Alignment | None:
    """Heading and translation from points (n, 3) known in both frames; None where they do not fit one another.

    std : of a fix [m]. odometry_std : of the odometry over the stretch, by its own account [m].
    """
    if len(p_level) < 3:
        return None
    for _ in range(_FITS):
        a, b = p_level - p_level.mean(axis=0), p_map - p_map.mean(axis=0)
        spread = float(np.sum(a[:, :2] ** 2))
        yaw = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a[:, :2] * b[:, :2]))
        R = yaw_rotation(float(yaw))
        off = np.linalg.norm(b - a @ R.T, axis=1)
        # odometry's own error over the stretch comes on top of the instrument's
        noise = std + odometry_std + 0.005 * np.sqrt(spread / len(a))
        if np.median(off) > 4.0 * noise or spread == 0.0:
            return None
        # something else that shines
        good = off <= 4.0 * max(noise, float(np.median(off)))
        if good.all():
            break
        p_level, p_map = p_level[good], p_map[good]
    T = se3(R, p_map.mean(axis=0) - R @ p_level.mean(axis=0))
    # the fixes' noise averages out, odometry's error is one over the stretch
    each, all_alike = std + 0.005 * np.sqrt(spread / len(a)), odometry_std
    yaw_std = (each + all_alike * np.sqrt(len(a))) / np.sqrt(spread)
    return Alignment(T, float(yaw_std), float(each / np.sqrt(len(a)) + all_alike))


def align_ranges(p_level: Array, anchors: Array, distances: Array, std: float) -> Alignment | None:
    """Heading and translation from ranges (n,) of the tag at ``p_level`` (n, 3) to anchors (n, 3) in the map.

    None where fewer than a good part of the ranges fit, or where a second place fits as well (a straight track beside
    anchors in line has a mirror image).
    """
    if len(distances) < 12 or len(np.unique(anchors, axis=0)) < 3:
        return None
    middle = p_level.mean(axis=0)
    centred = p_level - middle

    def residual(x: Array) -> Array:
        tags = centred @ yaw_rotation(x[0]).T + x[1:]
        return np.asarray((np.linalg.norm(tags - anchors, axis=1) - distances) / std)

    found = []
    for yaw in np.linspace(-np.pi, np.pi, _STARTS, endpoint=False):
        start = np.concatenate([[yaw], anchors.mean(axis=0) + [0.0, 0.0, -0.5]])
        found.append(least_squares(residual, start, loss="huber", f_scale=_HUBER, x_scale=[0.1, 1.0, 1.0, 1.0]))
    found.sort(key=lambda solution: solution.cost)
    best = found[0]
    if np.mean(np.abs(residual(best.x)) > 3.0) > _BAD_PART:
        return None
    for other in found[1:]:
        apart = np.linalg.norm(other.x[1:] - best.x[1:]) > _SAME_M or np.cos(other.x[0] - best.x[0]) < 0.98
        if apart and other.cost < 1.5 * best.cost + 10.0:
            return None
    information = best.jac.T @ best.jac
    if np.linalg.cond(information) > 1e12:
        return None
    covariance = np.linalg.inv(information)
    R = yaw_rotation(best.x[0])
    return Alignment(
        se3(R, best.x[1:] - R @ middle),
        float(np.sqrt(covariance[0, 0])),
        float(np.sqrt(np.linalg.eigvalsh(covariance[1:, 1:])[-1])),
    )
