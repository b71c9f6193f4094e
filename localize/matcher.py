"""From stacked keyframes to a proven intersection: the nine steps of paper 004 section 3.2."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from descriptors.index import ContourIndex, Match
from localize.keyframes import Keyframe, Stack
from localize.results import Event
from localize.settings import LocalizeSettings
from localize.verification import Verification, Verifier
from maps.observe import ObservedIntersection, observe_intersections
from maps.settings import MapSettings
from maps.views import View
from semmap.errors import DatabaseError
from semmap.geometry import Array, adjoint, inverse, rotation_angle, se3, transform, yaw_of
from semmap.intersections import SemanticMap
from semmap.settings import validate

_SAME_PLACE_M = 4.0
"""Observations closer than this in odom are of one intersection."""
_APART_M = 2.0
"""Keyframes at least this far apart count as independent views."""
_MAX_TURN_RAD = 0.15
"""Places found from different keyframes must agree on the heading this well."""


@dataclass(frozen=True, slots=True)
class Pin:
    """A proven pose ``T_map_imu`` of a keyframe (numbers relative to the map's origin), covariance rotation first."""

    keyframe: int
    intersection: int
    T_map_imu: Array
    T_map_odom: Array
    covariance: Array
    fit: float


@dataclass(frozen=True, slots=True)
class Recognition:
    """What one keyframe said: intersections seen, pins proven, whether a proof contradicts the track, events."""

    seen: int
    pins: tuple[Pin, ...]
    contradicts: bool
    events: tuple[Event, ...]


@dataclass(frozen=True, slots=True)
class _Look:
    """One observed intersection of one keyframe's stack."""

    observation: ObservedIntersection
    stack: Stack
    keyframe: Keyframe

    @property
    def p_odom(self) -> Array:
        """Where it is in odom (3,)."""
        p_odom: Array = transform(self.stack.T_odom_local, self.observation.p[None])[0]
        return p_odom


@dataclass(slots=True)
class _Sight:
    """An intersection seen from several keyframes: how often in a row the same one was matched (N_same)."""

    p_odom: Array
    matched: int = -1
    same: int = 0


class IntersectionMatcher:
    """Recognises intersections of a semantic map.

    Parameters
    ----------
    semantic_map : the database. settings : thresholds. origin : (3,) subtracted from map coordinates.
    """

    def __init__(self, semantic_map: SemanticMap, settings: LocalizeSettings, origin: Array) -> None:
        self.settings = settings
        self._origin = origin
        self._intersections = semantic_map.intersections
        self._ids = semantic_map.columns.id
        self._p_map = semantic_map.p_map - origin
        self._map_settings = validate(MapSettings, dict(semantic_map.settings), file=None, error=DatabaseError)
        self._index = ContourIndex(semantic_map.contours, self._map_settings.contour)
        self._verifier = Verifier(settings.verification)
        self._sights: list[_Sight] = []
        self._unconfirmed: deque[tuple[Array, Pin]] = deque(maxlen=20)
        self._contradictions: list[Pin] = []

    def recognise(self, stack: Stack, keyframe: Keyframe, T_map_odom: Array | None, position_std: float) -> Recognition:
        """The nine steps for one keyframe; ``T_map_odom`` and its standard deviation [m] where the map is known."""
        views = [View(cloud, sensor) for cloud, sensor in zip(stack.clouds, stack.sensors, strict=True)]
        observed = observe_intersections(views, self._map_settings)  # steps 1 and 2
        pins: list[Pin] = []
        events: list[Event] = []
        contradicts = False
        looks = self._best_readings([_Look(one, stack, keyframe) for one in observed], T_map_odom, position_std)
        for look, matches in looks:
            event: Event = {"stamp_ns": keyframe.stamp_ns, "kind": "intersection", "keyframe": keyframe.index}
            pin, reason = self._decide(look, matches, event)  # steps 7 to 9
            if pin is not None:
                accepted, contradiction, reason = self._accept(pin, keyframe, T_map_odom, position_std)
                contradicts |= contradiction
                pins.extend(accepted)
                event["accepted"] = bool(accepted)
            event.setdefault("accepted", False)
            events.append({**event, "reason": reason})
        return Recognition(len(looks), tuple(pins), contradicts, tuple(events))

    def _best_readings(
        self, looks: list[_Look], T_map_odom: Array | None, position_std: float
    ) -> list[tuple[_Look, list[Match]]]:
        """Each place once, with its candidates (steps 3 to 6): of readings that share parts the one most alike."""
        read = [(look, self._candidates(look, T_map_odom, position_std)) for look in looks]
        read.sort(key=lambda pair: max((match.pwcv for match in pair[1]), default=0.0), reverse=True)
        taken: set[int] = set()
        best = []
        for look, matches in read:
            if taken.isdisjoint(look.observation.parts):
                taken |= look.observation.parts
                best.append((look, matches))
        return best

    def _candidates(self, look: _Look, T_map_odom: Array | None, position_std: float) -> list[Match]:
        """Intersections that look alike, best CWC first (steps 3 to 6); near the expected place where that is known."""
        m = self.settings.matcher
        allowed = np.ones(len(self._intersections), bool)
        heading = None
        if T_map_odom is not None:
            T_map_local = T_map_odom @ look.stack.T_odom_local
            expected = transform(T_map_local, look.observation.p[None])[0]
            allowed = np.linalg.norm(self._p_map - expected, axis=1) < m.search_radius + 3.0 * position_std
            heading = yaw_of(T_map_local[:3, :3])
        contour = look.observation.contour
        matches = self._index.turned(contour, m.min_pwcv, at_most=m.candidates, allowed=allowed, yaw=heading)
        return sorted(matches, key=lambda match: match.cwc, reverse=True)

    def _decide(self, look: _Look, matches: list[Match], event: Event) -> tuple[Pin | None, str]:
        """Count agreement in a row (steps 7, 8) and check the match by ICP against the runner-up (step 9)."""
        event["p_odom"] = look.p_odom.round(3).tolist()
        event["candidates"] = [
            {"id": self._id(match), "pwcv": round(match.pwcv, 4), "cwc": round(match.cwc, 4)} for match in matches
        ]
        if not matches:
            return None, "no intersection of the map is similar enough"
        best = matches[0]
        event["id"] = self._id(best)
        if best.cwc < self.settings.matcher.min_cwc:
            return None, "CWC similarity too small"
        sight = self._sight(look.p_odom)
        sight.same = sight.same + 1 if sight.matched == self._id(best) else 1
        sight.matched = self._id(best)
        event["consecutive"] = sight.same
        if sight.same < self.settings.matcher.consecutive:
            return None, "not yet seen often enough in a row"
        sight.same = 0
        return self._verify(look, matches, event)

    def _sight(self, p_odom: Array) -> _Sight:
        for sight in self._sights:
            if np.linalg.norm(sight.p_odom - p_odom) < _SAME_PLACE_M:
                sight.p_odom = p_odom
                return sight
        self._sights = [*self._sights[-20:], _Sight(p_odom)]
        return self._sights[-1]

    def _verify(self, look: _Look, matches: list[Match], event: Event) -> tuple[Pin | None, str]:
        v = self.settings.verification
        points, p = look.stack.points, look.observation.p
        checked = []
        for match in matches:
            intersection = self._intersections[match.row]
            checked.append(
                (match, self._verifier.verify(points, p, intersection, match.yaw, completeness=match.completeness))
            )
        checked.sort(key=lambda pair: pair[1].fit, reverse=True)
        best, verification = checked[0]
        rival = max((c.fit for _, c in checked[1:] if _elsewhere(c, verification)), default=0.0)
        event.update(
            id=self._id(best), fit=round(verification.fit, 4), icp_distance_m=round(verification.icp_distance, 4),
            runner_up_fit=round(rival, 4), completeness=round(best.completeness, 3),
        )  # fmt: skip
        if verification.points < v.min_points:
            return None, "too few points to compare"
        if verification.fit < v.min_fit:
            return None, "too few points fit the map"
        if verification.icp_distance > v.max_icp_distance:
            return None, "ICP distance too large"
        if verification.fit - rival < v.min_lead:
            return None, "another place fits nearly as well"
        return self._pin(look, best, verification), "fits"

    def _pin(self, look: _Look, best: Match, verification: Verification) -> Pin:
        stack, keyframe = look.stack, look.keyframe
        T_map_local = se3(verification.T_map_local[:3, :3], verification.T_map_local[:3, 3] - self._origin)
        T_map_odom = T_map_local @ inverse(stack.T_odom_local)
        T_imu_local = inverse(keyframe.T_odom_imu) @ stack.T_odom_local
        carried = adjoint(T_imu_local)
        g = self.settings.graph
        floor = np.diag(np.repeat([g.pin_rotation, g.pin_position], 3) ** 2)
        covariance = carried @ verification.covariance @ carried.T + floor
        T_map_imu = T_map_odom @ keyframe.T_odom_imu
        return Pin(keyframe.index, self._id(best), T_map_imu, T_map_odom, covariance, verification.fit)

    def _id(self, match: Match) -> int:
        return int(self._ids[match.row])

    def _accept(
        self, pin: Pin, keyframe: Keyframe, T_map_odom: Array | None, position_std: float
    ) -> tuple[list[Pin], bool, str]:
        """Beyond the paper: the first pin needs a second view that agrees; later ones must fit the track."""
        p_odom = keyframe.T_odom_imu[:3, 3]
        if T_map_odom is not None:
            if self._agree(pin.T_map_odom, T_map_odom, p_odom, 4.0 * position_std):
                self._contradictions.clear()
                return [pin], False, "fits, and agrees with the track"
            self._contradictions.append(pin)
            return [], len(self._contradictions) > 1, "fits, but contradicts the track"
        for p_other, other in self._unconfirmed:
            apart = np.linalg.norm(p_other - p_odom) > _APART_M
            if apart and self._distinct(pin, other) and self._agree(pin.T_map_odom, other.T_map_odom, p_odom, 0.0):
                self._unconfirmed.clear()
                return [other, pin], False, "fits, and a second view agrees"
        self._unconfirmed.append((p_odom, pin))
        return [], False, "fits; waiting for a second view to agree"

    def _distinct(self, pin: Pin, other: Pin) -> bool:
        """Whether two views prove a place: one look-alike fits twice, so a middling fit takes two."""
        sure = min(pin.fit, other.fit) >= self.settings.verification.sure_fit
        return sure or pin.intersection != other.intersection

    def _agree(self, T_a: Array, T_b: Array, p_odom: Array, slack: float) -> bool:
        here = np.linalg.norm(transform(T_a, p_odom[None]) - transform(T_b, p_odom[None]))
        turn = rotation_angle(T_a[:3, :3].T @ T_b[:3, :3])
        return bool(here < self.settings.verification.agreement + slack and turn < _MAX_TURN_RAD)


def _elsewhere(a: Verification, b: Verification) -> bool:
    """Whether two registrations put the robot at different places."""
    apart = np.linalg.norm(a.T_map_local[:3, 3] - b.T_map_local[:3, 3])
    return bool(apart > 1.0 or rotation_angle(a.T_map_local[:3, :3].T @ b.T_map_local[:3, :3]) > _MAX_TURN_RAD)
