"""The pose factor graph of paper 004 section 3, in gtsam: keyframes, relative poses, and what pins them to the map."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from localize.links import Slide
from localize.settings import GraphSettings
from semmap.geometry import Array, adjoint, inverse, skew

_VAGUE_RAD, _VAGUE_M = 0.5, 30.0
_ANY_TURN_RAD = 10.0
_EXACT = 1e-4
"""Of what is so by definition [rad, m]."""
_SHARED = 5.0
"""Keyframes share the error of the vertical: from this number on each counts as if it were so many times as large,
those before by their number, so that the first has it whole. Else fixes along the first metre would tilt the track."""


@dataclass(frozen=True, slots=True)
class _RelativePose:
    """``T_a_b`` (4, 4) from keyframe index - 1 to keyframe index, with its covariance (6, 6)."""

    T_a_b: Array
    covariance: Array
    slide: Slide | None = None


class PoseGraph:
    """Keyframe poses ``T_map_imu`` given relative poses and pins; empty of pins it has no map frame and no estimate.

    All factors are gtsam's own: between factors (paper 004 Eq. 11), intersections as variables with their survey as
    prior, seen from keyframes as poses or as points (Eq. 21, 22), positions with a lever arm for the prism, ranges from
    a body-fixed point to an anchor for UWB.
    """

    def __init__(self, settings: GraphSettings, *, range_bias_std: float = 0.0) -> None:
        """``range_bias_std``: what anchors may read too long [m]; to the graph they themselves lie off by it."""
        self.settings = settings
        self._anchor_std = float(np.hypot(settings.anchor_std, range_bias_std))
        self.pins = 0
        self._T_odom: list[Array] = []
        self._up_imu: list[Array] = []
        self._up_std: list[float] = []
        self._links: list[_RelativePose] = []
        self._way: list[Array] = []
        """Covariance (6, 6) of the way from the first keyframe to each, carried to odom's origin."""
        self._isam: gtsam.ISAM2 | None = None
        self._new = gtsam.NonlinearFactorGraph()
        self._values = gtsam.Values()
        self._anchors: set[int] = set()
        self._intersections: set[int] = set()

    @property
    def anchored(self) -> bool:
        """Whether the map frame is known."""
        return self._isam is not None

    def __len__(self) -> int:
        return len(self._T_odom)

    def add_keyframe(
        self, T_odom_imu: Array, up_odom: Array, T_before_imu: Array, covariance: Array, up_std: float = np.inf,
        slide: Slide | None = None,
    ) -> None:  # fmt: skip
        """The next keyframe: its pose, the direction against gravity, and its pose relative to the keyframe before.

        ``up_std`` [rad] is how well the direction is known.
        ``covariance`` (6, 6) is that of the relative pose; the first keyframe's is not used.
        ``slide``: that, where scans are blind, links share.
        """
        self._up_imu.append(T_odom_imu[:3, :3].T @ up_odom)
        shared = min(_SHARED, len(self._up_std) + 1.0)
        self._up_std.append(min(self.settings.vertical_std, shared * up_std))
        if self._T_odom:
            link = _RelativePose(T_before_imu, covariance, slide)
            self._links.append(link)
            carry = adjoint(T_odom_imu)
            self._way.append(self._way[-1] + carry @ covariance @ carry.T)
            if self.anchored:
                before = self.pose(len(self._T_odom) - 1)
                self._T_odom.append(T_odom_imu)
                self._insert_link(len(self._links), before @ link.T_a_b)
                return
        else:
            self._way.append(np.zeros((6, 6)))
        self._T_odom.append(T_odom_imu)

    def anchor(self, T_map_odom: Array, *, known: bool = False) -> None:
        """Give the keyframes so far their first place in the map; pins must follow before `solve`.

        ``known``: it is the place itself, but for what gravity says of roll and pitch; no pins are needed.
        """
        parameters = gtsam.ISAM2Params()
        parameters.relinearizeSkip = 1
        # links along blind drifts are off by metres and turned by hundredths of a degree: too much for Cholesky
        parameters.setFactorization("QR")
        parameters.setRelinearizeThreshold(0.01)
        self._isam = gtsam.ISAM2(parameters)
        self._new, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._anchors.clear()
        self._intersections.clear()
        self.pins = 0
        self._values.insert(_X(0), gtsam.Pose3(T_map_odom @ self._T_odom[0]))
        self._insert_vertical(0)
        # says next to nothing, but the first pins may leave a direction open, and the system must have a solution
        prior: gtsam.noiseModel.Base = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([_VAGUE_RAD, _VAGUE_M], 3))
        if known:
            R = self._T_odom[0][:3, :3].T @ T_map_odom[:3, :3].T
            covariance = np.eye(6) * _EXACT**2
            covariance[:3, :3] = R @ np.diag([_VAGUE_RAD, _VAGUE_RAD, _EXACT]) ** 2 @ R.T
            prior = gtsam.noiseModel.Gaussian.Covariance(covariance)
        self._new.add(gtsam.PriorFactorPose3(_X(0), gtsam.Pose3(T_map_odom @ self._T_odom[0]), prior))
        for index in range(1, len(self._T_odom)):
            self._insert_link(index, T_map_odom @ self._T_odom[index])

    def unanchor(self) -> None:
        """Take back every pin and the map frame."""
        self._isam = None
        self.pins = 0

    def _insert_link(self, index: int, T_map_imu: Array) -> None:
        link = self._links[index - 1]
        if link.slide is None:
            noise = gtsam.noiseModel.Gaussian.Covariance(link.covariance)
            self._new.add(gtsam.BetweenFactorPose3(_X(index - 1), _X(index), gtsam.Pose3(link.T_a_b), noise))
        else:
            self._insert_slide(index, link.T_a_b, link.slide, T_map_imu)
        self._values.insert(_X(index), gtsam.Pose3(T_map_imu))
        self._insert_vertical(index)

    def _insert_slide(self, index: int, T_a_b: Array, slide: Slide, T_map_imu: Array) -> None:
        """A link that slides by a speed, which is a variable and goes on from link to link."""
        R_map_odom = T_map_imu[:3, :3] @ self._T_odom[index][:3, :3].T
        goes_on = index > 1 and self._links[index - 2].slide is not None
        walk = R_map_odom @ (slide.walk if goes_on else slide.whole) @ R_map_odom.T + _EXACT**2 * np.eye(3)
        noise = gtsam.noiseModel.Gaussian.Covariance(walk)
        if goes_on:
            self._new.add(gtsam.BetweenFactorPoint3(_U(index - 1), _U(index), np.zeros(3), noise))
        else:
            self._new.add(gtsam.PriorFactorPoint3(_U(index), np.zeros(3), noise))
        self._values.insert(_U(index), np.zeros(3))
        self._new.add(slid(_X(index - 1), _X(index), _U(index), T_a_b, slide.left * slide.seconds, slide.alone))

    def _insert_vertical(self, index: int) -> None:
        """Gravity as the filter knows it holds roll and pitch where pins are far, or are ranges only."""
        noise = gtsam.noiseModel.Isotropic.Sigma(2, self._up_std[index])
        up_imu, up_map = gtsam.Unit3(self._up_imu[index]), gtsam.Unit3(np.array([0.0, 0.0, 1.0]))
        self._new.add(gtsam.AttitudeFactorPose3(_X(index), up_map, noise, up_imu))

    def pin_intersection(
        self, index: int, intersection: int, T_map_intersection: Array, T_map_imu: Array, covariance: Array
    ) -> None:
        """Keyframe ``index`` saw an intersection of the map, which says that it is at ``T_map_imu`` (6, 6 covariance).

        The surveyed ``T_map_intersection`` (4, 4, axes of the map) is the prior of a variable: it errs once, however
        often it is seen. ICP tells the whole pose, and the keyframe is tied to the intersection by it; in the paper's
        mode only by where the intersection is in the keyframe (paper 004 Eq. 21, 22).
        """
        T_imu_intersection = inverse(T_map_imu) @ T_map_intersection
        # the error of the factor is that of the keyframe, seen from the intersection
        back = adjoint(inverse(T_imu_intersection))
        covariance = back @ covariance @ back.T
        if self.settings.intersections == "points":
            covariance[:3], covariance[:, :3] = 0.0, 0.0
            covariance[:3, :3] = _ANY_TURN_RAD**2 * np.eye(3)
        key = self._insert_intersection(intersection, T_map_intersection)
        noise = self._robust(gtsam.noiseModel.Gaussian.Covariance(covariance))
        self._new.add(gtsam.BetweenFactorPose3(_X(index), key, gtsam.Pose3(T_imu_intersection), noise))
        self.pins += 1

    def _insert_intersection(self, intersection: int, T_map_intersection: Array) -> int:
        """The key of an intersection's variable; the first time it is made, with its survey as a prior."""
        key: int = gtsam.symbol("i", intersection)
        if intersection not in self._intersections:
            self._intersections.add(intersection)
            s = self.settings
            surveyed = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([s.survey_rotation, s.survey_position], 3))
            T = gtsam.Pose3(T_map_intersection)
            self._new.add(gtsam.PriorFactorPose3(key, T, surveyed))
            self._values.insert(key, T)
        return key

    def add_intersection(self, intersection: int, index: int, T_imu_intersection: Array, covariance: Array) -> None:
        """A new intersection, seen first by keyframe ``index``; its place errs as that view (6, 6) does."""
        key: int = gtsam.symbol("i", intersection)
        self._intersections.add(intersection)
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        self._new.add(gtsam.BetweenFactorPose3(_X(index), key, gtsam.Pose3(T_imu_intersection), noise))
        self._values.insert(key, gtsam.Pose3(self.pose(index) @ T_imu_intersection))

    def pin_heading(self, index: int, T_map_imu: Array, std: float) -> None:
        """The heading of keyframe ``index`` is that of ``T_map_imu``, but for ``std`` [rad]; all else is open."""
        R = T_map_imu[:3, :3]
        covariance = np.diag(np.repeat([_VAGUE_RAD**2, _VAGUE_M**2], 3))
        covariance[:3, :3] = R.T @ np.diag([_VAGUE_RAD**2, _VAGUE_RAD**2, std**2]) @ R
        noise = self._robust(gtsam.noiseModel.Gaussian.Covariance(covariance))
        self._new.add(gtsam.PriorFactorPose3(_X(index), gtsam.Pose3(T_map_imu), noise))
        self.pins += 1

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
            surveyed = gtsam.noiseModel.Isotropic.Sigma(3, self._anchor_std)
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

    def pose(self, index: int) -> Array:
        """``T_map_imu`` (4, 4) of keyframe ``index``."""
        return self._pose(_X(index))

    def intersection(self, intersection: int) -> Array:
        """``T_map_intersection`` (4, 4) of one that pins a keyframe."""
        return self._pose(gtsam.symbol("i", intersection))

    def _pose(self, key: int) -> Array:
        assert self._isam is not None
        pose = self._values.atPose3(key) if self._values.exists(key) else self._isam.calculateEstimatePose3(key)
        T: Array = pose.matrix()
        return T

    def intersection_covariance(self, intersection: int) -> Array:
        """Covariance (6, 6) of `intersection`, likewise."""
        assert self._isam is not None
        marginal: Array = self._isam.marginalCovariance(gtsam.symbol("i", intersection))
        return marginal

    def way_covariance(self, a: int, b: int) -> Array:
        """Covariance (6, 6) of keyframe ``b`` relative to keyframe ``a`` < b by the odometry alone, perturbed at b."""
        back = adjoint(inverse(self._T_odom[b]))
        covariance: Array = back @ (self._way[b] - self._way[a]) @ back.T
        return covariance

    def covariance(self, index: int) -> Array:
        """Covariance (6, 6) of keyframe ``index``, rotation first, perturbed on the right, after `solve`."""
        assert self._isam is not None
        marginal: Array = self._isam.marginalCovariance(_X(index))
        return marginal

    def poses(self) -> Array:
        """All keyframes' ``T_map_imu`` (n, 4, 4)."""
        assert self._isam is not None
        if self._new.size():
            self.solve()
        estimate = self._isam.calculateEstimate()
        return np.array([estimate.atPose3(_X(index)).matrix() for index in range(len(self))])

    def link(self, index: int) -> tuple[Array, Array]:
        """The relative pose (4, 4) of keyframe ``index`` to the one before, and its covariance (6, 6)."""
        link = self._links[index - 1]
        return link.T_a_b, link.covariance

    def split(self, index: int) -> PoseGraph:
        """A graph of its own of the keyframes from ``index`` on, without a place in the map."""
        rest = PoseGraph(self.settings)
        rest._anchor_std = self._anchor_std
        rest._T_odom, rest._up_imu, rest._links = self._T_odom[index:], self._up_imu[index:], self._links[index:]
        rest._up_std, rest._way = self._up_std[index:], self._way[index:]
        return rest


