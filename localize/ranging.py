"""Ranges into the filter, each checked first."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from localize.filter import ErrorStateFilter
from localize.range_check import RangeCheck, Verdict
from localize.settings import RangeSettings
from localize.uwb import TagRange
from semmap.geometry import Array
from semmap.measurements import UwbRange
from semmap.rig import UwbBlock

_ITERATIONS = 3
_MOST_BIASES = 16
"""Anchors whose biases are kept."""
_VOICES = 3
"""Anchors that must contradict the filter."""


class Ranging:
    """Takes readings into a filter that knows where odom lies.

    block : the radios. anchors : id -> (3,) in the map, as the filter is to see it.
    """

    def __init__(self, block: UwbBlock, anchors: Mapping[int, Array], settings: RangeSettings) -> None:
        self.block, self.anchors, self.settings = block, dict(anchors), settings
        self.check = RangeCheck(settings)
        self.doubts = 0
        self._aged_ns: int | None = None
        self._off: dict[int, float] = {}
        self._off_since_ns = 0
        self._heard_ns: dict[int, int] = {}

    def take(self, reading: UwbRange, filter: ErrorStateFilter) -> Verdict:
        """Check a reading of a known anchor against the filter, at its own time, and let it in if it is good."""
        self._age(filter)
        filter.centre_odom()
        self._hear(reading, filter)
        std = self.block.range_std
        model = TagRange(reading.anchor, self.anchors[reading.anchor], reading.distance, std)
        predicted = reading.distance - float(model.residual(filter.state)[0])
        known = float(np.sqrt(max(0.0, model.predicted_variance(filter.state, filter.P))))
        bent = model.bent_variance(filter.state, filter.P)
        verdict = self.check.judge(reading, predicted, known, float(np.sqrt(std**2 + bent)))
        if not verdict.refused:
            weighed = TagRange(reading.anchor, model.p_map, reading.distance, verdict.std)
            filter.update(weighed, iterations=_ITERATIONS)
        self._doubt(reading, verdict, filter)
        return verdict

    def _doubt(self, reading: UwbRange, verdict: Verdict, filter: ErrorStateFilter) -> None:
        """Where nothing fits for a while, it is the filter that is wrong, not the anchors: count that in ``doubts``.

        At least three of them must say so, and one must be too short, which no blocked way can do.
        """
        if not verdict.refused:
            self._off.clear()
        elif verdict.refused in ("long", "short"):
            if not self._off:
                self._off_since_ns = reading.stamp_ns
            self._off[reading.anchor] = verdict.innovation
        lasted = reading.stamp_ns - self._off_since_ns > self.settings.memory_s * 1e9
        if lasted and len(self._off) >= _VOICES and min(self._off.values()) < 0.0:
            filter.doubt_odom(max(abs(off) for off in self._off.values()))
            self._off.clear()
            self.doubts += 1

    def _hear(self, reading: UwbRange, filter: ErrorStateFilter) -> None:
        """Give the anchor a bias; the one not heard for longest loses its own where there would be too many."""
        self._heard_ns[reading.anchor] = reading.stamp_ns
        if not self.block.bias_std:
            return
        if reading.anchor not in filter.state.anchors and len(filter.state.anchors) >= _MOST_BIASES:
            filter.forget(min(filter.state.anchors, key=lambda anchor: self._heard_ns[anchor]))
        filter.hear(reading.anchor, self.block.bias_std)

    def _age(self, filter: ErrorStateFilter) -> None:
        """The biases wander: with the temperature, and with what the waves pass."""
        if self._aged_ns is not None:
            filter.age_biases(self.settings.bias_walk**2 * (filter.stamp_ns - self._aged_ns) * 1e-9)
        self._aged_ns = filter.stamp_ns
