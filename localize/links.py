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
_FORGOTTEN = 1e-3
"""A speed of which so little is left is another."""


@dataclass(frozen=True, slots=True)
class Slide:
    """How a way slides where scans are blind: by the speed of the way before, as much as is left of it, and its walk.

    The speed is ``left`` times a vector that walks from link to link.

    seconds : of the way. goes_on : whether the vector is that of the way before, but for its walk.
    walk, whole : covariances (3, 3), axes of odom, of what the vector changed by, and of the vector [m²/s²].
    alone : covariance (6, 6) of the way if the speed were known, perturbed on the right.
    """

    seconds: float
    goes_on: bool
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
        s, R = self.settings, pose.T_odom_imu[:3, :3]
        drift = np.repeat([s.drift_rotation, s.drift_position], 3) ** 2
        stretch = np.repeat([1.0, np.sqrt(s.link_correlation)], 3)
        covariance: Array = pose.since_keyframe * np.outer(stretch, stretch) + np.diag(drift)
        blind = self._blind(pose)
        if self._last is None or not blind.size:
            return Link(covariance)
        across = np.eye(6)
        across[3:, 3:] -= blind @ blind.T
        alone = across @ covariance @ across
        alone[3:, 3:] += s.drift_position**2 * blind @ blind.T
        more = R.T @ (pose.covariance[POSITION, POSITION] - self._last.covariance[POSITION, POSITION]) @ R
        for u in blind.T:
            covariance[3:, 3:] += max(0.0, float(u @ (more - covariance[3:, 3:]) @ u)) * np.outer(u, u)
        grows = np.einsum("im,ij,jm->m", blind, covariance[3:, 3:], blind)
        return Link(covariance, self._slide(pose, R @ blind, grows, alone))

    def _slide(self, pose: OdometryPose, axes: Array, grows: Array, alone: Array) -> Slide:
        """The slide by which the place's variance grows by ``grows`` (m,) along ``axes`` (3, m) of odom."""
        assert self._last is not None
        seconds = (pose.stamp_ns - self._last.stamp_ns) * 1e-9
        by = 2.0 * seconds * np.einsum("im,ij,jm->m", axes, self._slid[:3, 3:], axes)
        by2 = seconds**2 * np.einsum("im,ij,jm->m", axes, self._slid[3:, 3:], axes)
        # as much of the speed goes on as does not make the place grow faster
        kept = 2.0 * grows / (by + np.sqrt(by**2 + 4.0 * by2 * grows) + 1e-30)
        share = float(min(1.0, kept.min())) if self._slid.any() else 0.0
        left = self._left * share
        goes_on = left > _FORGOTTEN
        if not goes_on:
            share, left = 0.0, 1.0
        walk = (axes * np.maximum(grows - share * by - share**2 * by2, 0.0)) @ axes.T / seconds**2
        whole = (share**2 * self._slid[3:, 3:] + walk) / left**2
        return Slide(seconds, goes_on, left, walk / left**2, whole, alone)

    def blind(self, pose: OdometryPose) -> bool:
        """Whether the scan leaves the place open in some direction."""
        return self._blind(pose).size > 0

    def keyframe(self, pose: OdometryPose) -> None:
        """The way goes on from here."""
        slide = self.of(pose).slide
        if slide is None:
            self._slid, self._left = np.zeros((6, 6)), 1.0
        else:
            share = slide.left / self._left if slide.goes_on else 0.0
            speed = np.diag(np.repeat([1.0, share], 3)) @ self._slid @ np.diag(np.repeat([1.0, share], 3))
            speed[3:, 3:] += slide.left**2 * slide.walk
            F = np.eye(6)
            F[:3, 3:] = slide.seconds * np.eye(3)
            self._slid, self._left = F @ speed @ F.T, slide.left
        self._last = pose

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
