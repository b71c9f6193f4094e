"""Decides what a seen intersection means: a pin, a doubt about the track, or that the robot is elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from localize.hypotheses import Hypotheses
from localize.matcher import Expected, Place, Sight
from localize.results import Event
from localize.settings import ProofSettings
from semmap.geometry import Array

_MISSES = 2
"""Intersections in a row that are where the map has one, but do not fit it: then the track is in doubt."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a sight means.

    pins : places that hold from now on. elsewhere : they refute the track. doubt : why the track is in doubt, or empty.
    event : the sight's scores and the reason.
    """

    pins: tuple[Place, ...]
    elsewhere: bool
    doubt: str
    event: Event


class Recognition:
    """Judges sights against the track, and against one another while there is none or it is in doubt."""

    def __init__(self, settings: ProofSettings) -> None:
        self.settings = settings
        self.hypotheses = Hypotheses(settings)
        self._missed: set[int] = set()

    def forget(self) -> None:
        """The robot may be anywhere."""
        self.hypotheses.clear()
        self._missed.clear()

    def judge(self, sight: Sight, track: Expected | None) -> Verdict:
        """What ``sight`` means; ``track`` is where the robot is taken to be, None while that is not known."""
        if not sight.places:
            return _verdict(sight, sight.reason)
        pin, reason = self._agreeing(sight.places, track) if track is not None else (None, "")
        if pin is not None:
            self.forget()
            return _verdict(sight, reason, (pin,))
        proven = self.hypotheses.take(sight)
        if proven is not None:
            pins, agrees = tuple(proven.pins), track is not None and self.hypotheses.agrees(proven.pins[-1], track)
            self.forget()
            told = f"fits, with evidence of {proven.total:.2f} from {len(proven.evidence)} intersections"
            return _verdict(sight, told, pins, elsewhere=track is not None and not agrees)
        reason = sight.reason or reason or "fits; not yet enough evidence against other places"
        return _verdict(sight, reason, doubt=self._doubt(sight, track) if track is not None else "")

    def _agreeing(self, places: Sequence[Place], track: Expected) -> tuple[Place | None, str]:
        """The place that fits where the robot is taken to be, if that is known well enough to leave only one."""
        s = self.settings
        agreeing = [place for place in places if place.fits and self.hypotheses.agrees(place, track)]
        if not agreeing:
            return None, "fits, but contradicts the track"
        best = agreeing[0]
        if track.position_std > s.max_position_std:
            return None, "fits, but the track is not sure enough to tell it from others"
        lead = self.hypotheses.evidence(best) - max(
            (self.hypotheses.evidence(place) for place in agreeing[1:] if _apart(place, best)), default=-np.inf
        )
        if lead < s.lead:
            return None, "another place fits nearly as well"
        return best, "fits, and agrees with the track"

    def _doubt(self, sight: Sight, track: Expected) -> str:
        places = sight.places or ()
        here = [place for place in places if self.hypotheses.agrees(place, track)]
        if any(place.fits and self.hypotheses.evidence(place) >= 1.0 for place in places if place not in here):
            return "an intersection fits elsewhere"
        if here and not any(place.fits for place in here):
            self._missed.add(sight.number)
        return "intersections do not fit the map here" if len(self._missed) >= _MISSES else ""


def _apart(a: Place, b: Place) -> bool:
    apart: Array = a.T_map_imu[:3, 3] - b.T_map_imu[:3, 3]
    return bool(np.linalg.norm(apart) > 1.0)


def _verdict(
    sight: Sight, reason: str, pins: tuple[Place, ...] = (), *, elsewhere: bool = False, doubt: str = ""
) -> Verdict:
    return Verdict(pins, elsewhere, doubt, {**sight.event, "accepted": bool(pins), "reason": reason})
