"""Prior maps: surveyed point clouds of a mine (PCD, PLY, LAS, LAZ, E57) in, float64 origin kept.

The only file that knows laspy and pye57.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import NamedTuple

import laspy
import numpy as np
import pye57
from laspy.vlrs.known import GeoKeyDirectoryVlr, WktCoordinateSystemVlr
from numpy.typing import ArrayLike, NDArray

from maps.pcd import read_pcd
from maps.ply import read_ply
from semmap.errors import CloudError, InputFileError, SemmapError
from semmap.files import written_whole
from semmap.geometry import Array

MIN_POINTS = 1000
"""Fewer points are no map of a mine."""

_FORMATS = "PCD, PLY, LAS, LAZ or E57"
_LOCAL_M = 5000.0  # float32 is finer than half a millimetre below this
_ORIGIN_STEP_M = 1000.0
_FARTHEST_M = 1e8  # no map grid on Earth goes that far: such numbers are damage, like NaN
_ORIGIN_SAMPLE = 100_000
_LAS_STEP_M = 0.001
_LAS_CHUNK = 2_000_000
_LAS_NOISE = (7, 18)  # classes: low and high noise
_NO_DATE = date(2000, 1, 1)  # LAS asks for one; the same points shall give the same bytes on any day
_EPSG_KEYS = (3072, 2048)  # GeoTIFF: projected, geographic


@dataclass(frozen=True, slots=True, eq=False)
class PriorMap:
    """A point cloud of a whole mine.

    points : (n, 3) float32, map frame less ``origin`` [m], finite.
    origin : (3,) float64 [m], whole kilometres; zero along an axis whose coordinates are all below 5 km.
    sources : file name -> sha-256 of its bytes.
    crs : WKT or EPSG code of the map frame, where a file says so.
    n_dropped : points left out: not finite or absurd, or marked as noise or withheld in a LAS file.
    """

    points: NDArray[np.float32]
    origin: Array
    sources: Mapping[str, str] = field(default_factory=dict)
    crs: str | None = None
    n_dropped: int = 0

    def __len__(self) -> int:
        return len(self.points)


class _Part(NamedTuple):
    """Points (n, 3) float64 of a file, and how much of the file is read with them (0 to 1)."""

    points: Array
    share: float


def read_prior_map(
    paths: str | Path | Sequence[str | Path], *, progress: Callable[[int, int], None] | None = None
) -> PriorMap:
    """Read one prior map from one file or several; all of them are in the same frame.

    Parameters
    ----------
    paths : PCD, PLY, LAS, LAZ or E57 files. The content decides the format, not the name.
    progress : called with bytes read and bytes in all.

    Raises
    ------
    InputFileError
        Where a file is missing, cut off, of another format, or given twice, or two name different systems.
    CloudError
        Where coordinates are missing, or fewer than 1000 points are finite.
    """
    files = [Path(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
    sizes = [_size(path) for path in files]
    parts: list[Array] = []
    crs: str | None = None
    n_read = 0
    for path, before, size in zip(files, np.cumsum([0, *sizes]).tolist(), sizes, strict=False):
        for points, share in _read(path):
            n_read += len(points)
            parts.append(points[(np.abs(points) < _FARTHEST_M).all(axis=1)])
            if progress is not None:
                progress(before + round(share * size), sum(sizes))
        crs = _one_crs(crs, _crs_of(path), path)
    n_points = sum(map(len, parts))
    if n_points < MIN_POINTS:
        raise CloudError(
            f"has {n_points} finite points of {n_read}, fewer than {MIN_POINTS}",
            file=files[0] if files else None,
            mend="give the point cloud of a mine",
        )
    origin = _round_origin(parts)
    return PriorMap(_relative(parts, origin), origin, _digests(files), crs, n_read - n_points)


def _size(path: Path) -> int:
    if path.is_dir():
        raise InputFileError("is a directory", file=path, mend=f"name its {_FORMATS} files")
    try:
        return path.stat().st_size
    except OSError as reason:
        raise InputFileError(f"cannot be read ({reason.strerror})", file=path, mend="check the path") from None


def _read(path: Path) -> Iterator[_Part]:
    """The points of a file, by the format its first bytes tell."""
    with path.open("rb") as file:
        start = file.read(256)
    if not start:
        raise InputFileError("is empty", file=path, mend="copy it again")
    reader = next((reader for magic, reader in _READERS.items() if start.lstrip().startswith(magic)), None)
    if reader is None:
        raise InputFileError("is of an unknown format", file=path, mend=f"convert it to {_FORMATS}")
    try:
        yield from reader(path)
    except SemmapError:
        raise
    except Exception as reason:
        # laspy, lazrs and libE57 each fail in their own way on damaged files.
        text = str(reason).splitlines()[0].rstrip(".") if str(reason) else type(reason).__name__
        raise InputFileError(f"is damaged ({text})", file=path, mend="copy or export it again") from None


def _read_pcd(path: Path) -> Iterator[_Part]:
    yield _Part(read_pcd(path), 1.0)


def _read_ply(path: Path) -> Iterator[_Part]:
    yield _Part(read_ply(path), 1.0)


def _read_las(path: Path) -> Iterator[_Part]:
    with laspy.open(path) as reader:
        total, done = int(reader.header.point_count), 0
        for chunk in reader.chunk_iterator(_LAS_CHUNK):
            done += len(chunk)
            points = np.stack([chunk.x, chunk.y, chunk.z], axis=1)
            points[np.isin(chunk.classification, _LAS_NOISE) | np.asarray(chunk.withheld, np.bool_)] = np.nan
            yield _Part(points, done / total)
    if done < total:
        raise InputFileError(f"is cut off after {done} of {total} points", file=path, mend="copy it again")


def _read_e57(path: Path) -> Iterator[_Part]:
    """All scans, each in its pose."""
    with pye57.E57(str(path)) as file:
        for k in range(file.scan_count):
            scan = file.read_scan(k, ignore_missing_fields=True, transform=True)
            points = np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], axis=1)
            yield _Part(points, (k + 1) / file.scan_count)


_READERS: Mapping[bytes, Callable[[Path], Iterator[_Part]]] = {
    b"LASF": _read_las,
    b"ASTM-E57": _read_e57,
    b"ply\n": _read_ply,
    b"ply\r": _read_ply,
    b"# .PCD": _read_pcd,
    b"VERSION": _read_pcd,
}


def _crs_of(path: Path) -> str | None:
    """Coordinate system a LAS file names: WKT, or an EPSG code from its GeoTIFF keys."""
    with path.open("rb") as file:
        if file.read(4) != b"LASF":
            return None
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


def _one_crs(known: str | None, found: str | None, path: Path) -> str | None:
    if known is not None and found is not None and known != found:
        raise InputFileError("is in another coordinate system than the files before it", file=path, mend="reproject it")
    return known if known is not None else found


def _round_origin(parts: Sequence[Array]) -> Array:
    """A round point near the mine; zero along the axes where a local grid is small enough as it is."""
    filled = [part for part in parts if len(part)]
    stride = max(1, sum(map(len, filled)) // _ORIGIN_SAMPLE)
    middle = np.median(np.concatenate([part[::stride] for part in filled]), axis=0)
    largest = np.max([np.abs(part).max(axis=0) for part in filled], axis=0)
    origin = np.round(middle / _ORIGIN_STEP_M) * _ORIGIN_STEP_M
    return np.asarray(np.where(largest < _LOCAL_M, 0.0, origin))


def _relative(parts: list[Array], origin: Array) -> NDArray[np.float32]:
    """All points less the origin as one array; the parts are let go one by one to save memory."""
    points = np.empty((sum(map(len, parts)), 3), np.float32)
    stop = len(points)
    while parts:
        part = parts.pop()
        points[stop - len(part) : stop] = part - origin
        stop -= len(part)
    return points


def _digests(files: Sequence[Path]) -> dict[str, str]:
    digests: dict[str, str] = {}
    for path in files:
        if path.name in digests:
            raise InputFileError("has the name of another map file", file=path, mend="name each file once")
        with path.open("rb") as file:
            digests[path.name] = hashlib.file_digest(file, "sha256").hexdigest()
    return digests


def save_laz(path: str | Path, points: ArrayLike, crs: str | None = None) -> None:
    """Write points (n, 3) float64 [m] as LAS 1.4, compressed if ``path`` ends in ``.laz``, to the millimetre.

    ``crs`` is the WKT of the coordinate system. The same points give the same bytes.
    Raises `CloudError` if there are no points, some are not finite, or they spread over more than 2000 km.
    """
    xyz = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    if not len(xyz) or not np.isfinite(xyz).all():
        raise CloudError("is empty or not finite", file=path, mend="write finite points only")
    offsets = np.round(xyz.mean(axis=0) / _ORIGIN_STEP_M) * _ORIGIN_STEP_M
    steps = np.rint((xyz - offsets) / _LAS_STEP_M)
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
