"""Ranges into the filter, each checked first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from localize.filter import ErrorStateFilter
from localize.local_map import LocalMap
from localize.range_check import RangeCheck, Verdict
from localize.settings import RangeSettings
from localize.state import NavState
from localize.tag_position import Ranges, TagFix, find_tag
from localize.uwb import TagPosition, TagRange, tag_in_map
from semmap.geometry import Array, inverse, transform
from semmap.measurements import UwbRange
from semmap.rig import UwbBlock

_ITERATIONS = 3
_MOST_BIASES = 16
"""Anchors whose biases are kept."""
_VOICES = 3
"""Anchors that must contradict the filter."""
_AGREEING = 0.8
"""Share of their readings that one place must explain."""


class Ranging:
    """Takes readings into a filter that knows where odom lies.

    block : the radios. anchors : id -> (3,) in the map, as the filter is to see it.
    """

    def __init__(self, block: UwbBlock, anchors: Mapping[int, Array], settings: RangeSettings) -> None:
        self.block, self.anchors, self.settings = block, dict(anchors), settings
        self.check = RangeCheck(settings)
        self.doubts = 0
        self._aged_ns: int | None = None
        self._off: list[tuple[UwbRange, float]] = []
        self._heard_ns: dict[int, int] = {}

    def take(self, reading: UwbRange, filter: ErrorStateFilter, local_map: LocalMap | None = None) -> Verdict:
        """Check a reading of a known anchor against the filter, at its own time, and let it in if it is good.

        local_map : knows where there is rock: what came through it reads too long, be it by little.
        """
        self._age(filter)
        filter.centre_odom()
        self._hear(reading, filter)
        std = self.block.range_std
        model = TagRange(reading.anchor, self.anchors[reading.anchor], reading.distance, std)
        predicted = reading.distance - float(model.residual(filter.state)[0])
        known = float(np.sqrt(max(0.0, model.predicted_variance(filter.state, filter.P))))
        bent = model.bent_variance(filter.state, filter.P)
        verdict = self.check.judge(reading, predicted, known, float(np.sqrt(std**2 + bent)))
        if not verdict.refused and local_map is not None and hidden(model.p_map, filter.state, local_map):
            verdict = replace(verdict, refused="rock")
        if not verdict.refused:
            weighed = TagRange(reading.anchor, model.p_map, reading.distance, verdict.std)
            filter.update(weighed, iterations=_ITERATIONS)
        self._doubt(reading, verdict, filter)
        return verdict

    def _doubt(self, reading: UwbRange, verdict: Verdict, filter: ErrorStateFilter) -> None:
        """Where nothing fits for a while, it may be the filter that is wrong, not the anchors: then ``doubts`` counts.

        At least three of them must say so, one must be too short, which no blocked way can do, and their ranges must
        make one place. The filter is put there by its position (paper 000 Eq. 5, 6).
        """
        if not verdict.refused:
            self._off.clear()
        elif verdict.refused in ("long", "short"):
            self._off.append((reading, verdict.innovation))
        if not self._off or reading.stamp_ns - self._off[0][0].stamp_ns < self.settings.memory_s * 1e9:
            return
        fix = self._found_elsewhere(filter)
        self._off.clear()
        if fix is not None:
            filter.doubt_odom(float(np.linalg.norm(fix.p_map - tag_in_map(filter.state))))
            filter.update(TagPosition(fix.p_map, fix.covariance), iterations=_ITERATIONS)
            self.doubts += 1

    def _found_elsewhere(self, filter: ErrorStateFilter) -> TagFix | None:
        """Where the refused readings put the tag, if they agree with one another."""
        state, readings = filter.state, [reading for reading, _ in self._off]
        if len({reading.anchor for reading in readings}) < _VOICES or min(off for _, off in self._off) > 0.0:
            return None
        ranges = Ranges(
            np.array([self.anchors[reading.anchor] for reading in readings]),
            np.array([filter.true_distance(reading.anchor, reading.distance) for reading in readings]),
            np.full(len(readings), self.block.range_std),
            np.array([(filter.stamp_ns - reading.stamp_ns) * 1e-9 for reading in readings]),
        )
        reach = max(abs(off) for _, off in self._off)
        fix = find_tag(ranges, prior=TagFix(tag_in_map(state), reach**2 * np.eye(3), np.zeros(0)))
        if fix is None or fix.mirror is not None:
            return None
        fits = np.abs(fix.residuals) < self.settings.max_innovation * self.block.range_std
        return fix if fits.mean() > _AGREEING else None

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


def hidden(anchor: Array, state: NavState, local_map: LocalMap) -> bool:
    """Whether rock lies between the tag and an ``anchor`` (3,) in the map."""
    assert state.T_map_odom is not None
    tag, anchor = transform(inverse(state.T_map_odom), np.array([tag_in_map(state), anchor]))
    return bool(local_map.hides(tag[None], anchor[None], state.T_odom_map)[0])
