"""LAS and LAZ point clouds, COPC among them. The only file that knows laspy."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import date
from pathlib import Path

import laspy
import numpy as np
from laspy.vlrs.known import GeoKeyDirectoryVlr, WktCoordinateSystemVlr
from numpy.typing import ArrayLike

from maps.point_table import PIECE_POINTS, Extent, steps
from semmap.errors import CloudError, InputFileError
from semmap.files import written_whole
from semmap.geometry import Array

_ORIGIN_STEP_M = 1000.0
_STEP_M = 0.001
_NOISE = (7, 18)  # classes: low and high noise
_NO_DATE = date(2000, 1, 1)  # LAS asks for one; the same points shall give the same bytes on any day
_VARYING = (0, 2**32 - 1)  # points in a chunk, as the file says it
_EPSG_KEYS = (3072, 2048)  # GeoTIFF: projected, geographic


def las_extent(path: Path) -> Extent:
    """Number of points the header promises."""
    with laspy.open(path) as reader:
        count = int(reader.header.point_count)
        return Extent(count, count if _chunks_vary(reader.header) else PIECE_POINTS)


def _chunks_vary(header: laspy.LasHeader) -> bool:
    """Whether a LAZ file has chunks of different sizes, as COPC has: lazrs then does not find a point by its number."""
    packing = header.vlrs.get("LasZipVlr")
    return bool(packing) and int.from_bytes(packing[0].record_data[12:16], "little") in _VARYING


def las_points(path: Path, start: int, stop: int, rows: int) -> Iterator[Array]:
    """Points ``start`` to ``stop``, (up to ``rows``, 3) float64 [m] at a time; NaN where marked as noise or withheld.

    Raises `InputFileError` where the file is cut off, or whatever laspy and lazrs raise on damage.
    """
    with laspy.open(path) as reader:
        if start:
            reader.seek(start)
        for low, high in steps(start, stop, rows):
            chunk = reader.read_points(high - low)
            points = np.stack([chunk.x, chunk.y, chunk.z], axis=1)
            points[np.isin(chunk.classification, _NOISE) | np.asarray(chunk.withheld, np.bool_)] = np.nan
            if len(points) < high - low:
                what = f"is cut off after {low + len(points)} of {reader.header.point_count} points"
                raise InputFileError(what, file=path, mend="copy it again")
            yield points


def las_crs(path: Path) -> str | None:
    """Coordinate system the file names: WKT, or an EPSG code from its GeoTIFF keys."""
    with laspy.open(path) as reader:
        header = reader.header
    for vlr in [*header.vlrs, *(header.evlrs or [])]:
        if isinstance(vlr, WktCoordinateSystemVlr) and vlr.string.strip("\0 "):
            return str(vlr.string.strip("\0 "))
        if isinstance(vlr, GeoKeyDirectoryVlr):
            codes = {key.id: key.value_offset for key in vlr.geo_keys if key.tiff_tag_location == 0}
            for key in _EPSG_KEYS:
                if 1024 <= codes.get(key, 0) < 32767:
                    return f"EPSG:{codes[key]}"
    return None


def save_laz(path: str | Path, points: ArrayLike, crs: str | None = None) -> None:
    """Write points (n, 3) float64 [m] as LAS 1.4, compressed if ``path`` ends in ``.laz``, to the millimetre.

    ``crs`` is the WKT of the coordinate system. The same points give the same bytes.
    Raises `CloudError` if there are no points, some are not finite, or they spread over more than 2000 km.
    """
    xyz = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    if not len(xyz):
        raise CloudError("is empty or not finite", file=path, mend="write finite points only")
    offset = np.round(xyz.mean(axis=0) / _ORIGIN_STEP_M) * _ORIGIN_STEP_M
    save_laz_blocks(path, [xyz], offset, crs)


def save_laz_blocks(path: str | Path, blocks: Iterable[Array], offset: Array, crs: str | None = None) -> None:
    """The same for more points than memory holds: blocks (n, 3), all within 2000 km of ``offset`` (3,)."""
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.creation_date = _NO_DATE
    header.offsets, header.scales = offset, np.full(3, _STEP_M)
    if crs is not None:
        header.vlrs.append(WktCoordinateSystemVlr(crs))
        header.global_encoding.wkt = True
    compressed = Path(path).suffix.lower() == ".laz"
    with (
        written_whole(path) as temporary,
        laspy.open(temporary, mode="w", header=header, do_compress=compressed) as writer,
    ):
        for block in blocks:
            writer.write_points(_record(block, header, path))


def _record(points: Array, header: laspy.LasHeader, path: str | Path) -> laspy.ScaleAwarePointRecord:
    """Points as LAS has them: whole millimetres from the offset."""
    if not np.isfinite(points).all():
        raise CloudError("is empty or not finite", file=path, mend="write finite points only")
    whole = np.rint((points - header.offsets) / _STEP_M)
    if np.abs(whole).max(initial=0.0) > np.iinfo(np.int32).max:
        raise CloudError("spreads over more than 2000 km", file=path, mend="write one map a mine")
    record = laspy.ScaleAwarePointRecord.zeros(len(points), header=header)
    record.X, record.Y, record.Z = whole.astype(np.int32).T
    return record
