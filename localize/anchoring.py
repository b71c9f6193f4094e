"""Where odom lies in the map, from UWB ranges or prism fixes alone, in motion, with no first guess.

Gravity is known, so four numbers are sought: heading and translation (paper 000, LIU mode: alignment with G).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from semmap.geometry import Array, se3, yaw_rotation

_STARTS = 12
"""Headings from which the ranges' solver starts."""
_HUBER = 1.5
_BAD_PART = 0.3
"""More outliers than this and the solution is not believed."""
_FITS = 3
"""Fits of fixes, each without those that the one before did not explain."""
_SAME_M = 0.5
_SAME_COS = 0.98
"""Solutions closer than this, at the track's middle and by the cosine of the headings' difference, are one."""


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
        R = yaw_rotation(_turn_between(a, b))
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


def align_ranges(
    p_level: Array, anchors: Array, distances: Array, std: float, bias_std: float = 0.0
) -> Alignment | None:
    """Heading and translation from ranges (n,) of the tag at ``p_level`` (n, 3) to anchors (n, 3) in the map.

    std : [m] of a range; bias_std : [m] of what an anchor reads too long beside it, which is sought as well.
    None where fewer than a good part of the ranges fit, or where a second place fits as well: behind the plane of the
    anchors the track has a mirror image, which only a track that gravity tells from it rules out. Between two places
    very near one another the middle is taken.
    """
    surveyed, source = np.unique(anchors, axis=0, return_inverse=True)
    if len(distances) < 12 or len(surveyed) < 3:
        return None
    biases = len(surveyed) if bias_std > 0.0 else 0
    middle = p_level.mean(axis=0)
    centred = p_level - middle

    def residual(x: Array) -> Array:
        tags = centred @ yaw_rotation(x[0]).T + x[1:4]
        off = (np.linalg.norm(tags - anchors, axis=1) - distances) / std
        return np.concatenate([off + x[4:][source] * (bias_std / std), x[4:]]) if biases else np.asarray(off)

    def solved(start: Array) -> OptimizeResult:
        x_scale = [0.1, *np.ones(3 + biases)]
        return least_squares(
            residual, np.append(start, np.zeros(biases)), loss="huber", f_scale=_HUBER, x_scale=x_scale
        )

    headings = np.linspace(-np.pi, np.pi, _STARTS, endpoint=False)
    found = [solved(np.concatenate([[yaw], anchors.mean(axis=0) + [0.0, 0.0, -0.5]])) for yaw in headings]
    best = min(found, key=lambda solution: solution.cost)
    found += [solved(start) for start in _mirrored(best.x, centred, surveyed)]
    best = min(found, key=lambda solution: solution.cost)
    if np.mean(np.abs(residual(best.x)) > 3.0) > _BAD_PART:
        return None
    as_well = [one.x[:4] for one in found if one.cost < 1.5 * best.cost + 10.0]
    farthest = max(as_well, key=lambda x: float(np.linalg.norm(x[1:] - best.x[1:4])))
    half = 0.5 * (farthest[1:] - best.x[1:4])
    if 2.0 * np.linalg.norm(half) > _SAME_M or min(np.cos(x[0] - best.x[0]) for x in as_well) < _SAME_COS:
        return None
    information = best.jac.T @ best.jac
    if np.linalg.cond(information) > 1e12:
        return None
    covariance = np.linalg.inv(information)
    R = yaw_rotation(best.x[0])
    return Alignment(
        se3(R, best.x[1:4] + half - R @ middle),
        float(np.sqrt(covariance[0, 0])),
        float(np.hypot(np.sqrt(np.linalg.eigvalsh(covariance[1:4, 1:4])[-1]), np.linalg.norm(half))),
    )


def _mirrored(x: Array, centred: Array, surveyed: Array) -> list[Array]:
    """Where the track's mirror images lie, as heading and place (4,): behind the plane nearest to the anchors, behind
    the plane across it through their longest axis, and behind both."""
    origin = surveyed.mean(axis=0)
    axes = np.linalg.svd(surveyed - origin)[2]
    track = centred @ yaw_rotation(x[0]).T
    images = []
    for across in (axes[2:], axes[1:2], axes[1:]):
        mirror = np.eye(3) - 2.0 * across.T @ across
        yaw = x[0] + _turn_between(track, track @ mirror)
        images.append(np.concatenate([[yaw], origin + mirror @ (x[1:4] - origin)]))
    return images


def _turn_between(a: Array, b: Array) -> float:
    """Turn about the vertical that takes points a (n, 3) onto b (n, 3) best."""
    return float(np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a[:, :2] * b[:, :2])))
