"""From stacked keyframes to places where the robot may be: steps 1 to 9 of paper 004 section 3.2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from descriptors.index import Match
from localize.keyframes import Keyframe, Stack
from localize.known import Found, KnownIntersections
from localize.results import Event
from localize.settings import LocalizeSettings
from localize.verification import Verification, Verifier, start_of
from maps.observe import ObservedIntersection, observe_intersections
from maps.views import View
from semmap.geometry import Array, adjoint, inverse, transform, yaw_of

SAME_PLACE_M = 4.0
"""Observations closer than this in odom are of one intersection."""
_MAX_SIGHTS = 50
"""Intersections seen last that are remembered."""
_NEARLY = 0.15
"""Candidates less like by more than this after a first look are not looked at twice."""


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """Where the robot may be as known before: ``T_map_imu`` (4, 4) of the keyframe, numbers relative to the map's
    origin, covariance (6, 6) rotation first, perturbed on the right."""

    T_map_imu: Array
    covariance: Array

    @property
    def position_std(self) -> float:
        """In all directions together [m]."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where a keyframe is if what it saw is a certain intersection: that intersection's answer to the ICP check.

    T_map_imu, covariance : as in `Expected`. T_map_intersection : (4, 4) of the intersection, axes of the map.
    fit, likeness, icp_distance : see `Verification`. fits : whether it passes the ICP check (step 9).
    """

    keyframe: int
    intersection: int
    T_map_imu: Array
    covariance: Array
    T_map_intersection: Array
    fit: float
    likeness: float
    icp_distance: float
    fits: bool


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What a keyframe said of one intersection that it saw.

    number : of the intersection among those seen, the same whenever it is seen again from nearby.
    places : most like first; empty where nothing is similar, None before it was seen often enough in a row (step 8).
    event : its scores, for ``events.jsonl``; reason : how far it got.
    points : (n, 3) float32 that the ICP check compared, in the imu frame of the keyframe [m].
    """

    number: int
    keyframe: int
    p_odom_imu: Array
    places: tuple[Place, ...] | None
    event: Event
    reason: str
    points: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), np.float32))


@dataclass(frozen=True, slots=True)
class Looked:
    """What a keyframe saw; and the intersections that were left behind as of it, with their place (4, 4) in the map."""

    sights: list[Sight]
    found: tuple[tuple[Found, Array], ...] = ()


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

    @property
    def T_imu_local(self) -> Array:
        """(4, 4) from the stack's frame to the keyframe's."""
        T: Array = inverse(self.keyframe.T_odom_imu) @ self.stack.T_odom_local
        return T


@dataclass(frozen=True, slots=True)
class _Candidate:
    """An intersection to be checked by ICP, from a start (4, 4) in the frame of its cloud."""

    row: int
    start: Array
    completeness: float


@dataclass(slots=True)
class _Seen:
    """An intersection seen from several keyframes, and how often in a row each of the map's was a match (N_same)."""

    number: int
    p_odom: Array
    same: dict[int, int] = field(default_factory=dict)


