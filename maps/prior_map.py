"""Prior maps: surveyed point clouds of a mine (PCD, PLY, LAS, LAZ, COPC, E57), read piece by piece or as a whole."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from maps.e57 import e57_extent, e57_points
from maps.las import las_crs, las_extent, las_points
from maps.pcd import pcd_extent, pcd_points
from maps.ply import ply_extent, ply_points
from maps.point_table import Extent, steps
from semmap.errors import CloudError, InputFileError, SemmapError
from semmap.geometry import Array

MIN_POINTS = 1000
"""Fewer points are no map of a mine."""

_FORMATS = "PCD, PLY, LAS, LAZ or E57"
_LOCAL_M = 5000.0
_ORIGIN_STEP_M = 1000.0
_FARTHEST_M = 1e8  # no map grid on Earth goes that far: such numbers are damage, like NaN
_REACH_M = (40_000.0, 40_000.0, 10_000.0)  # from the origin; farther off is no part of the mine
_SAMPLE = 1000
_BLOCK_ROWS = 500_000


@dataclass(frozen=True, slots=True, eq=False)
class PriorMap:
    """A point cloud of a whole mine.

    points : (n, 3) float32, map frame less ``origin`` [m], finite.
    origin : (3,) float64 [m], see `Survey`.
    sources : file name -> sha-256 of its bytes.
    crs : WKT or EPSG code of the map frame, where a file says so.
    n_dropped : points left out: not finite, tens of kilometres off, or marked as noise or withheld in a LAS file.
    """

    points: NDArray[np.float32]
    origin: Array
    sources: Mapping[str, str] = field(default_factory=dict)
    crs: str | None = None
    n_dropped: int = 0

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, slots=True)
class Piece:
    """Part of a point file that can be read without the rest of it: rows ``start`` to ``stop``.

    A row is a point, or a scan of an E57 file. ``share`` : this part of the file [bytes], for progress.
    """

    path: Path
    start: int
    stop: int
    share: int


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What is known of a prior map before its points are read.

    pieces : parts of the files, in order.
    origin : (3,) float64 [m], zero along axes where the mine is less than 5 km from zero; elsewhere the whole kilometre
        nearest to the middle of the first thousand points of each file.
    sources : file name -> sha-256 of its bytes.
    crs : WKT or EPSG code of the map frame, where a file says so.
    """

    pieces: tuple[Piece, ...]
    origin: Array
    sources: Mapping[str, str]
    crs: str | None


