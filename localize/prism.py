"""The total station to the filter: where its prism is (paper 002 Eq. 16 to 26, in the filter of paper 000).

The INS/total-station filter of the paper and its LiDAR filter are one here: IMU and fixes carry the state to the end
of a scan, which starts its update there and is deskewed on the way, and goes on by them alone where the LiDAR sees
nothing. So no measurement enters two filters.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from localize.earth import Earth
from localize.filter import ErrorStateFilter, Information, information
from localize.ins_total_station import InsState
from localize.settings import PrismSettings
from localize.state import GRAVITY, GYRO_BIAS, ODOM, POSITION, ROTATION, VELOCITY, NavState
from semmap.geometry import Array, skew
from semmap.measurements import PrismFix
from semmap.rig import TotalStationBlock

_COLUMNS = np.r_[ROTATION, POSITION, ODOM]
_STANDS_S = 0.8
"""Fixes over this long tell whether the machine stands."""
_STANDS_SIGMAS = 3.0
_MOST_SPEED = 1.5
"""Refused fixes that move no faster than a machine are of the prism, and the filter is wrong [m/s]."""


@dataclass(frozen=True, slots=True)
class PrismPosition:
    """``r = p̂ - (p + R l)`` in the map, with the prism's lever arm l (paper 002 Eq. 22).

    p_map : (3,) fix. p_imu_prism : (3,) lever arm. std : per axis [m].
    """

    p_map: Array
    p_imu_prism: Array
    std: float

    def residual(self, state: NavState) -> Array:
        """Residual (3,) [m]."""
        return self.p_map - self._predicted(state)

    def _predicted(self, state: NavState) -> Array:
        assert state.T_map_odom is not None
        p_odom = state.p + state.R @ self.p_imu_prism
        return np.asarray(state.T_map_odom[:3, :3] @ p_odom + state.T_map_odom[:3, 3])

    def jacobian(self, state: NavState) -> Array:
        """Jacobian (3, 12) of the residual by rotation, position, and where odom lies in the map."""
        assert state.T_map_odom is not None
        R_map_odom = state.T_map_odom[:3, :3]
        H = np.empty((3, 12))
        H[:, :3] = R_map_odom @ state.R @ skew(self.p_imu_prism)
        H[:, 3:6] = -R_map_odom
        H[:, 6:9] = skew(self._predicted(state) - state.odom_centre)
        H[:, 9:] = -np.eye(3)
        return H

    def linearize(self, state: NavState) -> Information:
        return information(self.residual(state), self.jacobian(state), self.std**2 * np.eye(3), _COLUMNS)

    def predicted_std(self, filter: ErrorStateFilter) -> float:
        """How well the filter knows where the prism is, all axes together [m]."""
        H = self.jacobian(filter.state)
        return float(np.sqrt(np.trace(H @ filter.P[np.ix_(_COLUMNS, _COLUMNS)] @ H.T)))

    def distance2(self, filter: ErrorStateFilter) -> float:
        """Squared Mahalanobis distance of the fix from what the filter expects."""
        r, H = self.residual(filter.state), self.jacobian(filter.state)
        S = H @ filter.P[np.ix_(_COLUMNS, _COLUMNS)] @ H.T + self.std**2 * np.eye(3)
        return float(r @ np.linalg.solve(S, r))


@dataclass(frozen=True, slots=True)
class Standstill:
    """The velocity is zero, but for ``std`` [m/s]."""

    std: float

    def linearize(self, state: NavState) -> Information:
        return information(state.v, np.eye(3), self.std**2 * np.eye(3), np.r_[VELOCITY])


@dataclass(frozen=True, slots=True)
class TurnOnBias:
    """The gyroscope's bias (3,) is what it was switched on with, but for ``std`` [rad/s]."""

    std: float

    def linearize(self, state: NavState) -> Information:
        return information(state.gyro_bias, np.eye(3), self.std**2 * np.eye(3), np.r_[GYRO_BIAS])


@dataclass(frozen=True, slots=True)
class FixOutcome:
    """What became of a fix: whether ``used``, and how far off it was [m]."""

    used: bool
    off_m: float


