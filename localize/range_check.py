"""The preliminary check of every range (paper 000 section IV): jumps, blocked ways, and anchors that fell silent."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from localize.settings import RangeSettings
from semmap.measurements import UwbRange

_REMEMBERED = 5
"""Readings of an anchor that the next one is compared with."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the check says of a reading.

    refused : ``jump``: faster than the robot moves; ``long``: the way is blocked; ``short``: nonsense, or the robot is
        elsewhere; ``probation``: agrees again, but not for long enough; ``rock``: fits, but came through rock that the
        LiDAR has seen; empty where the reading is good.
    innovation : measured less predicted [m]. std : to weigh it with, larger for the odd ones [m].
    """

    refused: str
    innovation: float
    std: float


@dataclass(slots=True)
class _Anchor:
    readings: deque[UwbRange] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))
    jumps: deque[UwbRange] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))
    refused_in_row: int = 0
    agreed_in_row: int = 0
    blocked: bool = False


class RangeCheck:
    """Remembers how each anchor did."""

    def __init__(self, settings: RangeSettings) -> None:
        self.settings = settings
        self._anchors: dict[int, _Anchor] = {}

    @property
    def blocked(self) -> set[int]:
        """Anchors whose readings have been too long for a while, or not good again for long enough."""
        return {anchor for anchor, record in self._anchors.items() if record.blocked}

    def silent(self, stamp_ns: int) -> set[int]:
        """Anchors that were heard once and not lately."""
        return {
            anchor for anchor, record in self._anchors.items()
            if stamp_ns - record.readings[-1].stamp_ns > self.settings.memory_s * 1e9
        }  # fmt: skip

    def judge(self, reading: UwbRange, predicted: float, predicted_std: float, std: float) -> Verdict:
        """Judge a reading with noise ``std`` given the distance predicted, and how well that is known [m].

        The sign matters: rock in the way makes a range longer, never shorter. An anchor that was too long a few times
        in a row is blocked: from then on less is too long, and it is heard again after a few readings that agree.
        """
        s, record = self.settings, self._anchors.setdefault(reading.anchor, _Anchor())
        innovation, sigma = reading.distance - predicted, float(np.hypot(predicted_std, std))
        gate = max(s.min_gate, s.max_innovation * sigma)
        jumped = self._jumped(record, reading, std)
        record.readings.append(reading)
        if jumped:
            record.jumps.append(reading)
            refused = "jump"
        elif innovation > (0.5 * gate if record.blocked else gate):
            refused = "long"
        else:
            refused = "short" if innovation < -gate else ""
        refused = self._persisted(record, refused)
        weaker = max(1.0, abs(innovation) / (s.huber_sigmas * sigma))
        return Verdict(refused, innovation, std * weaker)

    def _jumped(self, record: _Anchor, reading: UwbRange, std: float) -> bool:
        """Whether the robot cannot have moved so fast.

        Seen from most of the anchor's last readings, and from those of them that were no jumps: after a burst of odd
        ones, the next good one is good at once.
        """
        s = self.settings
        age_s = np.array([(reading.stamp_ns - last.stamp_ns) * 1e-9 for last in record.readings])
        off = np.array([abs(reading.distance - last.distance) for last in record.readings])
        near = off < s.max_speed * age_s + np.sqrt(2.0) * s.max_innovation * std
        lately = age_s < s.memory_s
        trusted = lately & np.array([last not in record.jumps for last in record.readings], dtype=np.bool_)
        if lately.sum() < 2:
            return False
        return not (near[lately].mean() >= 0.5 or (trusted.any() and near[trusted].mean() >= 0.5))

    def _persisted(self, record: _Anchor, refused: str) -> str:
        """The anchor's state after a reading; a good one of a blocked anchor is on probation first."""
        if refused:
            record.refused_in_row, record.agreed_in_row = record.refused_in_row + 1, 0
            record.blocked |= refused == "long" and record.refused_in_row >= self.settings.in_row
            return refused
        record.refused_in_row, record.agreed_in_row = 0, record.agreed_in_row + 1
        if record.blocked and record.agreed_in_row < self.settings.in_row:
            return "probation"
        record.blocked = False
        return ""
