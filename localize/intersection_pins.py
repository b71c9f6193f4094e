"""Intersections pin the track: keyframes are looked at, what they saw is judged, and the verdicts are followed."""

from __future__ import annotations

from collections.abc import Callable

from localize.beside import RecognitionBeside
from localize.frames import shifted
from localize.hypotheses import carried
from localize.journal import Journal
from localize.keyframes import Keyframe, Keyframes, stacked
from localize.matcher import Expected, IntersectionMatcher, Looked, Place, Sight
from localize.recognition import Recognition, Verdict
from localize.results import Event, Overlay
from localize.settings import LocalizeSettings
from localize.track import Track
from semmap.geometry import Array, inverse


class IntersectionPins:
    """From keyframes to pose factors by intersections of the map.

    Parameters
    ----------
    matcher : recognises them. shift : (3,) origin that the track's numbers are relative to.
    """

    def __init__(
        self, matcher: IntersectionMatcher, settings: LocalizeSettings, track: Track, journal: Journal, shift: Array
    ) -> None:
        self._track, self._journal, self._shift = track, journal, shift
        self._matcher = matcher
        self._recognition = Recognition(settings.proof)
        self._beside = RecognitionBeside[Looked](settings.matcher.lag_scans)
        self._judged = -1
        """The last keyframe of the leg of which it is known what it saw."""

    def end_leg(self) -> None:
        """What was seen last no longer tells where the robot is, but may be new."""
        for _, looked in self._beside.due():
            self._learn(looked, self._track.leg.odometry[-1][0])

    def begin_leg(self) -> None:
        """The odometry begins anew, wherever the robot is."""
        self._recognition.forget()
        self._matcher.forget()
        self._judged = -1

    def look(self, keyframes: Keyframes) -> None:
        """Have the last of the keyframes looked at, in view of where the robot is, or may be, as far as is known."""
        self._beside.look(keyframes.last[-1], self._journal.counts["scans"], self._looking(keyframes))

    def _looking(self, keyframes: Keyframes) -> Callable[[], Looked]:
        stack, track, others = keyframes.last, self._track.at, self._others()
        return lambda: Looked(self._matcher.recognise(stacked(stack), stack[-1], track, others))

    def _others(self) -> list[Expected]:
        """Where the newest keyframe is, or may be."""
        track = self._track
        if track.at is not None:
            return [track.at]
        others = self._recognition.hypotheses.expected
        for index in range(self._judged + 1, len(track.graph)):
            others = [carried(at, *track.graph.link(index)) for at in others]
        return others

    def judge(self) -> bool:
        """Decide what keyframes saw whose time has come; whether that pinned the track."""
        return self._judge(self._beside.due(self._journal.counts["scans"]))

    def finish(self) -> None:
        """Decide what all keyframes saw, and end."""
        self._judge(self._beside.due())
        self._beside.close()

    def _judge(self, looks: list[tuple[Keyframe, Looked]]) -> bool:
        track, pinned = self._track, False
        for keyframe, looked in looks:
            self._journal.counts["intersections_seen"] += len(looked.sights)
            self._judged = keyframe.index - track.leg.first_keyframe
            if self._judged > 0:
                self._recognition.hypotheses.carry(*track.graph.link(self._judged))
            for sight in looked.sights:
                verdict = self._verdict(sight, keyframe.index - track.leg.first_keyframe)
                stamp_ns = track.leg.odometry[-1][0]
                told = {**verdict.event, "stamp_ns": stamp_ns, **self._lay_over(sight)}
                self._journal.events.append({**told, "pins": [self._told(pin) for pin in verdict.pins]})
                self._follow(verdict, stamp_ns)
                pinned |= bool(verdict.pins)
            self._learn(looked, track.leg.odometry[-1][0])
        return pinned

    def _lay_over(self, sight: Sight) -> Event:
        """Keep what the check compared, at the most like place; returns its number for the event."""
        if not sight.places:
            return {}
        best = sight.places[0]
        T_map_imu = shifted(best.T_map_imu[None], self._shift)[0]
        self._journal.overlays.append(Overlay(best.intersection, T_map_imu, sight.points))
        return {"overlay": len(self._journal.overlays) - 1}

    def _verdict(self, sight: Sight, index: int) -> Verdict:
        """What a sight of the leg's keyframe ``index`` means."""
        return self._recognition.judge(sight, self._expected(sight, index))

    def _expected(self, sight: Sight, index: int) -> Expected | None:
        return self._track.expected(index)

    def _learn(self, looked: Looked, stamp_ns: int) -> None:
        """The map knows all that there is to see."""

    def _told(self, pin: Place) -> Event:
        """A pin for the events."""
        p_map = (pin.T_map_imu[:3, 3] + self._shift).round(3).tolist()
        stamp_ns, _ = self._track.keyframes[pin.keyframe - self._track.leg.first_keyframe]
        return {"stamp_ns": stamp_ns, "keyframe": pin.keyframe, "id": pin.intersection, "p_map": p_map}

    def _follow(self, verdict: Verdict, stamp_ns: int) -> None:
        """Do what a verdict says."""
        if verdict.elsewhere:
            self._leave_track(verdict.pins, stamp_ns)
        if verdict.pins:
            self._pin(verdict.pins, stamp_ns)
            self._journal.enter("tracking", stamp_ns, "intersection proven")
        elif verdict.doubt and self._journal.state == "tracking":
            self._journal.enter("suspect", stamp_ns, verdict.doubt)

    def _leave_track(self, pins: tuple[Place, ...], stamp_ns: int) -> None:
        """The robot is proven to be elsewhere: the track ended somewhere, or was wrong if one intersection made it."""
        self._journal.enter("lost", stamp_ns, "the robot is proven to be elsewhere")
        before = self._track.leave(pins[0].keyframe)
        self._judged -= self._track.leg.first_keyframe - before.first_keyframe
        if len(before.pinned) < 2:
            self._journal.counts["pins"] -= before.graph.pins
            self._journal.recognised -= before.pinned
            before.graph.unanchor()

    def _pin(self, pins: tuple[Place, ...], stamp_ns: int) -> None:
        track, leg, last = self._track, self._track.leg, pins[-1]
        if not track.graph.anchored:
            T_odom_imu = leg.unmoved[last.keyframe - leg.first_keyframe]
            track.anchor(last.T_map_imu @ inverse(T_odom_imu), stamp_ns, "intersection")
        self._journal.recognised.update(pin.intersection for pin in pins)
        for pin in pins:
            index = pin.keyframe - leg.first_keyframe
            leg.graph.pin_intersection(index, pin.intersection, pin.T_map_intersection, pin.T_map_imu, pin.covariance)
            leg.last_pin_ns = max(leg.last_pin_ns, leg.keyframes[index][0])
            leg.pinned.add(pin.intersection)
            self._journal.counts["pins"] += 1
        track.solve()
