"""How far off the way from keyframe to keyframe is, such that a chain of them adds up honestly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localize.odometry import OdometryPose
from localize.settings import GraphSettings
from localize.state import POSITION
from semmap.geometry import Array

_NOTHING = 1e-3 * np.eye(6)
"""What is known where a scan says nothing, so that its information has an inverse."""
_SHARED = 0.5
"""A link within a drift of whose speed less than this is that of the link before errs by itself: a wheel holds it."""
_FORGOTTEN = 1e-3
"""So little is left of a speed that it is another."""


@dataclass(frozen=True, slots=True)
class Slide:
    """How a way slides where scans are blind: by the speed of the way before, as much as is left of it, and its walk.

    The speed is ``left`` times a vector that walks from link to link for as long as these slide.

    seconds : of the way.
    walk, whole : covariances (3, 3), axes of odom, of what the vector changed by, and of the vector [m²/s²].
    alone : covariance (6, 6) of the way if the speed were known, perturbed on the right.
    """

    seconds: float
    left: float
    walk: Array
    whole: Array
    alone: Array


@dataclass(frozen=True, slots=True)
class Link:
    """Covariance (6, 6) of the way to a keyframe, rotation first, perturbed on the right; and how it slides."""

    covariance: Array
    slide: Slide | None = None


class LinkCovariances:
    """Covariances of the poses relative to the last keyframe.

    The filter's own is right for one link, but a graph takes links for independent. Where scans hold the velocity one
    link's error in position tends to be the next few ones' as well: `GraphSettings.link_correlation`. Where a scan is
    blind, along a smooth drift, the velocity's error stays what it is for as long as that lasts: there a link is as far
    off as the filter's place in odom comes to be off by more meanwhile, so that all of them together are as it is. They
    share that speed: what ends a drift tells how it went.
    """

    def __init__(self, settings: GraphSettings, weak_std: float) -> None:
        self.settings, self.weak_std = settings, weak_std
        self._last: OdometryPose | None = None
        self._slid, self._left = np.zeros((6, 6)), 1.0
        """Covariance, in odom, of how far the links have slid and of the speed; what is left of the vector."""

    def of(self, pose: OdometryPose) -> Link:
        """The way to ``pose``."""
        return self._grown(pose)[0]

    def blind(self, pose: OdometryPose) -> bool:
        """Whether the scan leaves the place open in some direction."""
        return self._blind(pose).size > 0

    def keyframe(self, pose: OdometryPose) -> None:
        """The way goes on from here."""
        link, self._slid = self._grown(pose)
        self._left = link.slide.left if link.slide is not None else 1.0
        self._last = pose

    def _grown(self, pose: OdometryPose) -> tuple[Link, Array]:
        """The way to ``pose``, and how far the links slid and by what speed then (6, 6)."""
        s, R = self.settings, pose.T_odom_imu[:3, :3]
        drift = np.repeat([s.drift_rotation, s.drift_position], 3) ** 2
        stretch = np.repeat([1.0, np.sqrt(s.link_correlation)], 3)
        covariance: Array = pose.since_keyframe * np.outer(stretch, stretch) + np.diag(drift)
        blind = self._blind(pose)
        if self._last is None or not blind.size:
            return Link(covariance), np.zeros((6, 6))
        across = np.eye(6)
        across[3:, 3:] -= blind @ blind.T
        alone = across @ covariance @ across
        alone[3:, 3:] += s.drift_position**2 * blind @ blind.T
        more = R.T @ (pose.covariance[POSITION, POSITION] - self._last.covariance[POSITION, POSITION]) @ R
        for u in blind.T:
            covariance[3:, 3:] += max(0.0, float(u @ (more - covariance[3:, 3:]) @ u)) * np.outer(u, u)
        grows = np.einsum("im,ij,jm->m", blind, covariance[3:, 3:], blind)
        seconds = (pose.stamp_ns - self._last.stamp_ns) * 1e-9
        share, walk = self._speed(seconds, R @ blind, grows)
        speed = np.diag(np.repeat([1.0, share], 3)) @ self._slid @ np.diag(np.repeat([1.0, share], 3))
        speed[3:, 3:] += walk
        F = np.eye(6)
        F[:3, 3:] = seconds * np.eye(3)
        slide, begins = None, not self._slid.any()
        if share > 0.0 or begins:
            left = self._left * share if share > 0.0 else 1.0
            slide = Slide(seconds, left, walk / left**2, speed[3:, 3:] / left**2, alone)
        return Link(covariance, slide), F @ speed @ F.T

    def _speed(self, seconds: float, axes: Array, grows: Array) -> tuple[float, Array]:
        """How much of the speed goes on, and the covariance (3, 3) of its walk, where the place's variance ``grows``
        (m,) along ``axes`` (3, m) of odom: as much as does not make it grow faster."""
        by = 2.0 * seconds * np.einsum("im,ij,jm->m", axes, self._slid[:3, 3:], axes)
        by2 = seconds**2 * np.einsum("im,ij,jm->m", axes, self._slid[3:, 3:], axes)
        share = float(np.min(2.0 * grows / (by + np.sqrt(by**2 + 4.0 * by2 * grows) + 1e-30), initial=1.0))
        if share < _SHARED or self._left * share < _FORGOTTEN or not self._slid.any():
            share = 0.0
        more = np.maximum(grows - share * by - share**2 * by2, 0.0)
        return share, (axes * more) @ axes.T / seconds**2

    def _blind(self, pose: OdometryPose) -> Array:
        """Directions (3, m) in the imu's axes that the scan does not hold."""
        variances, axes = _of_scan(pose)
        return axes[:, variances > self.weak_std**2]


def _of_scan(pose: OdometryPose) -> tuple[Array, Array]:
    """Variances (3,) [m²] with which a scan alone places the LiDAR, and along which axes (3, 3), in columns, of the
    imu."""
    information = pose.scan_information if pose.scan_information is not None else np.zeros((6, 6))
    variances, axes = np.linalg.eigh(np.linalg.inv(information + _NOTHING)[3:, 3:])
    return variances, axes
