"""The total station to the filter: where its prism is (paper 002 Eq. 16 to 26, in the filter of paper 000).

The INS/total-station filter of the paper and its LiDAR filter are one here: IMU and fixes carry the state to the end
of a scan, which starts its update there and is deskewed on the way, and goes on by them alone where the LiDAR sees
nothing. So no measurement enters two filters.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from localize.earth import Earth
from localize.filter import ErrorStateFilter, Information, information
from localize.ins_total_station import InsState
from localize.recent_motion import HELD_NS, PointPath, RecentMotion
from localize.settings import PrismSettings
from localize.state import CLOCK, GRAVITY, GYRO_BIAS, ODOM, POSITION, ROTATION, VELOCITY, NavState
from semmap.geometry import Array, skew
from semmap.measurements import PrismFix
from semmap.rig import TotalStationBlock

COLUMNS = np.r_[ROTATION, POSITION, VELOCITY, ODOM, CLOCK]
_STANDS_S = 0.8
"""Fixes over this long tell whether the machine stands."""
_STANDS_SIGMAS = 3.0
_CLOCK_SIGMAS = 3.0
"""The total station's clock is off by no more."""
_CREEP, _ALONG = 0.05, 0.9
"""Slower than this the machine shows nothing of the clocks [m/s]; cosine between its way and what a clock puts off."""
_MOST_SPEED = 3.0
"""Refused fixes that move no faster than a machine are of the prism, and the filter is wrong [m/s]."""


@dataclass(frozen=True, slots=True)
class PrismPosition:
    """``r = p̂ - (p + R l(t) + v t)`` in the map, with the prism's lever arm l (paper 002 Eq. 22), t after the present.

    The paper's fixes are of the present, t = 0. Here t is ``since_s``, and what the total station's clock is off by.
    p_map : (3,) fix. path : of the prism around the present. std : per axis [m].
    since_s : time from the present to the fix, by its stamp [s].
    """

    p_map: Array
    path: PointPath
    std: float
    since_s: float = 0.0

    def residual(self, state: NavState) -> Array:
        """Residual (3,) [m]."""
        return self.p_map - self._predicted(state)

    def _predicted(self, state: NavState) -> Array:
        assert state.T_map_odom is not None
        t = self.since_s + state.clock_offset
        p_odom = state.p + state.R @ self.path.at(t)[0] + state.v * t
        return np.asarray(state.T_map_odom[:3, :3] @ p_odom + state.T_map_odom[:3, 3])

    def jacobian(self, state: NavState) -> Array:
        """Jacobian (3, 16) of the residual by rotation, position, velocity, where odom lies in the map, and clock."""
        assert state.T_map_odom is not None
        R_map_odom = state.T_map_odom[:3, :3]
        t = self.since_s + state.clock_offset
        lever, changes = self.path.at(t)
        H = np.empty((3, 16))
        H[:, :3] = R_map_odom @ state.R @ skew(lever)
        H[:, 3:6] = -R_map_odom
        H[:, 6:9] = -R_map_odom * t
        H[:, 9:12] = skew(self._predicted(state) - state.odom_centre)
        H[:, 12:15] = -np.eye(3)
        H[:, 15] = -R_map_odom @ (state.v + state.R @ changes)
        return H

    def linearize(self, state: NavState) -> Information:
        return information(self.residual(state), self.jacobian(state), self.std**2 * np.eye(3), COLUMNS)

    def predicted_std(self, filter: ErrorStateFilter) -> float:
        """How well the filter knows where the prism is, all axes together [m]."""
        H = self.jacobian(filter.state)
        return float(np.sqrt(np.trace(H @ filter.P[np.ix_(COLUMNS, COLUMNS)] @ H.T)))

    def distance2(self, filter: ErrorStateFilter) -> float:
        """Squared Mahalanobis distance of the fix from what the filter expects."""
        r, H = self.residual(filter.state), self.jacobian(filter.state)
        S = H @ filter.P[np.ix_(COLUMNS, COLUMNS)] @ H.T + self.std**2 * np.eye(3)
        return float(r @ np.linalg.solve(S, r))


@dataclass(frozen=True, slots=True)
class Standstill:
    """The velocity is zero, but for ``std`` [m/s]; or was, before it became ``faster`` by (3,)."""

    std: float
    faster: Array = field(default_factory=lambda: np.zeros(3))

    def linearize(self, state: NavState) -> Information:
        return information(state.v - self.faster, np.eye(3), self.std**2 * np.eye(3), np.r_[VELOCITY])


@dataclass(frozen=True, slots=True)
class TurnOnBias:
    """The gyroscope's bias (3,) is what it was switched on with, but for ``std`` [rad/s]."""

    std: float

    def linearize(self, state: NavState) -> Information:
        return information(state.gyro_bias, np.eye(3), self.std**2 * np.eye(3), np.r_[GYRO_BIAS])


