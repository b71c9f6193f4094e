"""UWB to the filter: distances to anchors, and positions found from them (paper 000 Eq. 5 to 9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localize.filter import Information, information
from localize.state import BIASES_FROM, GRAVITY, ODOM, POSITION, RANGE_SCALE, ROTATION, TAG, NavState
from semmap.geometry import Array, skew

_TAG_POSITION = slice(TAG.start + 3, TAG.stop)
_COLUMNS: NDArray[np.int64] = np.r_[ROTATION, POSITION, _TAG_POSITION, ODOM]
_RANGE_COLUMNS: NDArray[np.int64] = np.r_[_COLUMNS, RANGE_SCALE]
_NEAREST_M = 1e-3
"""Nearer than this to the anchor a range has no direction."""


@dataclass(frozen=True, slots=True)
class TagRange:
    """``r = d̂ - s |p_f - p_U| - b`` with the tag's place ``p_U`` (paper 000 Eq. 8, 9), a scale and a bias.

    The paper has neither of the two. Real radios do: the anchor reads too long by ``b``, and all of them by a share.

    anchor : id; where the state has no bias for it, the bias is zero.
    p_map : (3,) of the anchor. distance : measured [m]. std : [m].
    """

    anchor: int
    p_map: Array
    distance: float
    std: float

    def residual(self, state: NavState) -> Array:
        """Residual (1,) [m]."""
        bias = state.bias_of(self.anchor)
        return np.array([self.distance - state.range_scale * self._computed(state) - bias])

    def _computed(self, state: NavState) -> float:
        return max(float(np.linalg.norm(tag_in_map(state) - self.p_map)), _NEAREST_M)

    def jacobian(self, state: NavState) -> Array:
        """Jacobian (1, k) of the residual by `columns`."""
        distance = self._computed(state)
        direction = (tag_in_map(state) - self.p_map) / distance
        H = np.append(-state.range_scale * direction @ _tag_jacobian(state), -distance)
        return np.append(H, -1.0)[None] if self.anchor in state.anchors else H[None]

    def columns(self, state: NavState) -> NDArray[np.int64]:
        """Rotation, position, the tag's place on the robot, that of odom, the scale; and the bias, if there is one."""
        own = [BIASES_FROM + state.anchors.index(self.anchor)] if self.anchor in state.anchors else []
        return np.concatenate([_RANGE_COLUMNS, np.array(own, np.int64)])

    def linearize(self, state: NavState) -> Information:
        covariance = np.array([[self.std**2]])
        return information(self.residual(state), self.jacobian(state), covariance, self.columns(state))

    def predicted_variance(self, state: NavState, P: Array) -> float:
        """Variance [m²] that the residual has from the state alone."""
        H, columns = self.jacobian(state)[0], self.columns(state)
        return float(H @ P[np.ix_(columns, columns)] @ H)

    def bent_variance(self, state: NavState, P: Array) -> float:
        """Variance [m²] of what a straight line leaves out: near an anchor, spheres are not planes.

        ``½ tr (∇²d P ∇²d P)`` with the tag's covariance, as filters of second order add to the noise.
        """
        J, away = _tag_jacobian(state), tag_in_map(state) - self.p_map
        distance = self._computed(state)
        bent = (np.eye(3) - np.outer(away, away) / distance**2) / distance
        product = bent @ J @ P[np.ix_(_COLUMNS, _COLUMNS)] @ J.T
        return float(0.5 * np.trace(product @ product))


@dataclass(frozen=True, slots=True)
class TagPosition:
    """``r = p̂_U - p_U``, the tag's place (3,) in the map as something else found it (paper 000 Eq. 5, 6).

    covariance : (3, 3) [m²].
    """

    p_map: Array
    covariance: Array

    def residual(self, state: NavState) -> Array:
        """Residual (3,) [m]."""
        return self.p_map - tag_in_map(state)

    def jacobian(self, state: NavState) -> Array:
        """Jacobian (3, 15) of the residual by rotation, position, the tag's place, and that of odom in the map."""
        return -_tag_jacobian(state)

    def linearize(self, state: NavState) -> Information:
        return information(self.residual(state), self.jacobian(state), self.covariance, _COLUMNS)


@dataclass(frozen=True, slots=True)
class Vertical:
    """Gravity points down in the map: what ``T_map_odom`` leans by, gravity leans by in odom, the other way round.

    std : of the vertical [rad].
    """

    std: float

    def residual(self, state: NavState) -> Array:
        """Residual (2,) [rad]: x and y of gravity in the map."""
        assert state.T_map_odom is not None
        down: Array = state.T_map_odom[:2, :3] @ state.g / np.linalg.norm(state.g)
        return -down

    def jacobian(self, state: NavState) -> Array:
        """Jacobian (2, 9) of the residual by gravity, and by where odom lies."""
        assert state.T_map_odom is not None
        R, length = state.T_map_odom[:3, :3], np.linalg.norm(state.g)
        down = state.g / length
        H = np.zeros((2, 9))
        H[:, :3] = -(R @ (np.eye(3) - np.outer(down, down)) / length)[:2]
        H[:, 3:6] = skew(R @ down)[:2]
        return H

    def linearize(self, state: NavState) -> Information:
        columns = np.r_[GRAVITY, ODOM]
        return information(self.residual(state), self.jacobian(state), self.std**2 * np.eye(2), columns)


def tag_in_map(state: NavState) -> Array:
    """Where the tag is in the map (3,), paper 000 Eq. 8."""
    assert state.T_map_odom is not None
    p_odom = state.p + state.R @ state.T_imu_tag[:3, 3]
    p: Array = state.T_map_odom[:3, :3] @ p_odom + state.T_map_odom[:3, 3]
    return p


def _tag_jacobian(state: NavState) -> Array:
    """(3, 15) of `tag_in_map` by rotation, position, the tag's place, and that of odom in the map."""
    assert state.T_map_odom is not None
    R_map_odom = state.T_map_odom[:3, :3]
    R_map_imu = R_map_odom @ state.R
    J = np.empty((3, 15))
    J[:, :3] = -R_map_imu @ skew(state.T_imu_tag[:3, 3])
    J[:, 3:6] = R_map_odom
    J[:, 6:9] = R_map_imu
    J[:, 9:12] = -skew(tag_in_map(state) - state.odom_centre)
    J[:, 12:15] = np.eye(3)
    return J