class IntersectionMatcher:
    """Recognises intersections that are known.

    Parameters
    ----------
    known : the database. settings : thresholds.
    """

    def __init__(self, known: KnownIntersections, settings: LocalizeSettings) -> None:
        self.known, self.settings = known, settings
        self._verifier = Verifier(settings.verification)
        self._seen: list[_Seen] = []
        self._count = 0

    def forget(self) -> None:
        """What was seen is no longer where it was: odom begins anew."""
        self._seen = []

    def recognise(
        self, stack: Stack, keyframe: Keyframe, track: Expected | None, others: Sequence[Expected] = ()
    ) -> list[Sight]:
        """Steps 1 to 9 for one keyframe.

        track : where it is, if that is known: only what fits there is looked for, and all the map if nothing does.
        others : where it may be: what would be seen there is checked along with what looks similar.
        """
        observed = observe_intersections(views_of(stack), self.known.settings)  # steps 1 and 2
        looks = [_Look(one, stack, keyframe) for one in observed]
        return [self._sight(look, matches, track, others) for look, matches in self._best_readings(looks, track)]

    def _best_readings(self, looks: list[_Look], track: Expected | None) -> list[tuple[_Look, list[Match]]]:
        """Each place once, with its candidates (steps 3 to 6): of readings that share parts the one most alike."""
        read = [(look, self._similar(look, track)) for look in looks]
        read.sort(key=lambda pair: max((match.pwcv for match in pair[1]), default=0.0), reverse=True)
        taken: set[int] = set()
        best = []
        for look, matches in read:
            if taken.isdisjoint(look.observation.parts):
                taken |= look.observation.parts
                best.append((look, matches))
        return best

    def _similar(self, look: _Look, track: Expected | None) -> list[Match]:
        """Intersections that look alike, best CWC first (steps 3 to 6); near the expected place where that is known."""
        m = self.settings.matcher
        allowed, heading = self.known.visible, None
        if track is not None:
            T_map_local = track.T_map_imu @ look.T_imu_local
            allowed = self._distances(look, track) < m.search_radius + 3.0 * track.position_std
            heading = yaw_of(T_map_local[:3, :3])
        contour = look.observation.contour
        matches = self.known.index.turned(contour, m.min_pwcv, at_most=m.candidates, allowed=allowed, yaw=heading)
        alike = [match for match in matches if match.cwc >= m.min_cwc]
        return sorted(alike, key=lambda match: match.cwc, reverse=True)

    def _distances(self, look: _Look, expected: Expected) -> Array:
        """Of all intersections from where the one seen is expected in the map (n,) [m], infinite if not looked for."""
        p_map = transform(expected.T_map_imu @ look.T_imu_local, look.observation.p[None])[0]
        distances: Array = np.linalg.norm(self.known.p_map - p_map, axis=1)
        return np.where(self.known.visible, distances, np.inf)

    def _sight(self, look: _Look, matches: list[Match], track: Expected | None, others: Sequence[Expected]) -> Sight:
        """Count agreement in a row (steps 7, 8), then check all candidates by ICP (step 9)."""
        keyframe, seen = look.keyframe, self._seen_before(look.p_odom)
        event: Event = {
            "stamp_ns": keyframe.stamp_ns, "kind": "intersection", "keyframe": keyframe.index, "sight": seen.number,
            "p_odom": look.p_odom.round(3).tolist(),
            "candidates": [{"id": self._id(m.row), "pwcv": round(m.pwcv, 4), "cwc": round(m.cwc, 4)} for m in matches],
        }  # fmt: skip
        ids = {self._id(match.row) for match in matches}
        seen.same = {id: seen.same.get(id, 0) + 1 for id in sorted(ids) or [-1]}
        event["consecutive"] = max(seen.same.values())
        places: list[Place] | None = None
        points = np.zeros((0, 3))
        reason = "not yet seen often enough in a row"
        if event["consecutive"] >= self.settings.matcher.consecutive:
            seen.same = {}
            points = self._verifier.around(look.stack.points, look.observation.p)
            places = self._checked(look, points, self._candidates(look, matches, others))
            if track is not None and not any(place.fits for place in places):
                places += self._checked(look, points, self._candidates(look, self._similar(look, None), ()))
            places.sort(key=lambda place: place.likeness, reverse=True)
            reason = _reason(places)
            event.update(_scores(places))
        p_odom = keyframe.T_odom_imu[:3, 3]
        return Sight(
            seen.number, keyframe.index, p_odom, None if places is None else tuple(places), event, reason,
            transform(look.T_imu_local, points).astype(np.float32),
        )  # fmt: skip

    def _seen_before(self, p_odom: Array) -> _Seen:
        for seen in reversed(self._seen):
            if np.linalg.norm(seen.p_odom - p_odom) < SAME_PLACE_M:
                seen.p_odom = p_odom
                return seen
        self._seen = [*self._seen[-_MAX_SIGHTS:], _Seen(self._count, p_odom)]
        self._count += 1
        return self._seen[-1]

    def _candidates(self, look: _Look, matches: list[Match], others: Sequence[Expected]) -> list[_Candidate]:
        """What looks similar, and what would be seen from where the robot may be."""
        p_local = look.observation.p
        found = [_Candidate(match.row, start_of(p_local, match.yaw), match.completeness) for match in matches]
        for expected in others:
            distances = self._distances(look, expected)
            if distances.min(initial=np.inf) < SAME_PLACE_M:
                row = int(np.argmin(distances))
                T = expected.T_map_imu @ look.T_imu_local
                found.append(_Candidate(row, inverse(self.known.T_map_cloud(row)) @ T, 1.0))
        return found

    def _checked(self, look: _Look, points: Array, candidates: list[_Candidate]) -> list[Place]:
        """Step 9: what ICP says of each of its points (n, 3), all at a first look and the most alike thoroughly."""
        looked = []
        for candidate in candidates:
            T, likeness = self._verifier.first_look(points, self.known.intersections[candidate.row], candidate.start)
            looked.append((likeness, candidate, T))
        best = max((likeness for likeness, _, _ in looked), default=0.0)
        places: list[Place] = []
        for likeness, candidate, T in sorted(looked, key=lambda one: -one[0]):
            if likeness < best - _NEARLY or any(_same(place, self._id(candidate.row), T, look) for place in places):
                continue
            intersection = self.known.intersections[candidate.row]
            verification = self._verifier.verify(points, intersection, T, completeness=candidate.completeness)
            if self._fits(verification):
                own = self._verifier.around(look.stack.clouds[-1], look.observation.p)
                verification = self._verifier.unbent(verification, own, intersection, self._floor())
            places.append(self._place(look, candidate.row, verification))
        return places

    def _fits(self, verification: Verification) -> bool:
        s, v = self.settings.verification, verification
        return v.points >= s.min_points and v.fit >= s.min_fit and v.icp_distance <= s.max_icp_distance

    def _floor(self) -> Array:
        """Least covariance (6, 6) of a pin."""
        g = self.settings.graph
        return np.diag(np.repeat([g.pin_rotation, g.pin_position], 3) ** 2)

    def _place(self, look: _Look, row: int, verification: Verification) -> Place:
        v = verification
        T_map_local = self.known.in_map(row, v.T_map_local)
        carried = adjoint(look.T_imu_local)
        return Place(
            look.keyframe.index, self._id(row), T_map_local @ inverse(look.T_imu_local),
            carried @ v.covariance @ carried.T + self._floor(), self.known.T_map_cloud(row), v.fit, v.likeness,
            v.icp_distance, self._fits(v),
        )  # fmt: skip

    def _id(self, row: int) -> int:
        return int(self.known.ids[row])


