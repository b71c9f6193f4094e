"""The pose factor graph of paper 004 section 3, in gtsam: keyframes, relative poses, and what pins them to the map."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from localize.settings import GraphSettings
from semmap.geometry import Array

_VAGUE_RAD, _VAGUE_M = 0.5, 30.0
_SHARED = 5.0
"""Keyframes share the error of the vertical: each counts as if it were so many times as large."""


@dataclass(frozen=True, slots=True)
class _RelativePose:
    """``T_a_b`` (4, 4) from keyframe index - 1 to keyframe index, with its covariance (6, 6)."""

    T_a_b: Array
    covariance: Array


class PoseGraph:
    """Keyframe poses ``T_map_imu`` given relative poses and pins; empty of pins it has no map frame and no estimate.

    All factors are gtsam's own: between factors (paper 004 Eq. 11), pose priors for verified intersections, position
    priors with a lever arm (Eq. 22) for the prism, ranges from a body-fixed point to an anchor for UWB.
    """

    def __init__(self, settings: GraphSettings) -> None:
        self.settings = settings
        self.pins = 0
        self._T_odom: list[Array] = []
        self._up_imu: list[Array] = []
        self._up_std: list[float] = []
        self._links: list[_RelativePose] = []
        self._isam: gtsam.ISAM2 | None = None
        self._new = gtsam.NonlinearFactorGraph()
        self._values = gtsam.Values()
        self._anchors: set[int] = set()
        self._estimate = gtsam.Values()

    @property
    def anchored(self) -> bool:
        """Whether the map frame is known."""
        return self._isam is not None

    def __len__(self) -> int:
        return len(self._T_odom)

    def add_keyframe(
        self, T_odom_imu: Array, up_odom: Array, T_before_imu: Array, covariance: Array, up_std: float = np.inf
    ) -> None:
        """The next keyframe: its pose, the direction against gravity, and its pose relative to the keyframe before.

        ``up_std`` [rad] is how well the direction is known.
        ``covariance`` (6, 6) is that of the relative pose; the first keyframe's is not used.
        """
        self._up_imu.append(T_odom_imu[:3, :3].T @ up_odom)
        self._up_std.append(min(self.settings.vertical_std, _SHARED * up_std))
        if self._T_odom:
            link = _RelativePose(T_before_imu, covariance)
            self._links.append(link)
            if self.anchored:
                before = self.pose(len(self._T_odom) - 1)
                self._T_odom.append(T_odom_imu)
                self._insert_link(len(self._links), before @ link.T_a_b)
                return
        self._T_odom.append(T_odom_imu)

    def anchor(self, T_map_odom: Array) -> None:
        """Give the keyframes so far their first place in the map; pins must follow before `solve`."""
        parameters = gtsam.ISAM2Params()
        parameters.relinearizeSkip = 1
        parameters.setRelinearizeThreshold(0.01)
        self._isam = gtsam.ISAM2(parameters)
        self._new, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._anchors.clear()
        self.pins = 0
        self._values.insert(_X(0), gtsam.Pose3(T_map_odom @ self._T_odom[0]))
        self._insert_vertical(0)
        # says next to nothing, but the first pins may leave a direction open, and the system must have a solution
        vague = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([_VAGUE_RAD, _VAGUE_M], 3))
        self._new.add(gtsam.PriorFactorPose3(_X(0), gtsam.Pose3(T_map_odom @ self._T_odom[0]), vague))
        for index in range(1, len(self._T_odom)):
            self._insert_link(index, T_map_odom @ self._T_odom[index])

    def _insert_link(self, index: int, T_map_imu: Array) -> None:
        link = self._links[index - 1]
        noise = gtsam.noiseModel.Gaussian.Covariance(link.covariance)
        self._new.add(gtsam.BetweenFactorPose3(_X(index - 1), _X(index), gtsam.Pose3(link.T_a_b), noise))
        self._values.insert(_X(index), gtsam.Pose3(T_map_imu))
        self._insert_vertical(index)

    def _insert_vertical(self, index: int) -> None:
        """Gravity as the filter knows it holds roll and pitch where pins are far, or are ranges only."""
        noise = gtsam.noiseModel.Isotropic.Sigma(2, self._up_std[index])
        up_imu, up_map = gtsam.Unit3(self._up_imu[index]), gtsam.Unit3(np.array([0.0, 0.0, 1.0]))
        self._new.add(gtsam.AttitudeFactorPose3(_X(index), up_map, noise, up_imu))

    def pin_pose(self, index: int, T_map_imu: Array, covariance: Array) -> None:
        """A verified intersection gives keyframe ``index`` its pose in the map (6, 6 covariance, rotation first)."""
        noise = self._robust(gtsam.noiseModel.Gaussian.Covariance(covariance))
        self._new.add(gtsam.PriorFactorPose3(_X(index), gtsam.Pose3(T_map_imu), noise))
        self.pins += 1

    def pin_heading(self, index: int, T_map_imu: Array, std: float) -> None:
        """The heading of keyframe ``index`` is that of ``T_map_imu``, but for ``std`` [rad]; all else is open."""
        R = T_map_imu[:3, :3]
        covariance = np.diag(np.repeat([_VAGUE_RAD**2, _VAGUE_M**2], 3))
        covariance[:3, :3] = R.T @ np.diag([_VAGUE_RAD**2, _VAGUE_RAD**2, std**2]) @ R
        self.pin_pose(index, T_map_imu, covariance)

    def pin_position(self, index: int, p_imu: Array, p_map: Array, covariance: Array) -> None:
        """Point ``p_imu`` of keyframe ``index`` is at ``p_map`` (paper 004 Eq. 22 with the point as lever arm)."""
        noise = self._robust(gtsam.noiseModel.Gaussian.Covariance(covariance))
        self._new.add(gtsam.GPSFactorArm(_X(index), p_map, p_imu, noise))
        self.pins += 1

    def pin_range(
        self, index: int, p_imu: Array, anchor: int, p_map_anchor: Array, distance: float, std: float
    ) -> None:
        """Point ``p_imu`` of keyframe ``index`` is ``distance`` from an anchor (paper 000 Eq. 9)."""
        if anchor not in self._anchors:
            self._anchors.add(anchor)
            surveyed = gtsam.noiseModel.Isotropic.Sigma(3, self.settings.anchor_std)
            self._new.add(gtsam.PriorFactorPoint3(_A(anchor), p_map_anchor, surveyed))
            self._values.insert(_A(anchor), p_map_anchor)
        noise = self._robust(gtsam.noiseModel.Isotropic.Sigma(1, std))
        T_imu_point = gtsam.Pose3(gtsam.Rot3(), p_imu)
        self._new.add(gtsam.RangeFactorWithTransform3D(_X(index), _A(anchor), distance, noise, T_imu_point))
        self.pins += 1

    def _robust(self, noise: gtsam.noiseModel.Base) -> gtsam.noiseModel.Base:
        loss = gtsam.noiseModel.mEstimator.Huber.Create(self.settings.huber_sigmas)
        return gtsam.noiseModel.Robust.Create(loss, noise)

    def solve(self, *, steps: int = 2) -> None:
        """Update the estimate with what came in since the last call."""
        assert self._isam is not None
        self._isam.update(self._new, self._values)
        self._new, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for _ in range(steps - 1):
            self._isam.update()
        self._estimate = self._isam.calculateEstimate()

    def pose(self, index: int) -> Array:
        """``T_map_imu`` (4, 4) of keyframe ``index``."""
        key = _X(index)
        values = self._values if self._values.exists(key) else self._estimate
        T: Array = values.atPose3(key).matrix()
        return T

    def covariance(self, index: int) -> Array:
        """Covariance (6, 6) of keyframe ``index``, rotation first, perturbed on the right, after `solve`."""
        assert self._isam is not None
        marginal: Array = self._isam.marginalCovariance(_X(index))
        return marginal

    def poses(self) -> Array:
        """All keyframes' ``T_map_imu`` (n, 4, 4)."""
        return np.array([self.pose(index) for index in range(len(self))])


def _X(index: int) -> int:
    key: int = gtsam.symbol("x", index)
    return key


def _A(anchor: int) -> int:
    key: int = gtsam.symbol("a", anchor)
    return key
