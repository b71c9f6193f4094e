"""A prior map of any size as tiles in a work directory, by as many workers as there are."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

import semmap
from maps.columns import Columns
from maps.engine import Engine
from maps.prior_map import Piece, Survey, blocks, check_enough, survey
from maps.settings import MapSettings
from maps.tiles import TILE_M, Cloud32, TiledMap, Tiles, Tiling, sorted_into_tiles
from maps.work_directory import kept_whole, work_directory
from semmap.geometry import Array

_FORMAT = 1  # of the files in the work directory
_ROW_BYTES = 12
_COLUMN_ARRAYS = ("ij", "first", "bottom", "top", "mean", "count")


@dataclass(frozen=True, slots=True)
class TileFiles:
    """A `Store` in a directory: what is finished stays there and is not made again."""

    directory: Path

    def read(self, file: int, start: int, stop: int) -> Cloud32:
        with self._points(file).open("rb") as opened:
            opened.seek(start * _ROW_BYTES)
            return np.fromfile(opened, "<f4", 3 * (stop - start)).reshape(-1, 3)

    def kept(self, part: int, make: Callable[[], Columns]) -> Columns:
        path = self.directory / f"{part:06d}.columns.npz"
        if not path.exists():
            columns = make()
            with kept_whole(path) as temporary:
                np.savez(temporary, cell=columns.cell, **{name: getattr(columns, name) for name in _COLUMN_ARRAYS})
            return columns
        with np.load(path) as arrays:
            return Columns(float(arrays["cell"]), *(arrays[name] for name in _COLUMN_ARRAYS))

    def tiles(self, file: int) -> Tiles:
        """The tiles of a finished file."""
        with np.load(self._tiles(file)) as arrays:
            return Tiles(arrays["tile"], arrays["run"])

    def n_dropped(self, file: int) -> int:
        """How many points were left out of a finished file."""
        with np.load(self._tiles(file)) as arrays:
            return int(arrays["n_dropped"])

    def distribute(self, piece: Piece, file: int, origin: Array, tiling: Tiling) -> None:
        """Write the points of a piece tile by tile, block after block, as file number ``file``."""
        if self._tiles(file).exists():
            return
        found, n_dropped, row = [Tiles.joined([])], 0, 0
        with kept_whole(self._points(file)) as temporary, temporary.open("wb") as opened:
            for points, dropped in blocks(piece, origin):
                ordered, tiles = sorted_into_tiles(points, tiling, file, row)
                opened.write(ordered.astype("<f4", copy=False).tobytes())
                found.append(tiles)
                row, n_dropped = row + len(points), n_dropped + dropped
        tiles = Tiles.joined(found)
        with kept_whole(self._tiles(file)) as temporary:
            np.savez(temporary, tile=tiles.tile, run=tiles.run, n_dropped=n_dropped)

    def _points(self, file: int) -> Path:
        return self.directory / f"{file:06d}.points"

    def _tiles(self, file: int) -> Path:
        """The last of a file's two to be written: where it is, the file is finished."""
        return self.directory / f"{file:06d}.tiles.npz"


@contextmanager
def tiled(
    paths: Sequence[Path],
    work: Path,
    settings: MapSettings,
    engine: Engine,
    *,
    tile: float = TILE_M,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[TiledMap]:
    """A prior map of any size, sorted into tiles in the directory ``work`` for as long as the block runs.

    Parameters
    ----------
    paths : PCD, PLY, LAS, LAZ or E57 files, all in the same frame.
    work : where tiles and what is made of them are kept; see `work_directory` for how long.
    tile : side of a tile [m]. It has no influence on what is built.
    progress : called with bytes read and bytes in all.

    Raises
    ------
    InputFileError, CloudError
        As `maps.prior_map.read_prior_map`.
    BuildError
        Where the work directory is in use or cannot be written, or the engine fails.
    """
    found = survey([path.absolute() for path in paths])
    work, tiling = work.absolute(), Tiling.of(tile, settings.free_space.cell)
    with work_directory(work, _identity(found, tiling, settings)):
        engine.check_sees([work, *dict.fromkeys(piece.path for piece in found.pieces)])
        files = TileFiles(work)
        distribute = partial(_distribute, files, found.origin, tiling)
        done, total = 0, sum(piece.share for piece in found.pieces)
        for piece, _ in zip(found.pieces, engine.map(distribute, enumerate(found.pieces)), strict=True):
            done += piece.share
            if progress is not None:
                progress(done, total)
        numbers = range(len(found.pieces))
        tiles = Tiles.joined(files.tiles(number) for number in numbers)
        check_enough(int(tiles.counts().sum()), sum(files.n_dropped(number) for number in numbers), found)
        yield TiledMap(files, tiling, tiles, found.origin, found.sources, found.crs)


def _identity(found: Survey, tiling: Tiling, settings: MapSettings) -> dict[str, object]:
    """What the files in the work directory depend on."""
    return {
        "format": _FORMAT,
        "semmap": semmap.__version__,
        "sources": list(found.sources.items()),
        "origin": found.origin.tolist(),
        "tile_cells": tiling.cells,
        "settings": settings.free_space.model_dump(mode="json"),
    }


def _distribute(files: TileFiles, origin: Array, tiling: Tiling, numbered: tuple[int, Piece]) -> None:
    files.distribute(numbered[1], numbered[0], origin, tiling)