def views_of(stack: Stack) -> list[View]:
    """A stack's keyframes as the map's side takes them."""
    return [View(cloud, sensor) for cloud, sensor in zip(stack.clouds, stack.sensors, strict=True)]


def _same(place: Place, intersection: int, T: Array, look: _Look) -> bool:
    """Whether a first look led to a place that was found already: a symmetric crossing comes several times."""
    T_cloud_imu = T @ inverse(look.T_imu_local)
    T_cloud_place = inverse(place.T_map_intersection) @ place.T_map_imu
    apart = np.linalg.norm(T_cloud_place[:3, 3] - T_cloud_imu[:3, 3])
    return bool(place.intersection == intersection and apart < 1.0)


def _reason(places: list[Place]) -> str:
    if not places:
        return "no intersection of the map is similar enough"
    return "" if any(place.fits for place in places) else "too few points fit the map"


def _scores(places: list[Place]) -> Event:
    """The best place's scores, and the likeness of the next."""
    if not places:
        return {}
    best = places[0]
    return {
        "id": best.intersection, "fit": round(best.fit, 4), "likeness": round(best.likeness, 4),
        "icp_distance_m": round(best.icp_distance, 4),
        "runner_up_likeness": round(places[1].likeness, 4) if len(places) > 1 else 0.0,
    }  # fmt: skip
