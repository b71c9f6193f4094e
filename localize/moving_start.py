"""Where a machine is that moves in sight of the total station while its LiDAR is blind: the INS/total-station filter.

Without north at rest, and without LiDAR, only motion tells the heading: what the IMU feels as forward the fixes see as
some direction in the map. One filter of paper 002 (Eq. 16 to 26) starts from each of several headings all round; those
whose way is another than that of the fixes become unlikely, and the others find the same heading from both sides.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from itertools import islice, takewhile

import numpy as np
from numpy.typing import NDArray

from localize.earth import Earth
from localize.ins_start import moving_start, standing_start
from localize.ins_total_station import ROTATION, InsState, InsTotalStationFilter
from localize.standing import PrismRest
from localize.static_alignment import align_static
from semmap.geometry import Array, yaw_of
from semmap.measurements import ImuSample, PrismFix
from semmap.rig import Rig, TotalStationBlock

_HEADINGS = 24
_HEADING_STD = 0.1
"""Of each at the start [rad]: neighbours overlap. With half as many headings, twice as vague, what the fixes tell is
not linear enough: starts on the way end three times as far off as they say, instead of 1.4 times."""
_REST_S, _MARGIN_NS = 2.0, 1_000_000_000
"""A rest shorter than this says too little [s]; motion may have begun this long before a fix shows it."""
_UNDER_WAY_S = 1.5
"""Fixes over this long tell the velocity of a machine that did not stand before."""
_UNDER_WAY_M = 0.15
"""It moves so far meanwhile. Of one that creeps the lean would be taken for acceleration, and that for a heading."""
_FEW = 5
_MOST_S = 60.0
_UNLIKELY = np.log(1e-6)
_LEAD = np.log(1e3)
"""By so much the best heading must be likelier than any other."""
_APART_RAD, _APART_SIGMAS = 0.05, 4.0
"""Filters whose headings are no farther apart are of one heading."""
_LEAST_M = 0.5
"""So far must the prism have come."""
_REFUSED, _LEAST_FIXES, _LATEST = 0.3, 12, 30
"""With more than this share of the latest fixes refused, the filter is not right either."""
_MOST_DISTANCE2 = 4.5
"""Fixes that are taken are off by 3 (squared, in sigmas) in the mean where all is as the rig says."""


@dataclass(frozen=True, slots=True, eq=False)
class MovingPlace:
    """Where the imu is in the map, and how well that is known.

    state, P : of the filter, P (16, 16) with the total station's clock last. clock_offset : of that [s].
    heading_std : [rad]. p_map_prism : (3,), covariance (3, 3) [m²] of that.
    """

    state: InsState
    P: Array
    clock_offset: float
    heading_std: float
    p_map_prism: Array
    covariance: Array


@dataclass(slots=True, eq=False)
class _Heading:
    """One filter, the logarithm of its likelihood, and of its latest fixes: distance², infinite if refused."""

    filter: InsTotalStationFilter
    log_likelihood: float = 0.0
    latest: deque[float] = field(default_factory=lambda: deque(maxlen=_LATEST))

    @property
    def yaw(self) -> float:
        """[rad]"""
        return yaw_of(self.filter.state.R)

    @property
    def yaw_std(self) -> float:
        """[rad]"""
        up_imu = self.filter.state.R[2]
        return float(np.sqrt(up_imu @ self.filter.P[ROTATION, ROTATION] @ up_imu))

    @property
    def fits(self) -> bool:
        """Whether the latest fixes are where they are expected."""
        used = [distance2 for distance2 in self.latest if np.isfinite(distance2)]
        enough = len(self.latest) >= _LEAST_FIXES and len(used) > (1.0 - _REFUSED) * len(self.latest)
        return enough and float(np.mean(used)) < _MOST_DISTANCE2


class MovingStart:
    """Holds IMU samples, without the engines' vibration, and fixes; works on them only when `place` is asked for.

    heading_std : how well the heading must be known [rad].
    """

    def __init__(self, rig: Rig, station: TotalStationBlock, heading_std: float) -> None:
        self.imu, self.station, self.earth, self.heading_std = rig.imu, station, Earth.of(rig.earth), heading_std
        self._rest = PrismRest(station.point_std)
        self._left: PrismRest | None = None
        """The last rest of some length, once it is over."""
        self._samples: deque[ImuSample] = deque()
        self._fixes: deque[PrismFix] = deque()
        self._bank: list[_Heading] = []
        self._from = np.zeros(3)

    @classmethod
    def of(cls, rig: Rig, heading_std: float) -> MovingStart | None:
        """For a rig with a prism; None for others."""
        return None if rig.total_station is None else cls(rig, rig.total_station, heading_std)

    @property
    def p_imu_prism(self) -> Array:
        """Lever arm (3,) of the prism."""
        return np.array(self.station.p_imu_prism)

    def add_fix(self, fix: PrismFix) -> None:
        """The prism was seen."""
        if self._fixes and fix.stamp_ns <= self._fixes[-1].stamp_ns:
            return
        before = self._rest.copy()
        if self._rest.add(fix) and before.last_ns - before.since_ns > _REST_S * 1e9 + 2 * _MARGIN_NS:
            self._left = before
        self._fixes.append(fix)
        while fix.stamp_ns - self._fixes[0].stamp_ns > _MOST_S * 1e9:
            self._fixes.popleft()

    def add_sample(self, sample: ImuSample) -> None:
        """The IMU was read."""
        if self._samples and sample.stamp_ns <= self._samples[-1].stamp_ns:
            return
        self._samples.append(sample)
        while sample.stamp_ns - self._samples[0].stamp_ns > _MOST_S * 1e9:
            self._samples.popleft()

    def place(self, stamp_ns: int) -> MovingPlace | None:
        """The place at a time that the samples have reached; None while the heading is not known for sure."""
        if not self._bank:
            self._begin()
        if not self._bank or self._bank[0].filter.stamp_ns < self._samples[0].stamp_ns:
            self._bank = []
            return None
        while self._bank and self._fixes and self._fixes[0].stamp_ns <= min(stamp_ns, self._samples[-1].stamp_ns):
            self._take(self._fixes.popleft())
        if not self._bank or self._bank[0].filter.stamp_ns > stamp_ns:
            return None
        best = max(self._bank, key=lambda one: one.log_likelihood)
        if not self._sure(best):
            return None
        # all of them stay at the last fix
        filter = deepcopy(best.filter)
        if filter.stamp_ns < stamp_ns:
            filter.predict(*self._until(filter.stamp_ns, stamp_ns))
        p_map_prism, covariance = filter.prism()
        return MovingPlace(
            filter.state, filter.covariance, filter.clock_offset, best.yaw_std, p_map_prism, covariance
        )  # fmt: skip

    def _begin(self) -> None:
        """Start the filters at the end of the last rest, or on the way."""
        left = self._left
        if left is not None and self._samples and self._samples[0].stamp_ns <= left.last_ns - 2 * _MARGIN_NS:
            self._begin_rested(left)
        elif self._rest.last_ns - self._rest.since_ns < _REST_S * 1e9:
            self._begin_under_way()

    def _begin_rested(self, rest: PrismRest) -> None:
        begin_ns, end_ns = rest.since_ns + _MARGIN_NS, rest.last_ns - _MARGIN_NS
        still = [sample for sample in self._samples if begin_ns <= sample.stamp_ns <= end_ns]
        if len(still) < 2 or still[-1].stamp_ns - still[0].stamp_ns < 0.5 * _REST_S * 1e9:
            return
        fix, (stamps, gyro, accel) = PrismFix(still[-1].stamp_ns, rest.mean), _columns(still)
        starts = []
        for yaw in _yaws().tolist():
            alignment = align_static(
                stamps, gyro, accel, self.imu, self.earth, heading=yaw, heading_std=_HEADING_STD,
                tapered=self.imu.engines,
            )  # fmt: skip
            starts.append(standing_start(alignment, fix, self.imu, self.station, self.earth))
        self._start(starts, fix)

    def _begin_under_way(self) -> None:
        """From the oldest fixes that are held, and the samples of the same time."""
        while self._fixes and self._samples and self._fixes[0].stamp_ns < self._samples[0].stamp_ns:
            self._fixes.popleft()
        if not self._fixes or not self._samples:
            return
        until_ns = min(self._fixes[0].stamp_ns + round(_UNDER_WAY_S * 1e9), self._samples[-1].stamp_ns)
        fixes = [fix for fix in self._fixes if fix.stamp_ns <= until_ns]
        if len(fixes) < _FEW or fixes[-1].stamp_ns - fixes[0].stamp_ns < 0.5 * _UNDER_WAY_S * 1e9:
            return
        if float(np.linalg.norm(fixes[-1].p_map - fixes[0].p_map)) < _UNDER_WAY_M:
            self._fixes.popleft()
            return
        _, gyro, accel = _columns([s for s in self._samples if fixes[0].stamp_ns <= s.stamp_ns <= fixes[-1].stamp_ns])
        felt = gyro.mean(axis=0), accel.mean(axis=0)
        starts = [
            moving_start(fixes, *felt, yaw, _HEADING_STD, self.imu, self.station, self.earth)
            for yaw in _yaws().tolist()
        ]
        self._start(starts, fixes[-1])

    def _start(self, starts: Sequence[tuple[InsState, Array]], fix: PrismFix) -> None:
        self._bank = [
            _Heading(InsTotalStationFilter(state, P, fix.stamp_ns, self.imu, self.station, self.earth))
            for state, P in starts
        ]
        for one in self._bank:
            one.filter.placed_by_fixes()
        self._from, self._left = fix.p_map, None
        self._fixes = deque(one for one in self._fixes if one.stamp_ns > fix.stamp_ns)

    def _take(self, fix: PrismFix) -> None:
        """A fix into all filters; the unlikely ones go."""
        samples = self._until(self._bank[0].filter.stamp_ns, fix.stamp_ns)
        for one in self._bank:
            one.filter.predict(*samples)
            outcome = one.filter.update(fix)
            one.log_likelihood += outcome.log_likelihood
            one.latest.append(outcome.distance2 if outcome.used else np.inf)
        most = max(one.log_likelihood for one in self._bank)
        self._bank = [one for one in self._bank if one.log_likelihood > most + _UNLIKELY]
        best = max(self._bank, key=lambda one: one.log_likelihood)
        if len(best.latest) == _LATEST and not np.isfinite(best.latest).any():
            self._bank = []

    def _sure(self, best: _Heading) -> bool:
        moved = float(np.linalg.norm(best.filter.prism()[0] - self._from))
        if moved < _LEAST_M or best.yaw_std > self.heading_std or not best.fits:
            return False
        for one in self._bank:
            apart = abs(np.angle(np.exp(1j * (one.yaw - best.yaw))))
            same = apart < max(_APART_RAD, _APART_SIGMAS * float(np.hypot(one.yaw_std, best.yaw_std)))
            if not same and one.log_likelihood > best.log_likelihood - _LEAD:
                return False
        return True

    def _until(self, begin_ns: int, end_ns: int) -> tuple[NDArray[np.int64], Array, Array]:
        """Samples from one time to another, interpolated at both; what is older is no longer held."""
        while len(self._samples) > 1 and self._samples[1].stamp_ns <= begin_ns:
            self._samples.popleft()
        within = list(takewhile(lambda sample: sample.stamp_ns < end_ns, self._samples))
        stamps, gyro, accel = _columns([*within, *islice(self._samples, len(within), len(within) + 1)])
        at = np.concatenate([[begin_ns], stamps[(stamps > begin_ns) & (stamps < end_ns)], [end_ns]]).astype(np.int64)
        seconds, known = (at - begin_ns) * 1e-9, (stamps - begin_ns) * 1e-9
        rate, force = (np.column_stack([np.interp(seconds, known, axis) for axis in x.T]) for x in (gyro, accel))
        return at, rate, force


def _yaws() -> Array:
    return np.linspace(-np.pi, np.pi, _HEADINGS, endpoint=False)


def _columns(samples: Sequence[ImuSample]) -> tuple[NDArray[np.int64], Array, Array]:
    """Stamps (n,), rates and specific force (n, 3)."""
    stamps = np.array([sample.stamp_ns for sample in samples], np.int64)
    return stamps, np.array([sample.gyro for sample in samples]), np.array([sample.accel for sample in samples])