def survey(paths: str | Path | Sequence[str | Path]) -> Survey:
    """Look at the files of one prior map, all in the same frame; the content decides the format, not the name.

    Raises
    ------
    InputFileError
        Where a file is missing, damaged, of another format, or given twice, or two name different systems.
    """
    files = [Path(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
    digests: dict[str, str] = {}
    crs: str | None = None
    pieces: list[Piece] = []
    samples: list[Array] = []
    for path in files:
        size = _size(path)
        if path.name in digests:
            raise InputFileError("has the name of another map file", file=path, mend="name each file once")
        found = _pieces(path, size)
        pieces += found
        samples.append(_sample(found))
        crs = _one_crs(crs, path)
        with path.open("rb") as file:
            digests[path.name] = hashlib.file_digest(file, "sha256").hexdigest()
    return Survey(tuple(pieces), _round_origin(samples), digests, crs)


def blocks(piece: Piece, origin: Array, rows: int = _BLOCK_ROWS) -> Iterator[tuple[NDArray[np.float32], int]]:
    """The points of a piece, (up to ``rows``, 3) less ``origin`` [m] at a time, each with how many were dropped.

    Raises `InputFileError` where the file is damaged or cut off, `CloudError` where it has no coordinates.
    """
    for points in _points(piece, rows):
        relative = points - origin
        good = (np.abs(relative) < _REACH_M).all(axis=1)
        kept = relative if good.all() else relative[good]
        yield kept.astype(np.float32), len(points) - len(kept)


def read_prior_map(
    paths: str | Path | Sequence[str | Path], *, progress: Callable[[int, int], None] | None = None
) -> PriorMap:
    """Read one prior map from one file or several, whole into memory.

    Parameters
    ----------
    paths : PCD, PLY, LAS, LAZ or E57 files, all in the same frame.
    progress : called with bytes read and bytes in all.

    Raises
    ------
    InputFileError
        Where a file is missing, cut off, of another format, or given twice, or two name different systems.
    CloudError
        Where coordinates are missing, or fewer than 1000 points are finite.
    """
    found = survey(paths)
    parts: list[NDArray[np.float32]] = []
    n_dropped, done = 0, 0
    for piece in found.pieces:
        for points, dropped in blocks(piece, found.origin):
            parts.append(points)
            n_dropped += dropped
        done += piece.share
        if progress is not None:
            progress(done, sum(other.share for other in found.pieces))
    check_enough(sum(map(len, parts)), n_dropped, found)
    return PriorMap(_joined(parts), found.origin, found.sources, found.crs, n_dropped)


def check_enough(n_points: int, n_dropped: int, found: Survey) -> None:
    """Raise `CloudError` if these are too few points to be a mine."""
    if n_points < MIN_POINTS:
        raise CloudError(
            f"has {n_points} finite points of {n_points + n_dropped}, fewer than {MIN_POINTS}",
            file=found.pieces[0].path if found.pieces else None,
            mend="give the point cloud of a mine",
        )


def _joined(parts: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """All points as one array; the parts are let go one by one to save memory."""
    points = np.empty((sum(map(len, parts)), 3), np.float32)
    stop = len(points)
    while parts:
        part = parts.pop()
        points[stop - len(part) : stop] = part
        stop -= len(part)
    return points


class _Format(NamedTuple):
    extent: Callable[[Path], Extent]
    points: Callable[[Path, int, int, int], Iterator[Array]]


_PCD = _Format(pcd_extent, pcd_points)
_PLY = _Format(ply_extent, ply_points)
_FORMAT_OF: Mapping[bytes, _Format] = {
    b"LASF": _Format(las_extent, las_points),
    b"ASTM-E57": _Format(e57_extent, e57_points),
    b"ply\n": _PLY,
    b"ply\r": _PLY,
    b"# .PCD": _PCD,
    b"VERSION": _PCD,
}


def _size(path: Path) -> int:
    if path.is_dir():
        raise InputFileError("is a directory", file=path, mend=f"name its {_FORMATS} files")
    try:
        return path.stat().st_size
    except OSError as reason:
        raise InputFileError(f"cannot be read ({reason.strerror})", file=path, mend="check the path") from None


def _format(path: Path) -> _Format:
    """The format that the first bytes of a file tell."""
    try:
        with path.open("rb") as file:
            start = file.read(256)
    except OSError as reason:
        raise InputFileError(f"cannot be read ({reason.strerror})", file=path, mend="check its permissions") from None
    if not start:
        raise InputFileError("is empty", file=path, mend="copy it again")
    found = next((known for magic, known in _FORMAT_OF.items() if start.lstrip().startswith(magic)), None)
    if found is None:
        raise InputFileError("is of an unknown format", file=path, mend=f"convert it to {_FORMATS}")
    return found


def _pieces(path: Path, size: int) -> list[Piece]:
    reader = _format(path)
    with _damage_named(path):
        rows, at_once = reader.extent(path)
    ends = [*steps(0, rows, max(1, at_once))] or [(0, 0)]
    share = [round(size * (high / rows if rows else 1.0)) for _, high in ends]
    return [Piece(path, *ends[k], share[k] - (share[k - 1] if k else 0)) for k in range(len(ends))]


def _points(piece: Piece, rows: int) -> Iterator[Array]:
    """Points (up to ``rows``, 3) float64 as they are in the file; what is no point is NaN, infinite or absurd."""
    reader = _format(piece.path)
    with _damage_named(piece.path):
        yield from reader.points(piece.path, piece.start, piece.stop, rows)


@contextmanager
def _damage_named(path: Path) -> Iterator[None]:
    """laspy, lazrs and libE57 each fail in their own way on damaged files; all of it becomes `InputFileError`."""
    try:
        yield
    except SemmapError:
        raise
    except Exception as reason:
        text = str(reason).splitlines()[0].rstrip(".") if str(reason) else type(reason).__name__
        raise InputFileError(f"is damaged ({text})", file=path, mend="copy or export it again") from None


def _one_crs(known: str | None, path: Path) -> str | None:
    """The coordinate system that is known, or that a LAS file names; both must be the same."""
    if _format(path).points is not las_points:
        return known
    with _damage_named(path):
        found = las_crs(path)
    if known is not None and found is not None and known != found:
        raise InputFileError("is in another coordinate system than the files before it", file=path, mend="reproject it")
    return known if known is not None else found


def _sample(pieces: Sequence[Piece]) -> Array:
    """The first points of a file (up to 1000, 3), float64."""
    found: list[Array] = []
    for points in (points for piece in pieces for points in _points(piece, 10 * _SAMPLE)):
        found.append(points[(np.abs(points) < _FARTHEST_M).all(axis=1)])
        if sum(map(len, found)) >= _SAMPLE:
            break
    return np.concatenate([np.zeros((0, 3)), *found])[:_SAMPLE]


def _round_origin(samples: Sequence[Array]) -> Array:
    """A round point near the mine; zero along the axes where a local grid is small enough as it is."""
    points = np.concatenate([np.zeros((0, 3)), *samples])
    if not len(points):
        return np.zeros(3)
    middle = np.median(points, axis=0)
    return np.asarray(np.where(np.abs(middle) < _LOCAL_M, 0.0, np.round(middle / _ORIGIN_STEP_M) * _ORIGIN_STEP_M))