class PrismFusion:
    """Takes fixes into a filter: for standing still while nobody knows where odom lies, as positions from then on."""

    def __init__(self, block: TotalStationBlock, settings: PrismSettings) -> None:
        self.block, self.settings = block, settings
        self.doubts = 0
        self._lever = np.array(block.p_imu_prism)
        self._standing: list[PrismFix] = []
        self._refused: list[PrismFix] = []

    def take(self, fix: PrismFix, filter: ErrorStateFilter) -> FixOutcome | None:
        """Take a fix at the filter's time; None where it was no position."""
        if filter.state.T_map_odom is None:
            self._stand(fix, filter)
            return None
        filter.centre_odom()
        model = PrismPosition(fix.p_map, self._lever, self.block.point_std)
        residual = model.residual(filter.state)
        off_m = float(np.linalg.norm(residual))
        if model.distance2(filter) > self.settings.gate and not self._contradicts(fix, off_m, filter):
            return FixOutcome(False, off_m)
        self._refused.clear()
        filter.update(model, iterations=2)
        return FixOutcome(True, off_m)

    def _contradicts(self, fix: PrismFix, off_m: float, filter: ErrorStateFilter) -> bool:
        """Whether so many fixes in a row were refused that belong together that it is the filter that is wrong.

        Then place and speed are doubted by as much as they are off.
        """
        self._refused = [*self._refused[1 - self.settings.contradicting :], fix]
        if len(self._refused) < self.settings.contradicting:
            return False
        if not all(self._belong_together(a, b) for a, b in pairwise(self._refused)):
            return False
        span_s = (self._refused[-1].stamp_ns - self._refused[0].stamp_ns) * 1e-9
        filter.doubt_odom(off_m)
        filter.P[VELOCITY, VELOCITY] += (off_m / max(span_s, 1.0)) ** 2 * np.eye(3)
        self.doubts += 1
        return True

    def _belong_together(self, a: PrismFix, b: PrismFix) -> bool:
        reach = _MOST_SPEED * abs(b.stamp_ns - a.stamp_ns) * 1e-9 + 6.0 * self.block.point_std
        return float(np.linalg.norm(b.p_map - a.p_map)) < reach

    def _stand(self, fix: PrismFix, filter: ErrorStateFilter) -> None:
        """A prism that does not move says that the machine stands, whatever way the map lies."""
        held = self._standing
        held.append(fix)
        span_s = (fix.stamp_ns - held[0].stamp_ns) * 1e-9
        if len(held) < 3 or span_s < _STANDS_S:
            return
        first, last = (np.mean([one.p_map for one in half], axis=0) for half in (held[: len(held) // 2], held[-2:]))
        if span_s < 3.0 * _STANDS_S and np.linalg.norm(last - first) < _STANDS_SIGMAS * self.block.point_std:
            filter.update(Standstill(2.0 * self.block.point_std / span_s))
        held.clear()


def without_earth_rate(filter: ErrorStateFilter, earth: Earth, gyro_bias_std: float, heading_std: float) -> None:
    """Take the horizontal part of the earth's rate out of the gyroscope's bias, where it was till north was known.

    From then on the bias is the sensor's own, which the rig knows.
    """
    state = filter.state
    if state.T_map_odom is None or not earth.rate.any():
        return
    horizontal = earth.rate * np.array([1.0, 1.0, 0.0])
    state.gyro_bias = state.gyro_bias - state.R.T @ state.T_map_odom[:3, :3].T @ horizontal
    filter.update(TurnOnBias(float(np.hypot(gyro_bias_std, heading_std * np.linalg.norm(horizontal)))))


def start_from(filter: ErrorStateFilter, ins: InsState, P: Array) -> None:
    """Go on from an inertial navigation in the map, whose covariance is P (15, 15) in the order of `localize.state`.

    What the filter knew itself is dropped, up to where odom lies: that is as it is, all error is in the pose.
    """
    state = filter.state
    assert state.T_map_odom is not None
    R_odom_map = state.T_map_odom[:3, :3].T
    state.R, state.v = R_odom_map @ ins.R, R_odom_map @ ins.v
    state.gyro_bias, state.accel_bias = ins.gyro_bias.copy(), ins.accel_bias.copy()
    state.g = -np.linalg.norm(state.g) * R_odom_map[:, 2]
    turned = np.eye(15)
    turned[POSITION, POSITION] = turned[VELOCITY, VELOCITY] = R_odom_map
    anew = np.r_[:15, GRAVITY, ODOM]
    filter.P[anew], filter.P[:, anew] = 0.0, 0.0
    filter.P[:15, :15] = turned @ P @ turned.T
