"""E57 point clouds. The only file that knows pye57."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pye57

from maps.point_table import Extent
from semmap.errors import CloudError
from semmap.geometry import Array

_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_INVALID = ("cartesianInvalidState", "sphericalInvalidState")


def e57_extent(path: Path) -> Extent:
    """Number of scans."""
    with pye57.E57(str(path)) as file:
        return Extent(int(file.scan_count), 1)


def e57_points(path: Path, start: int, stop: int, rows: int) -> Iterator[Array]:
    """Points of the scans ``start`` to ``stop``, each in its pose, (up to ``rows``, 3) float64 [m] at a time.

    Points that are marked as invalid are NaN. Raises `CloudError` where a scan has no coordinates, or whatever
    pye57 raises on damage.
    """
    with pye57.E57(str(path)) as file:
        for scan in range(start, stop):
            yield from _scan(file, scan, rows, path)


def _scan(file: Any, scan: int, rows: int, path: Path) -> Iterator[Array]:
    header = file.get_header(scan)
    fields = set(header.point_fields)
    axes = next((axes for axes in (_CARTESIAN, _SPHERICAL) if fields.issuperset(axes)), None)
    if axes is None:
        known = ", ".join(sorted(fields))
        raise CloudError("are missing", file=path, field="coordinates", mend=f"scan {scan} has {known}")
    data, buffers = file.make_buffers([*axes, *(fields & set(_INVALID))], rows)
    reader = header.points.reader(buffers)
    while count := reader.read():
        points = np.stack([data[axis][:count] for axis in axes], axis=1)
        points = points if axes is _CARTESIAN else from_spherical(points)
        if header.has_pose():
            points = file.to_global(points, header.rotation, header.translation)
        for name in fields & set(_INVALID):
            points[data[name][:count] != 0] = np.nan
        yield points


def from_spherical(points: Array) -> Array:
    """Range, azimuth and elevation (n, 3) [m, rad] as x, y, z [m]."""
    distance, azimuth, elevation = points.T
    level = distance * np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)], axis=1)
