"""How far off the way from keyframe to keyframe is, such that a chain of them adds up honestly."""

from __future__ import annotations

import numpy as np

from localize.odometry import OdometryPose
from localize.settings import GraphSettings
from localize.state import VELOCITY
from semmap.geometry import Array

_NOTHING = 1e-3 * np.eye(6)
"""What is known where a scan says nothing, so that its information has an inverse."""
_SEES = 0.5
"""A scan that places the LiDAR by so much better than a weak one shows how fast the robot is."""
_SETTLES_M = 3.0
"""Way behind a blind drift, once scans see rock, on which the velocity's error falls to a third [m]."""


class LinkCovariances:
    """Covariances of the poses relative to the last keyframe.

    The filter's own is right for one link, but a graph takes links for independent. Where scans hold the velocity one
    link's error in position tends to be the next few ones' as well: `GraphSettings.link_correlation`. Where a scan is
    blind, along a smooth drift, the velocity's error stays what it is for as long as that lasts, and so the whole way's
    error is the sum of the links' and not the root of the sum of their squares.

    Where rock comes into sight again, the first scans lie in the local map as the velocity's error put them, and the
    filter believes them too soon: what it was off by is gone only after some metres.
    """

    def __init__(self, settings: GraphSettings, weak_std: float) -> None:
        self.settings, self.weak_std = settings, weak_std
        self._drifted = np.zeros((3, 3))
        """Sum of the links' standard deviations along blind directions, as far as they are blind still, in odom [m]."""
        self._unsettled = np.zeros((3, 3))
        """Standard deviation of the velocity along directions that were blind, as far as it may still be off [m/s]."""
        self._last_ns: int | None = None

    def of(self, pose: OdometryPose) -> Array:
        """Covariance (6, 6) of the way to ``pose``, rotation first, perturbed on the right."""
        s, R = self.settings, pose.T_odom_imu[:3, :3]
        drift = np.repeat([s.drift_rotation, s.drift_position], 3) ** 2
        stretch = np.repeat([1.0, np.sqrt(s.link_correlation)], 3)
        covariance: Array = pose.since_keyframe * np.outer(stretch, stretch) + np.diag(drift)
        for u, std in self._blind(pose):
            covariance[3:, 3:] += 2.0 * std * (u @ self._drifted @ u) * np.outer(R.T @ u, R.T @ u)
        along, std = self._settling(pose)
        covariance[3:, 3:] += std**2 * np.outer(R.T @ along, R.T @ along)
        return covariance

    def settling_m(self, pose: OdometryPose) -> float:
        """Standard deviation of the way to ``pose`` beyond what the filter says, behind a blind drift [m]."""
        return self._settling(pose)[1]

    def _settling(self, pose: OdometryPose) -> tuple[Array, float]:
        """Direction (3,) in odom of that, and how much it is."""
        values, vectors = np.linalg.eigh(self._unsettled)
        along = vectors[:, -1]
        told = np.sqrt(along @ pose.covariance[VELOCITY, VELOCITY] @ along)
        return along, self._since_s(pose) * max(0.0, float(values[-1] - told))

    def blind(self, pose: OdometryPose) -> bool:
        """Whether the scan leaves the place open in some direction."""
        return bool(self._blind(pose))

    def keyframe(self, pose: OdometryPose) -> None:
        """The way goes on from here."""
        blind = self._blind(pose)
        W = sum((np.outer(u, u) for u, _ in blind), np.zeros((3, 3)))
        self._drifted = W @ self._drifted @ W + sum((std * np.outer(u, u) for u, std in blind), np.zeros((3, 3)))
        self._settle(pose, blind)
        self._last_ns = pose.stamp_ns

    def _settle(self, pose: OdometryPose, blind: list[tuple[Array, float]]) -> None:
        """The velocity's error falls with the way where scans see rock, and is what the filter says where none do."""
        R = pose.T_odom_imu[:3, :3]
        variances, axes = _of_scan(pose)
        sees = np.sqrt(variances) < _SEES * self.weak_std
        falls = np.exp(-0.5 * np.linalg.norm(pose.T_keyframe_imu[:3, 3]) / _SETTLES_M)
        D = (R @ axes) @ np.diag(np.where(sees, falls, 1.0)) @ (R @ axes).T
        self._unsettled = D @ self._unsettled @ D
        for u, _ in blind:
            more = float(np.sqrt(u @ pose.covariance[VELOCITY, VELOCITY] @ u) - u @ self._unsettled @ u)
            self._unsettled += max(0.0, more) * np.outer(u, u)

    def _blind(self, pose: OdometryPose) -> list[tuple[Array, float]]:
        """Directions (3,) in odom that the scan does not hold, and how far off the way since the keyframe is there."""
        R, P = pose.T_odom_imu[:3, :3], pose.covariance[VELOCITY, VELOCITY]
        variances, axes = _of_scan(pose)
        stretch = np.sqrt(self.settings.link_correlation) * self._since_s(pose)
        blind = [R @ axis for axis in axes[:, variances > self.weak_std**2].T]
        return [(u, float(stretch * np.sqrt(u @ P @ u))) for u in blind]

    def _since_s(self, pose: OdometryPose) -> float:
        return 0.0 if self._last_ns is None else (pose.stamp_ns - self._last_ns) * 1e-9


def _of_scan(pose: OdometryPose) -> tuple[Array, Array]:
    """Variances (3,) [m²] with which a scan alone places the LiDAR, and along which axes (3, 3), in columns, of the
    imu."""
    information = pose.scan_information if pose.scan_information is not None else np.zeros((6, 6))
    variances, axes = np.linalg.eigh(np.linalg.inv(information + _NOTHING)[3:, 3:])
    return variances, axes
