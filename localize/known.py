"""Intersections that can be recognised, and where they lie: those of a map, or those found on the way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from descriptors.index import ContourIndex
from maps.settings import MapSettings
from semmap.errors import DatabaseError
from semmap.geometry import Array, se3
from semmap.intersections import Intersection, SemanticMap
from semmap.settings import validate


class KnownIntersections(Protocol):
    """Rows of a database.

    settings : those the contours were made with. intersections, ids : of each row. index : their contours.
    """

    settings: MapSettings
    index: ContourIndex

    @property
    def intersections(self) -> Sequence[Intersection]: ...

    @property
    def ids(self) -> NDArray[np.int64]: ...

    @property
    def p_map(self) -> Array:
        """Where they are (n, 3), relative to the map's round origin."""

    @property
    def visible(self) -> NDArray[np.bool_]:
        """Whether each (n,) may be looked for."""

    def T_map_cloud(self, row: int) -> Array:
        """The frame of a row's cloud in the map (4, 4)."""

    def in_map(self, row: int, T: Array) -> Array:
        """A pose (4, 4) that was registered to a row, as `Verification` has it, in the map."""


class MapIntersections:
    """Those of a semantic map, relative to ``origin`` (3,). Raises `DatabaseError` for settings unknown here."""

    def __init__(self, semantic_map: SemanticMap, origin: Array) -> None:
        self.settings = validate(MapSettings, dict(semantic_map.settings), file=None, error=DatabaseError)
        self.index = ContourIndex(semantic_map.contours, self.settings.contour)
        self.intersections = semantic_map.intersections
        self.ids = semantic_map.columns.id
        self.p_map = semantic_map.p_map - origin
        self.visible = np.ones(len(self.ids), np.bool_)
        self._origin = origin

    def T_map_cloud(self, row: int) -> Array:
        return se3(np.eye(3), self.p_map[row])

    def in_map(self, row: int, T: Array) -> Array:
        return se3(T[:3, :3], T[:3, 3] - self._origin)


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """An intersection found on the way.

    intersection : its cloud's frame is upright and lies along the map's axes as they were known then; ``p_map`` is 0.
    keyframe : number of the keyframe that it is tied to, by ``T_imu_intersection`` (4, 4).
    first, last : numbers of the keyframes that its cloud was seen from.
    """

    intersection: Intersection
    keyframe: int
    T_imu_intersection: Array
    first: int
    last: int


class FoundIntersections:
    """Those found on the way so far; their places move as the track is corrected."""

    def __init__(self, settings: MapSettings) -> None:
        self.settings = settings
        self.index = ContourIndex((), settings.contour)
        self._found: list[Found] = []
        self._T_map = np.zeros((0, 4, 4))
        self.visible = np.zeros(0, np.bool_)

    def add(self, found: Found, T_map_cloud: Array) -> None:
        """One more, at ``T_map_cloud`` (4, 4)."""
        self._found.append(found)
        self._T_map = np.concatenate([self._T_map, T_map_cloud[None]])
        self.index = ContourIndex([one.intersection.contour for one in self._found], self.settings.contour)

    def update(self, T_map: Mapping[int, Array], first_keyframe: int) -> None:
        """Where they are as known now, by id; those seen from the keyframes that look, from this number on, are hidden:
        seen at one time, they would be found where they were put."""
        for id, T in T_map.items():
            self._T_map[id] = T
        self.visible = np.array([one.last < first_keyframe for one in self._found], np.bool_)

    @property
    def intersections(self) -> list[Intersection]:
        return [one.intersection for one in self._found]

    @property
    def ids(self) -> NDArray[np.int64]:
        return np.arange(len(self._found))

    @property
    def p_map(self) -> Array:
        return self._T_map[:, :3, 3]

    def T_map_cloud(self, row: int) -> Array:
        # a copy: `update` writes into it, in another thread than answers are read in
        return np.array(self._T_map[row])

    def in_map(self, row: int, T: Array) -> Array:
        placed: Array = self._T_map[row] @ T
        return placed
