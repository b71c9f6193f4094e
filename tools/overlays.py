"""`overlays.h5` of a run: what the ICP checks compared, in centimetres, for the report to lay over the database."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from localize.results import Overlay
from semmap import hdf5
from semmap.errors import DatabaseError, InputFileError
from semmap.files import written_whole
from semmap.geometry import Array

_GROUP = "overlays"
_UNIT_M = 0.01
"""A step of the stored points; the points that are compared are means over larger voxels."""
_POINTS = 800
"""Of each overlay, at the most, spread evenly: enough to see whether walls lie on walls, and an hour stays small."""


def write_overlays(path: Path, overlays: Sequence[Overlay]) -> None:
    """Write the overlays of a run; the same ones give the same bytes."""
    with hdf5.naming(path), written_whole(path) as temporary, hdf5.created(temporary) as file:
        group = file.create_group(_GROUP)
        hdf5.write_column(group, "id", np.array([one.id for one in overlays], np.int64))
        hdf5.write_column(group, "T_map_imu", np.array([one.T_map_imu for one in overlays]).reshape(-1, 4, 4))
        sizes = [min(len(one.points), _POINTS) for one in overlays]
        hdf5.write_column(group, "cloud_offsets", np.cumsum([0, *sizes]))
        with hdf5.Appender(group, "cloud_points", np.int16, (3,)) as points:
            for one in overlays:
                points.append(_stored(one.points))


def _stored(points: NDArray[np.float32]) -> NDArray[np.int16]:
    """Some of the points (n, 3) [m] as they are stored, sorted: neighbours pack well."""
    some = points[np.linspace(0, len(points) - 1, min(len(points), _POINTS)).astype(np.int64)]
    steps = np.clip(np.round(some / _UNIT_M), -32768, 32767).astype(np.int16)
    return steps[np.lexsort(steps.T)]


@dataclass(frozen=True, slots=True, eq=False)
class Overlays:
    """Overlays of a run, read back.

    id : (k,). T_map_imu : (k, 4, 4). offsets : (k + 1,) into points (n, 3) int16, centimetres in the imu frames.
    """

    id: NDArray[np.int64]
    T_map_imu: Array
    offsets: NDArray[np.int64]
    points: NDArray[np.int16]

    def __len__(self) -> int:
        return len(self.id)

    def in_map(self, number: int) -> Array:
        """Points (n, 3) of an overlay, in the map [m]."""
        T = self.T_map_imu[number]
        points = _UNIT_M * self.points[self.offsets[number] : self.offsets[number + 1]].astype(np.float64)
        moved: Array = points @ T[:3, :3].T + T[:3, 3]
        return moved


def read_overlays(path: Path) -> Overlays:
    """The overlays of a run. Raises `InputFileError` where the file is damaged."""
    try:
        with hdf5.opened(path) as file:
            group = hdf5.Group(file, _GROUP)
            ids = group.column("id", np.int64, (None,))
            points = group.column("cloud_points", np.int16, (None, 3))
            offsets = group.offsets("cloud", len(ids), "points", len(points))
            return Overlays(ids, group.column("T_map_imu", np.float64, (len(ids), 4, 4)), offsets, points)
    except DatabaseError as error:
        what = error.what.replace("a semantic database", "a run's overlays")
        raise InputFileError(what, file=path, field=error.field, mend="run `semmap localize` again") from None
