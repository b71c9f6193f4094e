"""From stacked keyframes to a proven intersection: the nine steps of paper 004 section 3.2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from descriptors.index import ContourIndex
from localize.keyframes import Keyframe, Stack
from localize.results import Event
from localize.settings import LocalizeSettings
from localize.verification import Verification, Verifier
from maps.free_space import View
from maps.observe import ObservedIntersection, observe_intersections
from maps.settings import MapSettings
from semmap.geometry import Array, adjoint, inverse, rotation_angle, se3, transform, yaw_of
from semmap.intersections import Intersection, SemanticMap

_SAME_PLACE_M = 4.0
"""Observations closer than this in odom are of one intersection."""
_SAME_YAW_RAD = 0.35
_APART_M = 2.0
"""Keyframes at least this far apart count as independent views."""
_MAX_TURN_RAD = 0.15
"""Places found from different keyframes must agree on the heading this well."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """An observation might be this intersection, turned by ``yaw`` [rad]."""

    intersection: Intersection
    yaw: float
    pwcv: float
    cwc: float
    completeness: float


@dataclass(frozen=True, slots=True)
class Pin:
    """A proven pose ``T_map_imu`` of a keyframe (numbers relative to the map's origin), covariance rotation first."""

    keyframe: int
    intersection: int
    T_map_imu: Array
    T_map_odom: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class Recognition:
    """What one keyframe said: intersections seen, pins proven, whether a proof contradicts the track, events."""

    seen: int
    pins: tuple[Pin, ...]
    contradicts: bool
    events: tuple[Event, ...]


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
        self._p_map = np.array([i.p_map - origin for i in self._intersections]).reshape(-1, 3)
        self._map_settings = MapSettings.model_validate(dict(semantic_map.settings))
        self._index = ContourIndex([i.contour for i in self._intersections], self._map_settings.contour)
        self._verifier = Verifier(settings.verification)
        self._sights: list[_Sight] = []
        self._unconfirmed: list[tuple[Array, Pin]] = []
        self._contradictions: list[Pin] = []

    def recognise(
        self, stack: Stack, keyframe: Keyframe, T_map_odom: Array | None, position_std: float
    ) -> Recognition:
        """The nine steps for one keyframe; ``T_map_odom`` and its standard deviation [m] where the map is known."""
        views = [View(cloud, sensor) for cloud, sensor in zip(stack.clouds, stack.sensors, strict=True)]
        observed = observe_intersections(views, self._map_settings)  # steps 1 and 2
        pins: list[Pin] = []
        events: list[Event] = []
        contradicts = False
        for observation in observed:
            event: Event = {"stamp_ns": keyframe.stamp_ns, "kind": "intersection", "keyframe": keyframe.index}
            hypotheses = self._candidates(observation, stack, T_map_odom, position_std)  # steps 3 to 6
            pin, reason = self._decide(observation, stack, keyframe, hypotheses, event)  # steps 7 to 9
            if pin is not None:
                accepted, contradiction, reason = self._accept(pin, keyframe, T_map_odom, position_std)
                contradicts |= contradiction
                pins.extend(accepted)
                event["accepted"] = bool(accepted)
            event.setdefault("accepted", False)
            events.append({**event, "reason": reason})
        return Recognition(len(observed), tuple(pins), contradicts, tuple(events))

    def _candidates(
        self, observation: ObservedIntersection, stack: Stack, T_map_odom: Array | None, position_std: float
    ) -> list[Hypothesis]:
        """Intersections that look alike, best CWC first (steps 3 to 6); near the expected place where that is known."""
        m = self.settings.matcher
        allowed = np.ones(len(self._intersections), bool)
        heading = None
        if T_map_odom is not None:
            T_map_local = T_map_odom @ stack.T_odom_local
            expected = transform(T_map_local, observation.p[None])[0]
            allowed = np.linalg.norm(self._p_map - expected, axis=1) < m.search_radius + 3.0 * position_std
            heading = yaw_of(T_map_local[:3, :3])
        hypotheses = []
        for match in self._index.best(observation.contour, m.candidates, allowed):
            off = 0.0 if heading is None else abs(np.angle(np.exp(1j * (match.yaw - heading))))
            if match.pwcv >= m.min_pwcv and off < _SAME_YAW_RAD:
                hypotheses.append(
                    Hypothesis(
                        self._intersections[match.row], match.yaw, match.pwcv, match.cwc, match.completeness
                    )
                )
        return sorted(hypotheses, key=lambda h: h.cwc, reverse=True)

    def _decide(
        self,
        observation: ObservedIntersection,
        stack: Stack,
        keyframe: Keyframe,
        hypotheses: list[Hypothesis],
        event: Event,
    ) -> tuple[Pin | None, str]:
        """Count agreement in a row (steps 7, 8) and check the match by ICP against the runner-up (step 9)."""
        event["p_odom"] = transform(stack.T_odom_local, observation.p[None])[0].round(3).tolist()
        event["candidates"] = [
            {"id": h.intersection.id, "pwcv": round(h.pwcv, 4), "cwc": round(h.cwc, 4)} for h in hypotheses
        ]
        if not hypotheses:
            return None, "no intersection of the map is similar enough"
        best = hypotheses[0]
        event["id"] = best.intersection.id
        if best.cwc < self.settings.matcher.min_cwc:
            return None, "CWC similarity too small"
        sight = self._sight(np.array(event["p_odom"]))
        sight.same = sight.same + 1 if sight.matched == best.intersection.id else 1
        sight.matched = best.intersection.id
        event["consecutive"] = sight.same
        if sight.same < self.settings.matcher.consecutive:
            return None, "not yet seen often enough in a row"
        sight.same = 0
        return self._verify(observation, stack, keyframe, hypotheses, event)

    def _sight(self, p_odom: Array) -> _Sight:
        for sight in self._sights:
            if np.linalg.norm(sight.p_odom - p_odom) < _SAME_PLACE_M:
                sight.p_odom = p_odom
                return sight
        self._sights = [*self._sights[-20:], _Sight(p_odom)]
        return self._sights[-1]

    def _verify(
        self,
        observation: ObservedIntersection,
        stack: Stack,
        keyframe: Keyframe,
        hypotheses: list[Hypothesis],
        event: Event,
    ) -> tuple[Pin | None, str]:
        v = self.settings.verification
        points = stack.points
        checked = [
            (h, self._verifier.verify(points, observation.p, h.intersection, h.yaw, completeness=h.completeness))
            for h in hypotheses
        ]
        checked.sort(key=lambda pair: pair[1].fit, reverse=True)
        best, verification = checked[0]
        rival = max((c.fit for h, c in checked[1:] if _elsewhere(c, verification)), default=0.0)
        event.update(
            id=best.intersection.id, fit=round(verification.fit, 4), icp_distance_m=round(verification.icp_distance, 4),
            runner_up_fit=round(rival, 4), completeness=round(best.completeness, 3),
        )  # fmt: skip
        if verification.fit < v.min_fit:
            return None, "too few points fit the map"
        if verification.icp_distance > v.max_icp_distance:
            return None, "ICP distance too large"
        if verification.fit - rival < v.min_lead:
            return None, "another place fits nearly as well"
        return self._pin(verification, best, stack, keyframe), "fits"

    def _pin(self, verification: Verification, best: Hypothesis, stack: Stack, keyframe: Keyframe) -> Pin:
        T_map_local = se3(verification.T_map_local[:3, :3], verification.T_map_local[:3, 3] - self._origin)
        T_map_odom = T_map_local @ inverse(stack.T_odom_local)
        T_imu_local = inverse(keyframe.T_odom_imu) @ stack.T_odom_local
        carried = adjoint(T_imu_local)
        g = self.settings.graph
        floor = np.diag(np.repeat([g.pin_rotation, g.pin_position], 3) ** 2)
        covariance = carried @ verification.covariance @ carried.T + floor
        return Pin(keyframe.index, best.intersection.id, T_map_odom @ keyframe.T_odom_imu, T_map_odom, covariance)

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
            if apart and self._agree(pin.T_map_odom, other.T_map_odom, p_odom, 0.0):
                self._unconfirmed.clear()
                return [other, pin], False, "fits, and a second view agrees"
        self._unconfirmed.append((p_odom, pin))
        return [], False, "fits; waiting for a second view to agree"

    def _agree(self, T_a: Array, T_b: Array, p_odom: Array, slack: float) -> bool:
        here = np.linalg.norm(transform(T_a, p_odom[None]) - transform(T_b, p_odom[None]))
        turn = rotation_angle(T_a[:3, :3].T @ T_b[:3, :3])
        return bool(here < self.settings.verification.agreement + slack and turn < _MAX_TURN_RAD)


def _elsewhere(a: Verification, b: Verification) -> bool:
    """Whether two registrations put the robot at different places."""
    apart = np.linalg.norm(a.T_map_local[:3, 3] - b.T_map_local[:3, 3])
    return bool(apart > 1.0 or rotation_angle(a.T_map_local[:3, :3].T @ b.T_map_local[:3, :3]) > _MAX_TURN_RAD)
