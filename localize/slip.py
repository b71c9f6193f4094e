"""The wheel that slips: noticed by its innovations, and heard all the same.

A slip of 20 % at 0.3 m/s is three sigmas of one reading, which happens; and a filter that follows the wheel soon sees
nothing. So innovations are summed (CUSUM), and what the wheel did to the velocity since the first suspicion is taken
back: the IMU carries it over. A slipping wheel is a wheel of another scale: while it slips, its scale is free, learnt
from the speed that the IMU carries (and LiDAR or UWB where they hold it), and forgotten when the sums tell a step back
to where the scale of before fits again, or, most slips being short, when what the wheel reads too much is gone by the
speed that the IMU has carried since. A wheel that spins or is locked is not heard until its speed fits. The
non-holonomic constraint holds in any case.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from localize.filter import ErrorStateFilter
from localize.settings import OdometrySettings
from localize.state import SCALE, VELOCITY
from localize.wheel import WheelVelocity
from semmap.geometry import Array
from semmap.measurements import WheelSpeed
from semmap.rig import WheelBlock

_DRIFT = 0.75
"""[sigma] what an innovation may be off without counting: about half of the smallest shift that matters."""
_ALARM = 6.0
"""[sigma] the sum at which it is no chance (once in 40,000 readings); a shift of three sigmas takes three of them."""
_SLIP_STD = 0.5
"""What a slip may change the scale by, relative."""
_SLIP_WALK = 0.002
"""What it changes from reading to reading, relative."""
_SLIDES = (0.5, 2.0)
"""Wheel over ground of a wheel that slides; beyond, it spins or is locked, and says nothing."""
_LEARNT_READINGS = 10
_FITTING_READINGS = 5
_SAME_SIGMAS = 2.0
_FIT_SIGMAS = 3.0
_SURE_SIGMAS = 5.0
_SHORT_NS = 3_000_000_000
"""So long the IMU carries the speed well enough to see a slip end; most are shorter."""
_BACK_READINGS, _BACK_SHARE = 5, 0.3
"""So many readings in a row with less than this share of the slip's excess, and the wheel grips."""
_LONGEST_NS = 30_000_000_000
"""What lasts longer is no slip: it is the wheel's scale, or the filter that is wrong."""


@dataclass(slots=True)
class Cusum:
    """Two one-sided sums of innovations. count : how many, since both were zero."""

    up: float = 0.0
    down: float = 0.0
    count: int = 0

    def add(self, z: float) -> bool:
        """Take in an innovation in sigmas; whether it is beyond chance that they have shifted."""
        self.up, self.down = max(0.0, self.up + z - _DRIFT), max(0.0, self.down - z - _DRIFT)
        self.count = 0 if self.calm else self.count + 1
        return max(self.up, self.down) > _ALARM

    @property
    def calm(self) -> bool:
        """Whether nothing speaks for a shift."""
        return self.up == 0.0 and self.down == 0.0


class Scale(NamedTuple):
    """A scale of the wheel and its variance."""

    value: float
    variance: float


class SlipChange(NamedTuple):
    """The wheel began to slip, or grips again; ``excess``: what it reads too much [m/s]."""

    stamp_ns: int
    slipping: bool
    excess: float


