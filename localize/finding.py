"""Without a map, the intersections passed on the way become the database."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localize.keyframes import Keyframe, Stack, stacked, well_known
from localize.known import Found, FoundIntersections
from localize.matcher import SAME_PLACE_M, Expected, IntersectionMatcher, Looked, views_of
from localize.settings import LocalizeSettings
from maps.describe import thinned
from maps.observe import ObservedIntersection, observe_intersections
from maps.settings import MapSettings
from semmap.geometry import Array, inverse, se3, transform, yaw_of
from semmap.intersections import Intersection

_LEAST_KEYFRAMES = 5
"""What fewer keyframes saw from near by is not known well enough to be recognised."""


@dataclass(slots=True, eq=False)
class _Passing:
    """An intersection that the robot is at: where in odom (3,), and from how many keyframes it was seen."""

    p_odom: Array
    seen: int = 0


class IntersectionFinder(IntersectionMatcher):
    """Recognises intersections found earlier, and finds new ones: once the robot has left one behind, the keyframes of
    the passage make its cloud and contours.
    """

    def __init__(self, settings: LocalizeSettings) -> None:
        self._found = FoundIntersections(MapSettings())
        super().__init__(self._found, settings)
        self._passing: list[_Passing] = []

    def forget(self) -> None:
        """The robot may be anywhere; what was found stays."""
        super().forget()
        self._passing = []

    def look(
        self,
        stack: Sequence[Keyframe],
        kept: Sequence[Keyframe],
        track: Expected | None,
        others: Sequence[Expected],
        T_map: Mapping[int, Array],
    ) -> Looked:
        """Look at the last keyframe.

        stack : those that are stacked with it. kept : those of a while.
        track, others : see `IntersectionMatcher.recognise`. T_map : where intersections are by now, by id.
        """
        keyframe = stack[-1]
        self._found.update(T_map, stack[0].index)
        sights = self.recognise(stacked(stack), keyframe, track, others)
        for sight in sights:
            self._passing_at(np.array(sight.event["p_odom"])).seen += 1
        left = [one for one in self._passing if _distance(keyframe, one.p_odom) > self.settings.loops.left]
        self._passing = [one for one in self._passing if one not in left]
        return Looked(sights, tuple(self._find(left, kept, keyframe, track)) if track is not None else ())

    def _passing_at(self, p_odom: Array) -> _Passing:
        for one in self._passing:
            if np.linalg.norm(one.p_odom - p_odom) < SAME_PLACE_M:
                one.p_odom = p_odom
                return one
        self._passing.append(_Passing(p_odom))
        return self._passing[-1]

    def _find(
        self, left: Sequence[_Passing], kept: Sequence[Keyframe], keyframe: Keyframe, track: Expected
    ) -> list[tuple[Found, Array]]:
        """Add those of the intersections left behind that are new, and seen well, to the database."""
        T_map_odom = track.T_map_imu @ inverse(keyframe.T_odom_imu)
        found = []
        for passing in left:
            near = transform(T_map_odom, passing.p_odom[None])[0]
            if passing.seen < self.settings.matcher.consecutive or self._is_known(near):
                continue
            passage = self._passage(passing.p_odom, kept)
            new = _described(len(self._found.ids), passage, passing.p_odom, T_map_odom, self._found.settings)
            if new is not None:
                middle = next(one for one in passage if one.index == new.keyframe)
                T_map_cloud = T_map_odom @ middle.T_odom_imu @ new.T_imu_intersection
                self._found.add(new, T_map_cloud)
                found.append((new, T_map_cloud))
        return found

    def _is_known(self, p_map: Array) -> bool:
        return bool(np.linalg.norm(self._found.p_map - p_map, axis=1).min(initial=np.inf) < SAME_PLACE_M)

    def _passage(self, p_odom: Array, kept: Sequence[Keyframe]) -> tuple[Keyframe, ...]:
        """The keyframes near an intersection, before and after the nearest as far as the way is known well enough."""
        away = np.array([_distance(one, p_odom) for one in kept])
        nearest, far = int(np.argmin(away)), np.flatnonzero(away > self.settings.loops.left)
        first = int(far[far < nearest].max(initial=-1)) + 1
        last = int(far[far > nearest].min(initial=len(kept)))
        std = 0.5 * self.settings.keyframes.stacked_std
        before = well_known(kept[first : nearest + 1], std)
        after = well_known(kept[nearest:last][::-1], std)[::-1]
        return (*before, *after[1:])


def _distance(keyframe: Keyframe, p_odom: Array) -> float:
    return float(np.linalg.norm(keyframe.T_odom_imu[:3, 3] - p_odom))


def _described(
    id: int, passage: Sequence[Keyframe], p_odom: Array, T_map_odom: Array, settings: MapSettings
) -> Found | None:
    """The intersection at ``p_odom`` (3,) as some keyframes show it; None where they do not show one well."""
    if len(passage) < _LEAST_KEYFRAMES:
        return None
    stack = stacked(passage, yaw_of(T_map_odom[:3, :3]))
    seen = _nearest(observe_intersections(views_of(stack), settings), stack, p_odom)
    if seen is None:
        return None
    middle = min(passage, key=lambda one: _distance(one, p_odom))
    intersection = Intersection(
        id=id,
        p_map=np.zeros(3),
        kind=seen.kind,
        branch_bearings=seen.branch_bearings,
        branch_widths=seen.branch_widths,
        quality=seen.quality,
        contour=seen.contour,
        cloud=_cloud(stack, seen.p, settings),
    )
    T_imu_cloud = inverse(middle.T_odom_imu) @ stack.T_odom_local @ se3(np.eye(3), seen.p)
    return Found(intersection, middle.index, T_imu_cloud, passage[0].index, passage[-1].index)


def _nearest(seen: Sequence[ObservedIntersection], stack: Stack, p_odom: Array) -> ObservedIntersection | None:
    """The one of those seen that is at ``p_odom`` (3,)."""
    p_local = transform(inverse(stack.T_odom_local), p_odom[None])[0]
    here = [one for one in seen if np.linalg.norm(one.p - p_local) < SAME_PLACE_M]
    return min(here, key=lambda one: float(np.linalg.norm(one.p - p_local)), default=None)


def _cloud(stack: Stack, p: Array, settings: MapSettings) -> NDArray[np.float32]:
    delta = stack.points - p.astype(np.float32)
    return thinned(delta[np.hypot(delta[:, 0], delta[:, 1]) < settings.cloud_radius], settings.cloud_voxel)
