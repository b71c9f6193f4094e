"""Prior maps: surveyed point clouds in, float64 origin kept."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import laspy
import numpy as np
from laspy.vlrs.known import WktCoordinateSystemVlr
from numpy.typing import ArrayLike

from semmap.errors import CloudError
from semmap.files import written_whole

_LAS_STEP_M = 0.001
_NO_DATE = date(2000, 1, 1)  # LAS asks for one; the same points shall give the same bytes on any day


def save_laz(path: str | Path, points: ArrayLike, crs: str | None = None) -> None:
    """Write points (n, 3) float64 [m] as LAS 1.4, compressed if ``path`` ends in ``.laz``, to the millimetre.

    ``crs`` is the WKT of the coordinate system. The same points give the same bytes.
    Raises `CloudError` if there are no points, some are not finite, or they spread over more than 2000 km.
    """
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    if not len(points) or not np.isfinite(points).all():
        raise CloudError("has no points, or some that are not finite", file=path, mend="write finite points only")
    offsets = np.round(points.mean(axis=0) / 1000.0) * 1000.0
    steps = np.rint((points - offsets) / _LAS_STEP_M)
    if np.abs(steps).max() > np.iinfo(np.int32).max:
        raise CloudError("spreads over more than 2000 km", file=path, mend="write one map a mine")
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.creation_date = _NO_DATE
    header.offsets, header.scales = offsets, np.full(3, _LAS_STEP_M)
    if crs is not None:
        header.vlrs.append(WktCoordinateSystemVlr(crs))
        header.global_encoding.wkt = True
    las = laspy.LasData(header)
    las.X, las.Y, las.Z = steps.astype(np.int32).T
    with written_whole(path) as temporary:
        las.write(str(temporary))