def slid(a: int, b: int, u: int, T_a_b: Array, seconds: float, covariance: Array) -> gtsam.CustomFactor:
    """From pose ``a`` to pose ``b`` it is ``T_a_b`` (4, 4) and, in b's axes, ``seconds`` times the speed ``u``.

    covariance : (6, 6) of the way besides, rotation first, perturbed at b.
    """
    T_b_a = gtsam.Pose3(T_a_b).inverse()

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, H: list[Array] | None) -> Array:
        T_map_b = values.atPose3(b)
        way = values.atPose3(a).between(T_map_b)
        beyond = T_b_a.compose(way)
        R_b_map = T_map_b.rotation().matrix().T
        went = beyond.rotation().matrix().T @ beyond.translation()
        off = np.concatenate([gtsam.Rot3.Logmap(beyond.rotation()), went - seconds * (R_b_map @ values.atPoint3(u))])
        if H is not None:
            # the turn that is left is small: the logarithm's own derivative is one
            H[0], H[1], H[2] = np.eye(6), np.eye(6), np.zeros((6, 3))
            H[0][3:, :3], H[1][3:, :3] = skew(went), skew(off[3:])
            H[0] = -H[0] @ way.inverse().AdjointMap()
            H[2][3:] = -seconds * R_b_map
        return off

    return gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(covariance), [a, b, u], error)


def _X(index: int) -> int:
    key: int = gtsam.symbol("x", index)
    return key


def _U(index: int) -> int:
    key: int = gtsam.symbol("u", index)
    return key


def _A(anchor: int) -> int:
    key: int = gtsam.symbol("a", anchor)
    return key
