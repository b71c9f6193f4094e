"""How far off the way from keyframe to keyframe is, such that a chain of them adds up honestly."""

from __future__ import annotations

import numpy as np

from localize.odometry import OdometryPose
from localize.settings import GraphSettings
from localize.state import VELOCITY
from semmap.geometry import Array

_NOTHING = 1e-3 * np.eye(6)
"""What is known where a scan says nothing, so that its information has an inverse."""


class LinkCovariances:
    """Covariances of the poses relative to the last keyframe.

    The filter's own is right for one link, but a graph takes links for independent. Where scans hold the velocity one
    link's error in position tends to be the next few ones' as well: `GraphSettings.link_correlation`. Where a scan is
    blind, along a smooth drift, the velocity's error stays what it is for as long as that lasts, and so the whole way's
    error is the sum of the links' and not the root of the sum of their squares.
    """

    def __init__(self, settings: GraphSettings, weak_std: float) -> None:
        self.settings, self.weak_std = settings, weak_std
        self._drifted = np.zeros((3, 3))
        """Sum of the links' standard deviations along blind directions, as far as they are blind still, in odom [m]."""
        self._last_ns: int | None = None

    def of(self, pose: OdometryPose) -> Array:
        """Covariance (6, 6) of the way to ``pose``, rotation first, perturbed on the right."""
        s, R = self.settings, pose.T_odom_imu[:3, :3]
        drift = np.repeat([s.drift_rotation, s.drift_position], 3) ** 2
        stretch = np.repeat([1.0, np.sqrt(s.link_correlation)], 3)
        covariance: Array = pose.since_keyframe * np.outer(stretch, stretch) + np.diag(drift)
        for u, std in self._blind(pose):
            covariance[3:, 3:] += 2.0 * std * (u @ self._drifted @ u) * np.outer(R.T @ u, R.T @ u)
        return covariance

    def blind(self, pose: OdometryPose) -> bool:
        """Whether the scan leaves the place open in some direction."""
        return bool(self._blind(pose))

    def keyframe(self, pose: OdometryPose) -> None:
        """The way goes on from here."""
        blind = self._blind(pose)
        W = sum((np.outer(u, u) for u, _ in blind), np.zeros((3, 3)))
        self._drifted = W @ self._drifted @ W + sum((std * np.outer(u, u) for u, std in blind), np.zeros((3, 3)))
        self._last_ns = pose.stamp_ns

    def _blind(self, pose: OdometryPose) -> list[tuple[Array, float]]:
        """Directions (3,) in odom that the scan does not hold, and how far off the way since the keyframe is there."""
        R, P = pose.T_odom_imu[:3, :3], pose.covariance[VELOCITY, VELOCITY]
        since_s = 0.0 if self._last_ns is None else (pose.stamp_ns - self._last_ns) * 1e-9
        information = pose.scan_information if pose.scan_information is not None else np.zeros((6, 6))
        variances, axes = np.linalg.eigh(np.linalg.inv(information + _NOTHING)[3:, 3:])
        stretch = np.sqrt(self.settings.link_correlation) * since_s
        blind = [R @ axis for axis in axes[:, variances > self.weak_std**2].T]
        return [(u, float(stretch * np.sqrt(u @ P @ u))) for u in blind]
