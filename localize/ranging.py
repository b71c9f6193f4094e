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


class Ranging:
    """Takes readings into a filter that knows where odom lies.

    block : the radios. anchors : id -> (3,) in the map, as the filter is to see it.
    """

    def __init__(self, block: UwbBlock, anchors: Mapping[int, Array], settings: RangeSettings) -> None:
        self.block, self.anchors, self.settings = block, dict(anchors), settings
        self.check = RangeCheck(settings)
        self._aged_ns: int | None = None

    def take(self, reading: UwbRange, filter: ErrorStateFilter) -> Verdict:
        """Check a reading of a known anchor against the filter, at its own time, and let it in if it is good."""
        self._age(filter)
        filter.centre_odom()
        if self.block.bias_std:
            filter.hear(reading.anchor, self.block.bias_std)
        std = self.block.range_std
        model = TagRange(reading.anchor, self.anchors[reading.anchor], reading.distance, std)
        predicted = reading.distance - float(model.residual(filter.state)[0])
        known = float(np.sqrt(model.predicted_variance(filter.state, filter.P)))
        verdict = self.check.judge(reading, predicted, known, std)
        if not verdict.refused:
            weighed = TagRange(reading.anchor, model.p_map, reading.distance, verdict.std)
            filter.update(weighed, iterations=_ITERATIONS)
        return verdict

    def _age(self, filter: ErrorStateFilter) -> None:
        """The biases wander: with the temperature, and with what the waves pass."""
        if self._aged_ns is not None:
            filter.age_biases(self.settings.bias_walk**2 * (filter.stamp_ns - self._aged_ns) * 1e-9)
        self._aged_ns = filter.stamp_ns
