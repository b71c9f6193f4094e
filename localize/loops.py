"""Loops: intersections found on the way and seen again pin the track to itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from localize.finding import IntersectionFinder
from localize.graph import PoseGraph
from localize.intersection_pins import IntersectionPins
from localize.journal import Journal
from localize.keyframes import Keyframes
from localize.known import Found
from localize.matcher import Expected, Looked, Place, Sight
from localize.recognition import Verdict
from localize.results import Event
from localize.settings import LocalizeSettings
from localize.track import Track
from semmap.geometry import Array, adjoint, inverse


class LoopPins(IntersectionPins):
    """From keyframes to the run's own intersections, and to pose factors by those that are seen again.

    An intersection is a variable of the graph, tied to a keyframe of its first passage. A later view is proven as one
    of a map is (`Recognition`), against what the odometry, and loops closed before, know of the way since. What
    contradicts that is refused: the odometry says when it breaks off.
    """

    def __init__(self, settings: LocalizeSettings, track: Track, journal: Journal, shift: Array) -> None:
        self._finder = IntersectionFinder(settings)
        super().__init__(self._finder, settings, track, journal, shift)
        self._floor = np.diag(np.repeat([settings.graph.pin_rotation, settings.graph.pin_position], 3) ** 2)
        self._found: dict[int, tuple[PoseGraph, int]] = {}
        """The graph that an intersection is a variable of, and the index of its keyframe there."""

    def _looking(self, keyframes: Keyframes) -> Callable[[], Looked]:
        stack, kept, track, others = keyframes.last, keyframes.kept, self._track.at, self._others()
        T_map = {id: graph.intersection(id) for id, (graph, _) in self._found.items()}
        return lambda: self._finder.look(stack, kept, track, others, T_map)

    def _lay_over(self, sight: Sight) -> Event:
        """Nothing: there is no map that a reader could lay it over."""
        return {}

    def _verdict(self, sight: Sight, index: int) -> Verdict:
        places = sight.places and tuple(self._moved(place) for place in sight.places)
        verdict = super()._verdict(replace(sight, places=places), index)
        if not verdict.elsewhere:
            return verdict
        event = {**verdict.event, "accepted": False, "reason": "proven, but contradicts the odometry"}
        return Verdict((), False, "", event)

    def _moved(self, place: Place) -> Place:
        """A place as it lies after what moved its intersection since the look."""
        graph, _ = self._found[place.intersection]
        T_map_intersection = graph.intersection(place.intersection)
        T_map_imu = T_map_intersection @ inverse(place.T_map_intersection) @ place.T_map_imu
        return replace(place, T_map_imu=T_map_imu, T_map_intersection=T_map_intersection)

    def _expected(self, sight: Sight, index: int) -> Expected | None:
        """Where a keyframe is, and how well that is known relative to the intersection that it seems to see."""
        expected = super()._expected(sight, index)
        if expected is None or not sight.places:
            return expected
        place = sight.places[0]
        graph, first = self._found[place.intersection]
        back = adjoint(inverse(expected.T_map_imu) @ place.T_map_intersection)
        covariances = [expected.covariance + back @ graph.intersection_covariance(place.intersection) @ back.T]
        if graph is self._track.graph:
            covariances.append(graph.way_covariance(first, index))
        return Expected(expected.T_map_imu, min(covariances, key=lambda covariance: np.trace(covariance[3:, 3:])))

    def _learn(self, looked: Looked, stamp_ns: int) -> None:
        """Those left behind become variables of the graph."""
        for found, T_map_cloud in looked.found:
            self._add(found)
            p_map = (T_map_cloud[:3, 3] + self._shift).round(3).tolist()
            seen_ns, _ = self._track.keyframes[found.keyframe - self._track.leg.first_keyframe]
            seen = {"keyframe_ns": seen_ns, "p_imu": found.T_imu_intersection[:3, 3].round(3).tolist()}
            id, kind = found.intersection.id, found.intersection.kind
            self._journal.event(stamp_ns, "intersection_found", id=id, type=kind, p_map=p_map, **seen)
            self._journal.counts["intersections_found"] += 1

    def _told(self, pin: Place) -> Event:
        """With where the intersection is from the keyframe: the same point of the mine whenever it is right."""
        p_imu = (inverse(pin.T_map_imu) @ pin.T_map_intersection)[:3, 3]
        return {**super()._told(pin), "p_imu": p_imu.round(3).tolist()}

    def _add(self, found: Found) -> None:
        leg, graph = self._track.leg, self._track.graph
        first, last = found.keyframe - leg.first_keyframe, found.last - leg.first_keyframe
        T_intersection_last = inverse(graph.pose(first) @ found.T_imu_intersection) @ graph.pose(last)
        carry = adjoint(T_intersection_last)
        covariance = self._floor + carry @ graph.way_covariance(first, last) @ carry.T
        graph.add_intersection(found.intersection.id, first, found.T_imu_intersection, covariance)
        self._found[found.intersection.id] = (graph, first)
        self._track.solve()

    def _follow(self, verdict: Verdict, stamp_ns: int) -> None:
        if not verdict.pins:
            return
        lost = not self._track.graph.anchored
        self._pin(verdict.pins, stamp_ns)
        if lost and self._journal.state != "unknown":
            self._journal.enter("tracking", stamp_ns, "an intersection of before proven")
