"""Where the robot may be while that is not known: several hypotheses, until the intersections passed prove one.

Paper 004 believes a single ICP check. Rock that looks alike passes it: crossings of one drill plan, a corridor shifted
along itself, a map without the true place. So each place that passes is a hypothesis, the odometry carries it on with
its covariance, and every intersection seen speaks for it or against it until one leads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from localize.matcher import Expected, Place, Sight
from localize.settings import ProofSettings
from semmap.geometry import Array, adjoint, inverse, se3_log

_GATE = 27.9
"""Of chi-square with 6 degrees of freedom one in ten thousand is larger."""
_AT_MOST = 20
"""Hypotheses kept, those with the most evidence."""
_LOOKED_AFTER = 3
"""The first of them: what would be seen from there is looked for, similar or not."""


@dataclass(slots=True)
class Hypothesis:
    """One story of where the robot is.

    pins : the places that tell it. at : the robot now, carried on by the odometry. span : greatest distance between the
    first view and another [m].
    evidence : what each intersection says, by its id, or by minus the sight's number less one where it is none of it.
    """

    at: Expected
    pins: list[Place] = field(default_factory=list)
    span: float = 0.0
    p_odom_first: Array = field(default_factory=lambda: np.zeros(3))
    evidence: dict[int, float] = field(default_factory=dict)

    @property
    def total(self) -> float:
        """All evidence; 1 is a proof."""
        return sum(self.evidence.values())

    def support(self, place: Place, p_odom: Array, evidence: float) -> None:
        """Another place that fits it, seen by a keyframe at ``p_odom`` (3,)."""
        if not self.pins:
            self.p_odom_first = p_odom
        self.span = max(self.span, float(np.linalg.norm(p_odom - self.p_odom_first)))
        self.pins.append(place)
        self.at = Expected(place.T_map_imu, place.covariance)
        self.evidence[place.intersection] = max(evidence, self.evidence.get(place.intersection, evidence))


class Hypotheses:
    """All stories that what was seen allows, and the one that it proves."""

    def __init__(self, settings: ProofSettings) -> None:
        self.settings = settings
        self._stories: list[Hypothesis] = []

    def __len__(self) -> int:
        return len(self._stories)

    @property
    def expected(self) -> list[Expected]:
        """Where the robot most likely is."""
        return [story.at for story in self._stories[:_LOOKED_AFTER]]

    def clear(self) -> None:
        """Forget them all."""
        self._stories = []

    def carry(self, T_before_imu: Array, covariance: Array) -> None:
        """The robot moved on by a pose (4, 4) with covariance (6, 6), from one keyframe to the next."""
        for story in self._stories:
            story.at = carried(story.at, T_before_imu, covariance)

    def take(self, sight: Sight) -> Hypothesis | None:
        """What was seen from the newest keyframe; returns the hypothesis that is now proven."""
        fitting = [place for place in sight.places or () if place.fits]
        told = [story for story in self._stories if self._told(story, sight)]
        for place in fitting:
            if not any(story.pins[-1] is place for story in told):
                story = Hypothesis(Expected(place.T_map_imu, place.covariance))
                story.support(place, sight.p_odom_imu, self.evidence(place))
                self._stories.append(story)
        self._stories = sorted(_distinct(self._stories), key=lambda story: -story.total)[:_AT_MOST]
        return self._proven()

    def evidence(self, place: Place) -> float:
        """What a place says, 1 alone being a proof; negative if what is seen does not look like it."""
        s = self.settings
        return (place.likeness - s.no_likeness) / (s.sure_likeness - s.no_likeness)

    def agrees(self, place: Place, expected: Expected) -> bool:
        """Whether a place is where the robot was expected, within the covariance of both."""
        s = self.settings
        slack = np.diag(np.repeat([s.rotation_std, s.position_std], 3) ** 2)
        error = se3_log(inverse(expected.T_map_imu) @ place.T_map_imu)
        return bool(error @ np.linalg.solve(expected.covariance + place.covariance + slack, error) < _GATE)

    def _told(self, story: Hypothesis, sight: Sight) -> bool:
        """Whether a sight supports a hypothesis; if it shows what cannot be there, that counts against it."""
        places = [place for place in sight.places or () if self.agrees(place, story.at)]
        fitting = [place for place in places if place.fits]
        if fitting:
            best = max(fitting, key=lambda place: place.likeness)
            story.support(best, sight.p_odom_imu, self.evidence(best))
        elif places:
            worst = min(0.0, max(self.evidence(place) for place in places))
            key = -1 - sight.number
            story.evidence[key] = min(worst, story.evidence.get(key, 0.0))
        return bool(fitting)

    def _proven(self) -> Hypothesis | None:
        s = self.settings
        if not self._stories:
            return None
        best = self._stories[0]
        rival = max(0.0, self._stories[1].total) if len(self._stories) > 1 else 0.0
        sure = best.total >= 1.0 and best.total - rival >= s.lead
        return best if sure and best.span > s.apart else None


def carried(at: Expected, T_before_imu: Array, covariance: Array) -> Expected:
    """Where the robot is after a relative pose (4, 4) with covariance (6, 6)."""
    back = adjoint(inverse(T_before_imu))
    return Expected(at.T_map_imu @ T_before_imu, back @ at.covariance @ back.T + covariance)


def _distinct(stories: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Each story once: those that came to the same place by the same proof are one, the better founded."""
    best: dict[int, Hypothesis] = {}
    for story in stories:
        key = id(story.pins[-1])
        if key not in best or story.total > best[key].total:
            best[key] = story
    return list(best.values())
