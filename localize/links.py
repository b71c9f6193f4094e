"""How far off the way from keyframe to keyframe is, such that a chain of them adds up honestly."""

from __future__ import annotations

import numpy as np

from localize.odometry import OdometryPose
from localize.settings import GraphSettings
from localize.state import POSITION
from semmap.geometry import Array

_NOTHING = 1e-3 * np.eye(6)
"""What is known where a scan says nothing, so that its information has an inverse."""


class LinkCovariances:
    """Covariances of the poses relative to the last keyframe.

    The filter's own is right for one link, but a graph takes links for independent. Where scans hold the velocity one
    link's error in position tends to be the next few ones' as well: `GraphSettings.link_correlation`. Where a scan is
    blind, along a smooth drift, the velocity's error stays what it is for as long as that lasts: there a link is as far
    off as the filter's place in odom comes to be off by more meanwhile, so that all of them together are as it is.
    """

    def __init__(self, settings: GraphSettings, weak_std: float) -> None:
        self.settings, self.weak_std = settings, weak_std
        self._last: Array | None = None
        """Covariance (3, 3) of the place of the last keyframe in odom."""

    def of(self, pose: OdometryPose) -> Array:
        """Covariance (6, 6) of the way to ``pose``, rotation first, perturbed on the right."""
        s, R = self.settings, pose.T_odom_imu[:3, :3]
        drift = np.repeat([s.drift_rotation, s.drift_position], 3) ** 2
        stretch = np.repeat([1.0, np.sqrt(s.link_correlation)], 3)
        covariance: Array = pose.since_keyframe * np.outer(stretch, stretch) + np.diag(drift)
        if self._last is not None:
            more = R.T @ (pose.covariance[POSITION, POSITION] - self._last) @ R
            for u in self._blind(pose).T:
                covariance[3:, 3:] += max(0.0, float(u @ (more - covariance[3:, 3:]) @ u)) * np.outer(u, u)
        return covariance

    def blind(self, pose: OdometryPose) -> bool:
        """Whether the scan leaves the place open in some direction."""
        return self._blind(pose).size > 0

    def keyframe(self, pose: OdometryPose) -> None:
        """The way goes on from here."""
        self._last = pose.covariance[POSITION, POSITION]

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