@dataclass(frozen=True, slots=True)
class Clock:
    """What is to be added to the total station's stamps, beside what the rig says, and how well that is known [s]."""

    offset_s: float = 0.0
    std_s: float = 0.0

    @classmethod
    def of(cls, filter: ErrorStateFilter) -> Clock | None:
        """As a filter knows it; None before it has its place in the map."""
        if filter.state.T_map_odom is None:
            return None
        return cls(filter.state.clock_offset, float(np.sqrt(filter.P[CLOCK, CLOCK][0, 0])))

    def corrected_ns(self, stamp_ns: int) -> int:
        """A stamp on the robot's clock."""
        return stamp_ns + round(self.offset_s * 1e9)


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

    def take(self, fix: PrismFix, filter: ErrorStateFilter, recent: RecentMotion | None = None) -> FixOutcome | None:
        """Take a fix at the filter's time, or of lately; None where it was no position."""
        recent = recent or RecentMotion()
        if filter.state.T_map_odom is None:
            self._stand(fix, filter, recent)
            return None
        filter.centre_odom()
        since_s = (fix.stamp_ns - filter.stamp_ns) * 1e-9
        model = PrismPosition(fix.p_map, recent.path(self._lever, filter.state), self.block.point_std, since_s)
        residual = model.residual(filter.state)
        off_m = float(np.linalg.norm(residual))
        if model.distance2(filter) > self.settings.gate and not self._contradicts(fix, residual, filter):
            return FixOutcome(False, off_m)
        self._refused.clear()
        filter.update(model, iterations=2)
        return FixOutcome(True, off_m)

    def _contradicts(self, fix: PrismFix, residual: Array, filter: ErrorStateFilter) -> bool:
        """Whether so many fixes in a row were refused that belong together that it is the filter that is wrong.

        Then place and speed are doubted by as much as they are off.
        """
        self._refused = [*self._refused[1 - self.settings.contradicting :], fix]
        if len(self._refused) < self.settings.contradicting:
            return False
        if not all(self._belong_together(a, b) for a, b in pairwise(self._refused)):
            return False
        span_s = (self._refused[-1].stamp_ns - self._refused[0].stamp_ns) * 1e-9
        off_m = float(np.linalg.norm(residual))
        filter.doubt_odom(off_m)
        filter.P[VELOCITY, VELOCITY] += (off_m / max(span_s, 1.0)) ** 2 * np.eye(3)
        self._doubt_clock(residual, filter)
        self.doubts += 1
        return True

    def _doubt_clock(self, residual: Array, filter: ErrorStateFilter) -> None:
        """A clock that is off puts fixes off along the way, and may be the reason where they are off along that."""
        state = filter.state
        assert state.T_map_odom is not None
        speed = max(float(np.linalg.norm(state.v)), _CREEP)
        along = abs(float(residual @ state.T_map_odom[:3, :3] @ state.v)) / speed
        if self.block.time_offset_std and along > _ALONG * np.linalg.norm(residual):
            filter.P[CLOCK, CLOCK] += min(along / speed, HELD_NS * 1e-9) ** 2

    def _belong_together(self, a: PrismFix, b: PrismFix) -> bool:
        reach = _MOST_SPEED * abs(b.stamp_ns - a.stamp_ns) * 1e-9 + 6.0 * self.block.point_std
        return float(np.linalg.norm(b.p_map - a.p_map)) < reach

    def _stand(self, fix: PrismFix, filter: ErrorStateFilter, recent: RecentMotion) -> None:
        """A prism that does not move says that the machine stands, whatever way the map lies; or that it stood, as long
        ago as the clocks may be apart."""
        held = self._standing
        held.append(fix)
        span_s = (fix.stamp_ns - held[0].stamp_ns) * 1e-9
        if len(held) < 3 or span_s < _STANDS_S:
            return
        first, last = (np.mean([one.p_map for one in half], axis=0) for half in (held[: len(held) // 2], held[-2:]))
        if span_s < 3.0 * _STANDS_S and np.linalg.norm(last - first) < _STANDS_SIGMAS * self.block.point_std:
            stood_ns = fix.stamp_ns - round(_CLOCK_SIGMAS * self.block.time_offset_std * 1e9)
            filter.update(Standstill(2.0 * self.block.point_std / span_s, recent.faster_by(stood_ns)))
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


def start_from(filter: ErrorStateFilter, ins: InsState, clock_offset: float, P: Array) -> None:
    """Go on from an inertial navigation in the map, whose covariance is P (16, 16) in the order of `localize.state`,
    with the total station's clock last.

    What the filter knew itself is dropped, up to where odom lies: that is as it is, all error is in the pose.
    """
    state = filter.state
    assert state.T_map_odom is not None
    R_odom_map = state.T_map_odom[:3, :3].T
    state.R, state.v = R_odom_map @ ins.R, R_odom_map @ ins.v
    state.gyro_bias, state.accel_bias = ins.gyro_bias.copy(), ins.accel_bias.copy()
    state.g = -np.linalg.norm(state.g) * R_odom_map[:, 2]
    state.clock_offset = clock_offset
    turned = np.eye(16)
    turned[POSITION, POSITION] = turned[VELOCITY, VELOCITY] = R_odom_map
    anew = np.r_[:15, GRAVITY, ODOM, CLOCK]
    filter.P[anew], filter.P[:, anew] = 0.0, 0.0
    known = np.r_[:15, CLOCK]
    filter.P[np.ix_(known, known)] = turned @ P @ turned.T
