"""Fixes of a tag, one after another, from its ranges alone."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from localize.range_check import RangeCheck, Verdict
from localize.settings import RangeSettings
from localize.tag_position import Ranges, TagFix, find_tag
from semmap.geometry import Array
from semmap.measurements import UwbRange
from semmap.rig import UwbBlock


class TagLocator:
    """Puts the checked ranges of the last moment together into a fix; it knows nothing of the motion but a speed limit.

    Parameters
    ----------
    block, anchors, settings : as in `localize.ranging.Ranging`.
    prior : what is known of the place before anything is heard: its height, for instance.
    """

    def __init__(
        self, block: UwbBlock, anchors: Mapping[int, Array], settings: RangeSettings, prior: TagFix | None = None
    ) -> None:
        self.block, self.anchors, self.settings = block, dict(anchors), settings
        self.check = RangeCheck(settings)
        self.fix: TagFix | None = None
        self._prior, self._fixed_ns = prior, 0
        self._held: deque[UwbRange] = deque()

    def add(self, reading: UwbRange) -> tuple[TagFix | None, Verdict | None]:
        """Take a reading in; the fix at its time, if there is one, and what the check said once it could compare."""
        verdict = self._judge(reading)
        if verdict is None or not verdict.refused:
            self._held.append(reading)
        while self._held and reading.stamp_ns - self._held[0].stamp_ns > self.settings.together_s * 1e9:
            self._held.popleft()
        if len({held.anchor for held in self._held}) < 3:
            return None, verdict
        std = np.full(len(self._held), self.block.range_std)
        ages = np.array([(reading.stamp_ns - held.stamp_ns) * 1e-9 for held in self._held])
        anchors = np.array([self.anchors[held.anchor] for held in self._held])
        ranges = Ranges(anchors, np.array([held.distance for held in self._held]), std, ages)
        self.fix, self._fixed_ns = find_tag(ranges, prior=self._near(reading.stamp_ns)), reading.stamp_ns
        return self.fix, verdict

    def _judge(self, reading: UwbRange) -> Verdict | None:
        since_s = (reading.stamp_ns - self._fixed_ns) * 1e-9
        if self.fix is None or since_s > self.settings.memory_s:
            return None
        away = self.fix.p_map - self.anchors[reading.anchor]
        distance = float(np.linalg.norm(away))
        known = np.sqrt(away @ self.fix.covariance @ away) / distance
        moved = self.settings.max_speed * since_s
        return self.check.judge(reading, distance, float(np.hypot(known, moved)), self.block.range_std)

    def _near(self, stamp_ns: int) -> TagFix | None:
        """The prior, and so near the last fix that the mirror image behind the anchors is not taken for the tag."""
        if self.fix is None or (stamp_ns - self._fixed_ns) * 1e-9 > self.settings.memory_s:
            return self._prior
        reach = self.settings.max_speed * self.settings.memory_s
        near = TagFix(self.fix.p_map, reach**2 * np.eye(3), np.zeros(0))
        return near if self._prior is None else _both(near, self._prior)


def _both(a: TagFix, b: TagFix) -> TagFix:
    """What two independent fixes say together."""
    A, B = np.linalg.inv(a.covariance), np.linalg.inv(b.covariance)
    covariance = np.asarray(np.linalg.inv(A + B), dtype=np.float64)
    return TagFix(covariance @ (A @ a.p_map + B @ b.p_map), covariance, np.zeros(0))