class WheelFusion:
    """Takes the wheel's readings into the filter.

    Attributes
    ----------
    slipping : whether it does. gripped_ns : stamp of the last reading while it did not. changes : oldest first.
    """

    def __init__(self, block: WheelBlock, settings: OdometrySettings) -> None:
        self._std = np.array([block.speed_std, settings.sideways_std, settings.sideways_std])
        self._grip = Scale(1.0, 0.0)
        self._since_ns = 0
        self._heard = True
        self._readings, self._apart = 0, 0.0
        self._slip_excess, self._followed_v = 0.0, np.zeros(3)
        self._lately: deque[float] = deque(maxlen=_BACK_READINGS)
        self._suspect()
        self.slipping = False
        self.gripped_ns = -(1 << 62)
        self.changes: list[SlipChange] = []

    def _suspect(self) -> None:
        """From here on things would be taken back."""
        self._cusum, self._moved_v, self._sum = Cusum(), np.zeros(3), 0.0

    def take(self, reading: WheelSpeed, gyro: Array, filter: ErrorStateFilter) -> None:
        """Fuse one reading; the filter is at its time, ``gyro`` (3,) is the rate measured then [rad/s]."""
        model = WheelVelocity(reading.speed, gyro, self._std)
        if self._heard:
            self._watch(model, reading.stamp_ns, filter)
        if self.slipping:
            self._follow(model, reading.stamp_ns, filter)
        v = filter.state.v
        filter.update(replace(model, forward=self._heard))
        self._moved_v = self._moved_v + filter.state.v - v
        self._followed_v = self._followed_v + filter.state.v - v
        if not self.slipping:
            self.gripped_ns = reading.stamp_ns

    def _watch(self, model: WheelVelocity, stamp_ns: int, filter: ErrorStateFilter) -> None:
        """Sum the innovations, and see whether they have shifted."""
        expected = np.hypot(model.forward_std(filter.state, filter.P), self._std[0])
        shifted = self._cusum.add(float(model.residual(filter.state)[0] / expected))
        if self._cusum.calm:
            self._suspect()
            if not self.slipping:
                self._grip = Scale(filter.state.wheel_scale, float(filter.P[SCALE, SCALE][0, 0]))
            return
        self._sum += self._excess(model, filter, self._moved_v)
        if shifted:
            self._shift(model, stamp_ns, filter)

    def _shift(self, model: WheelVelocity, stamp_ns: int, filter: ErrorStateFilter) -> None:
        """The wheel has begun to slip, slips otherwise than before, or grips again."""
        _take_back(self._moved_v, filter)
        excess, count = self._sum / self._cusum.count, self._cusum.count
        self._suspect()
        if self.slipping and self._fits(model, excess, count, filter):
            self._end(stamp_ns, self._grip, filter)
            return
        ground = float(model.velocity(filter.state)[0]) / self._grip.value
        over = 1.0 + excess / ground if abs(ground) > self._std[0] else np.inf
        if not self.slipping:
            self.slipping, self._since_ns = True, stamp_ns
            self.changes.append(SlipChange(stamp_ns, True, excess))
        self._apart = 0.0
        self._slip_excess, self._followed_v = excess, np.zeros(3)
        self._lately.clear()
        self._readings, self._heard = 0, _SLIDES[0] < over < _SLIDES[1]
        if self._heard:
            _set_scale(filter, Scale(self._grip.value / over, _SLIP_STD**2))

    def _excess(self, model: WheelVelocity, filter: ErrorStateFilter, followed_v: Array) -> float:
        """What the wheel reads too much [m/s] by the scale of before, had the velocity not followed it by so much."""
        forward = filter.state.R @ filter.state.T_imu_wheel[:3, 0]
        ground = float(model.velocity(filter.state)[0] - forward @ followed_v)
        return model.speed - ground / self._grip.value

    def _fits(self, model: WheelVelocity, excess: float, readings: int, filter: ErrorStateFilter) -> bool:
        """Whether a mean excess of some readings is chance."""
        known = model.forward_std(filter.state, _without_scale(filter.P))
        return abs(excess) < _FIT_SIGMAS * float(np.hypot(known, self._std[0] / np.sqrt(readings)))

    def _follow(self, model: WheelVelocity, stamp_ns: int, filter: ErrorStateFilter) -> None:
        """See whether the slip was none, is over, or is here to stay."""
        lasts = stamp_ns - self._since_ns > _LONGEST_NS
        self._readings += 1
        if not self._heard:
            excess = self._excess(model, filter, self._moved_v)
            self._readings = self._readings if self._fits(model, excess, 1, filter) else 0
            if lasts:
                _doubt(model, filter)
            if lasts or self._readings >= _FITTING_READINGS:
                self._end(stamp_ns, self._grip, filter)
            return
        if stamp_ns - self._since_ns < _SHORT_NS and self._is_back(model, filter):
            _take_back(self._followed_v, filter)
            self._end(stamp_ns, self._grip, filter)
            return
        filter.P[SCALE, SCALE] += _SLIP_WALK**2
        scale = Scale(filter.state.wheel_scale, float(filter.P[SCALE, SCALE][0, 0]))
        std, apart = float(np.sqrt(scale.variance)), abs(scale.value - self._grip.value)
        if self._readings == _LEARNT_READINGS:
            self._apart = apart
        # where the IMU alone holds the speed it soon has drifted so far that any scale is like any other
        told = self._readings == _LEARNT_READINGS or _FIT_SIGMAS * std < self._apart
        if told and apart < _SAME_SIGMAS * std:
            self._end(stamp_ns, self._grip, filter)
        elif lasts:
            # another scale for good must be sure: the one of before was learnt over a long way
            self._end(stamp_ns, self._grip if apart < _SURE_SIGMAS * std else scale, filter)

    def _is_back(self, model: WheelVelocity, filter: ErrorStateFilter) -> bool:
        """Whether what the wheel reads too much, by the speed that the IMU carries, is gone."""
        self._lately.append(self._excess(model, filter, self._followed_v))
        gone = abs(np.mean(self._lately)) < _BACK_SHARE * abs(self._slip_excess)
        return bool(len(self._lately) == _BACK_READINGS and gone)

    def _end(self, stamp_ns: int, scale: Scale, filter: ErrorStateFilter) -> None:
        self.slipping, self._heard, self._grip = False, True, scale
        self.changes.append(SlipChange(stamp_ns, False, 0.0))
        _set_scale(filter, scale)
        self._suspect()


def _take_back(moved_v: Array, filter: ErrorStateFilter) -> None:
    """The velocity without what the wheel did to it (3,), which may have been right."""
    filter.state.v = filter.state.v - moved_v
    filter.P[VELOCITY, VELOCITY] += np.outer(moved_v, moved_v)


def _doubt(model: WheelVelocity, filter: ErrorStateFilter) -> None:
    """Wheel and filter have contradicted one another for too long: nobody knows which of them is right."""
    forward = filter.state.R @ filter.state.T_imu_wheel[:3, 0]
    excess = float(model.residual(filter.state)[0])
    filter.P[VELOCITY, VELOCITY] += excess**2 * np.outer(forward, forward)


def _set_scale(filter: ErrorStateFilter, scale: Scale) -> None:
    """The scale as if it were known from elsewhere."""
    filter.state.wheel_scale = scale.value
    filter.P = _without_scale(filter.P)
    filter.P[SCALE, SCALE] = scale.variance


def _without_scale(P: Array) -> Array:
    P = P.copy()
    P[SCALE] = 0.0
    P[:, SCALE] = 0.0
    return P
