"""The navigation state and the layout of its error (paper 000 Eq. 2, with the last keyframe's pose beside it)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import hypot

import numpy as np

from semmap.geometry import Array, inverse, se3, so3_exp, so3_log

ROTATION = slice(0, 3)
POSITION = slice(3, 6)
VELOCITY = slice(6, 9)
GYRO_BIAS = slice(9, 12)
ACCEL_BIAS = slice(12, 15)
GRAVITY = slice(15, 18)
LIDAR = slice(18, 24)
TAG = slice(24, 30)
WHEEL = slice(30, 36)
CLONE = slice(36, 42)
MAP = slice(42, 48)
SCALE = slice(48, 49)
ERROR_DIM = 49
"""Of a state that has no tail. All columns up to here are always there; what is not estimated has no covariance."""
ODOM = slice(49, 55)
RANGE_SCALE = slice(55, 56)
CLOCK = slice(56, 57)
BIASES_FROM = 57
"""The tail: where odom lies in the map, once that is known, the ranges' scale, the total station's clock, and a bias
for each anchor heard."""
_POSES = (slice(0, 6), LIDAR, TAG, WHEEL, CLONE)
"""36 as in paper 000; 6 of the last keyframe's pose, whose correlation with the present gives the relative pose
covariance between keyframes; 6 of the local map, which lies as wrong as the poses it was built from; and the wheel's
scale."""


@dataclass(slots=True)
class NavState:
    """What the filter estimates. Poses err by ``[θ, δp]`` with ``R Exp(θ)``, ``p + δp``; extrinsics are (4, 4).

    R, p, v : attitude, position [m] and velocity [m/s] of the imu in odom.
    gyro_bias [rad/s], accel_bias [m/s²], g : gravity in odom [m/s²].
    T_odom_map : where the local map lies, errs by ``[φ, t]``: turned by ``Exp(φ)`` about ``map_centre`` (3,), a place
    of the map near the robot, told in odom, and moved by t; it moves along.
    wheel_scale : true speed over that of the wheel.
    T_map_odom : where odom lies in the map, or None while nobody knows; errs like ``T_odom_map``, turned about
    ``odom_centre`` (3,), a place of odom near the robot, told in the map; it moves along.
    range_scale : UWB distances as read over true ones.
    clock_offset : to be added to the total station's stamps, beside what the rig says [s].
    anchors, range_biases : ids of the UWB anchors heard, and what each reads too long (n,) [m].
    """

    R: Array
    p: Array
    v: Array
    gyro_bias: Array
    accel_bias: Array
    g: Array
    T_imu_lidar: Array
    T_imu_tag: Array
    T_imu_wheel: Array
    T_odom_clone: Array
    T_odom_map: Array
    map_centre: Array
    wheel_scale: float = 1.0
    T_map_odom: Array | None = None
    odom_centre: Array = field(default_factory=lambda: np.zeros(3))
    range_scale: float = 1.0
    clock_offset: float = 0.0
    anchors: tuple[int, ...] = ()
    range_biases: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def dim(self) -> int:
        """Columns of the error: `ERROR_DIM` and the tail."""
        return ERROR_DIM if self.T_map_odom is None else BIASES_FROM + len(self.anchors)

    def bias_of(self, anchor: int) -> float:
        """What an anchor reads too long [m]; zero where it has no bias."""
        return float(self.range_biases[self.anchors.index(anchor)]) if anchor in self.anchors else 0.0

    @property
    def T_odom_imu(self) -> Array:
        """Pose (4, 4) of the imu."""
        return se3(self.R, self.p)

    def copy(self) -> NavState:
        """A state apart from this one. Its transforms are shared: they are replaced, never changed in place."""
        own = ("R", "p", "v", "gyro_bias", "accel_bias", "g", "range_biases")
        return replace(self, **{name: getattr(self, name).copy() for name in own})

    def boxplus(self, delta: Array) -> NavState:
        """The state moved by an error (dim,); gravity keeps its length, which is known (PAPERS: 000)."""
        g = self.g + delta[GRAVITY]
        return NavState(
            R=self.R @ so3_exp(delta[ROTATION]),
            p=self.p + delta[POSITION],
            v=self.v + delta[VELOCITY],
            gyro_bias=self.gyro_bias + delta[GYRO_BIAS],
            accel_bias=self.accel_bias + delta[ACCEL_BIAS],
            g=g * (hypot(*self.g) / hypot(*g)),
            T_imu_lidar=_pose_plus(self.T_imu_lidar, delta[LIDAR]),
            T_imu_tag=_pose_plus(self.T_imu_tag, delta[TAG]),
            T_imu_wheel=_pose_plus(self.T_imu_wheel, delta[WHEEL]),
            T_odom_clone=_pose_plus(self.T_odom_clone, delta[CLONE]),
            T_odom_map=_moved_about(self.map_centre, delta[MAP]) @ self.T_odom_map,
            map_centre=self.map_centre + delta[MAP][3:],
            wheel_scale=self.wheel_scale + float(delta[SCALE][0]),
            T_map_odom=None
            if self.T_map_odom is None
            else _moved_about(self.odom_centre, delta[ODOM]) @ self.T_map_odom,
            odom_centre=self.odom_centre + (delta[ODOM][3:] if self.T_map_odom is not None else 0.0),
            range_scale=self.range_scale + (float(delta[RANGE_SCALE][0]) if self.T_map_odom is not None else 0.0),
            clock_offset=self.clock_offset + (float(delta[CLOCK][0]) if self.T_map_odom is not None else 0.0),
            anchors=self.anchors,
            range_biases=self.range_biases + delta[BIASES_FROM:],
        )

    def boxminus(self, other: NavState) -> Array:
        """The error (dim,) that takes ``other`` to this state: ``other.boxplus(self.boxminus(other)) = self``.

        Both have the same tail.
        """
        delta = np.zeros(self.dim)
        for pose, T, T_other in zip(_POSES, self._poses(), other._poses(), strict=True):
            if T is not T_other:
                delta[pose.start : pose.start + 3] = so3_log(T_other[:3, :3].T @ T[:3, :3])
                delta[pose.start + 3 : pose.stop] = T[:3, 3] - T_other[:3, 3]
        delta[VELOCITY] = self.v - other.v
        delta[GYRO_BIAS] = self.gyro_bias - other.gyro_bias
        delta[ACCEL_BIAS] = self.accel_bias - other.accel_bias
        delta[GRAVITY] = self.g - other.g
        delta[MAP] = _move_about(other.map_centre, self.T_odom_map @ inverse(other.T_odom_map))
        delta[SCALE] = self.wheel_scale - other.wheel_scale
        if self.T_map_odom is not None and other.T_map_odom is not None:
            delta[ODOM] = _move_about(other.odom_centre, self.T_map_odom @ inverse(other.T_map_odom))
            delta[RANGE_SCALE] = self.range_scale - other.range_scale
            delta[CLOCK] = self.clock_offset - other.clock_offset
            delta[BIASES_FROM:] = self.range_biases - other.range_biases
        return delta

    def _poses(self) -> tuple[Array, ...]:
        """All poses (4, 4), in the order of `_POSES`."""
        return self.T_odom_imu, self.T_imu_lidar, self.T_imu_tag, self.T_imu_wheel, self.T_odom_clone


def _moved_about(centre: Array, delta: Array) -> Array:
    """Transform (4, 4) that turns by ``delta[:3]`` about ``centre`` and moves by ``delta[3:]``."""
    R = so3_exp(delta[:3])
    return se3(R, centre - R @ centre + delta[3:])


def _move_about(centre: Array, moved: Array) -> Array:
    """The error (6,) with which `_moved_about` makes the transform ``moved`` (4, 4)."""
    return np.concatenate([so3_log(moved[:3, :3]), moved[:3, :3] @ centre + moved[:3, 3] - centre])


def _pose_plus(T: Array, delta: Array) -> Array:
    """``T`` itself where nothing moves it: mountings that are known exactly."""
    if not any(delta.tolist()):
        return T
    return se3(T[:3, :3] @ so3_exp(delta[:3]), T[:3, 3] + delta[3:])
