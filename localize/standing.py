"""A machine that stands before it starts: its heading from the earth's rate, where the gyroscope is good enough."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from localize.earth import Earth
from localize.settings import DenoiseSettings
from localize.static_alignment import StaticAlignment, align_static
from semmap.geometry import Array
from semmap.measurements import ImuSample, PrismFix
from semmap.rig import Rig, TotalStationBlock

_LEAST_S, _MOST_S = 20.0, 60.0
_MARGIN_NS = 1_000_000_000
"""Motion may have begun this long before a fix shows it."""
_STANDS_SIGMAS = 6.0
_MOVED = 3
"""So many fixes in a row elsewhere are motion, fewer are something else that shines."""
_HEADING_STD = 0.03
"""Gyroscopes that would know north no better than this are not asked [rad]."""


@dataclass(slots=True)
class PrismRest:
    """Tells by the fixes whether the prism stands.

    since_ns, last_ns : of the fixes of the present rest. count, mean : how many they are, and where (3,).
    """

    point_std: float
    since_ns: int = 0
    last_ns: int = 0
    count: int = 0
    mean: Array = field(default_factory=lambda: np.zeros(3))
    _away: int = 0

    def add(self, fix: PrismFix) -> bool:
        """Take a fix; whether a rest is over: the prism is elsewhere, and this is the first fix of another."""
        elsewhere = self.count > 0 and float(np.linalg.norm(fix.p_map - self.mean)) > _STANDS_SIGMAS * self.point_std
        self._away = self._away + 1 if elsewhere else 0
        if elsewhere and self._away < _MOVED:
            return False
        if elsewhere or not self.count:
            self.since_ns, self.count, self._away, self.mean = fix.stamp_ns, 0, 0, np.zeros(3)
        self.count += 1
        self.mean = self.mean + (fix.p_map - self.mean) / self.count
        self.last_ns = fix.stamp_ns
        return elsewhere

    def copy(self) -> PrismRest:
        """One that stays as it is."""
        return replace(self)


class Standing:
    """Keeps the IMU's samples while the prism stands; `alignment` is the attitude they tell.

    It wants them as they were read: with all of the stretch at hand, the engines' tones come out much cleaner than of a
    window that moves along.
    """

    def __init__(self, rig: Rig, station: TotalStationBlock, earth: Earth, denoise: DenoiseSettings) -> None:
        self.imu, self.station, self.earth, self.denoise = rig.imu, station, earth, denoise
        self._rest = PrismRest(station.point_std)
        self._samples: deque[ImuSample] = deque()
        self._found: StaticAlignment | None = None

    @property
    def since_ns(self) -> int:
        """Since when the prism stands."""
        return self._rest.since_ns

    @property
    def p_imu_prism(self) -> Array:
        """Lever arm (3,) of the prism."""
        return np.array(self.station.p_imu_prism)

    @classmethod
    def of(cls, rig: Rig, denoise: DenoiseSettings) -> Standing | None:
        """For a rig with a prism and a gyroscope that finds north; None for others."""
        earth = Earth.of(rig.earth)
        horizontal = float(np.hypot(earth.rate[0], earth.rate[1]))
        if rig.total_station is None or rig.imu.gyro_bias_std >= _HEADING_STD * horizontal:
            return None
        return cls(rig, rig.total_station, earth, denoise)

    def add_fix(self, fix: PrismFix) -> None:
        """The prism was seen; elsewhere than before means that the machine moved."""
        if self._rest.add(fix):
            self._found = None

    def add_sample(self, sample: ImuSample) -> None:
        """The IMU was read."""
        self._samples.append(sample)
        while sample.stamp_ns - self._samples[0].stamp_ns > (_MOST_S * 1e9):
            self._samples.popleft()

    def alignment(self) -> StaticAlignment | None:
        """Attitude in the map by gravity and the earth's rate; None where it has not stood for long enough."""
        if self._found is not None:
            return self._found
        begin_ns, end_ns = self._rest.since_ns + _MARGIN_NS, self._rest.last_ns - _MARGIN_NS
        if end_ns - begin_ns < _LEAST_S * 1e9:
            return None
        still = [sample for sample in self._samples if begin_ns <= sample.stamp_ns <= end_ns]
        if len(still) < 2 or (still[-1].stamp_ns - still[0].stamp_ns) * 1e-9 < 0.9 * _LEAST_S:
            return None
        stamps = np.array([sample.stamp_ns for sample in still], np.int64)
        gyro, accel = (np.array([getattr(sample, name) for sample in still]) for name in ("gyro", "accel"))
        if self.imu.engines:
            # its library takes a second to load, which those who need none should not wait for
            from localize.denoise import enhance

            clean = enhance(stamps, gyro, accel, self.denoise)
            gyro, accel = clean.gyro, clean.accel
        found = align_static(stamps, gyro, accel, self.imu, self.earth, tapered=self.imu.engines)
        self._found = found if found.sure(heading_std=_HEADING_STD) else None
        return self._found
