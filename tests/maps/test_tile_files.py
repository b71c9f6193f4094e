"""Maps in tiles on disk: equal to the map in memory, whatever the tiles; what is finished is not made again."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from maps import tile_files
from maps.columns import Columns, columns_of
from maps.engine import ThisProcess
from maps.las import save_laz
from maps.prior_map import read_prior_map
from maps.settings import FreeSpaceSettings, MapSettings
from maps.tile_files import tiled
from maps.tiles import TiledMap
from semmap.errors import CloudError, InputFileError

SETTINGS = MapSettings()
HERE = np.array([700_010.0, 5_400_000.0, 100.0])


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that small maps come in many pieces, blocks and parts."""
    monkeypatch.setattr("maps.las.PIECE_POINTS", 3000)
    monkeypatch.setattr("maps.tiles.PART_POINTS", 2000)


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """Two files of a map in the millions of metres, with strays."""
    for k in range(2):
        rng = np.random.default_rng(k)
        points = HERE + rng.uniform([-20, 30 * k - 40, -2], [30, 30 * k, 3], (10_000, 3))
        points[0] += [8000.0, -3000.0, 50.0]
        save_laz(tmp_path / f"{k}.laz", points)
    return [tmp_path / "0.laz", tmp_path / "1.laz"]


def columns_of_all(mine: TiledMap) -> Columns:
    return Columns.joined([part.columns(SETTINGS.free_space) for part in mine.parts()])


@pytest.mark.parametrize("tile", [0.2, 7.3, 20.0, 900.0])
def test_it_is_the_map_in_memory(files: list[Path], tmp_path: Path, tile: float) -> None:
    prior = read_prior_map(files)
    memory = TiledMap.in_memory(prior, SETTINGS.free_space.cell)
    calls: list[tuple[int, int]] = []
    progress = lambda done, total: calls.append((done, total))  # noqa: E731
    with tiled(files, tmp_path / "work", SETTINGS, ThisProcess(), tile=tile, progress=progress) as mine:
        assert_array_equal(mine.origin, prior.origin)
        assert (mine.sources, mine.crs) == (prior.sources, prior.crs)
        ours, theirs = columns_of_all(mine), columns_of_all(memory)
        for name in ("ij", "first", "bottom", "top", "mean", "count"):
            assert_array_equal(getattr(ours, name), getattr(theirs, name))
        for p in (HERE - mine.origin, HERE - mine.origin + [15.0, -9.0, 0.0]):
            assert_array_equal(*(np.sort(one.around(p, 12.0).points(), axis=0) for one in (mine, memory)))
    assert calls[-1] == (sum(path.stat().st_size for path in files),) * 2
    assert not (tmp_path / "work").exists()


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the files that pieces are read from."""
    seen: list[str] = []
    real = tile_files.blocks

    def counted(piece: tile_files.Piece, origin: np.ndarray) -> Iterator[tuple[np.ndarray, int]]:
        seen.append(piece.path.name)
        return real(piece, origin)

    monkeypatch.setattr(tile_files, "blocks", counted)
    return seen


class StopsAfter(ThisProcess):
    """An engine that is interrupted when so many parts are done."""

    def __init__(self, parts: int) -> None:
        self.left = parts

    def map(self, work, items):  # type: ignore[no-untyped-def]
        for item in items:
            if not self.left:
                raise KeyboardInterrupt
            self.left -= 1
            yield work(item)


def build(files: list[Path], work: Path, engine: ThisProcess | None = None, **other: object) -> Columns:
    with tiled(files, work, SETTINGS, engine or ThisProcess(), **other) as mine:  # type: ignore[arg-type]
        return columns_of_all(mine)


def test_finished_pieces_are_not_read_again(files: list[Path], tmp_path: Path, reads: list[str]) -> None:
    with pytest.raises(KeyboardInterrupt):
        build(files, tmp_path / "work", StopsAfter(5))
    assert reads == ["0.laz"] * 4 + ["1.laz"]
    again = build(files, tmp_path / "work")
    assert reads[5:] == ["1.laz"] * 3
    whole = build(files, tmp_path / "other")
    assert_array_equal(again.count, whole.count)
    assert_array_equal(again.mean, whole.mean)


def test_finished_columns_are_not_made_again(
    files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[int] = []

    def counted(points: np.ndarray, settings: FreeSpaceSettings) -> Columns:
        made.append(len(points))
        return columns_of(points, settings)

    monkeypatch.setattr("maps.tiles.columns_of", counted)
    with tiled(files, tmp_path / "work", SETTINGS, ThisProcess()) as mine:
        once, again = columns_of_all(mine), columns_of_all(mine)
        assert len(made) == len(mine.parts()) > 3
    assert_array_equal(again.top, once.top)
    assert_array_equal(again.ij, once.ij)


@pytest.mark.parametrize("change", ["file", "tile", "settings", "order"])
def test_it_starts_over_when_something_else_is_built(
    files: list[Path], tmp_path: Path, reads: list[str], change: str
) -> None:
    with pytest.raises(KeyboardInterrupt):
        build(files, tmp_path / "work", StopsAfter(5))
    reads.clear()
    settings, tile = SETTINGS, 20.0
    if change == "file":
        save_laz(files[0], HERE + np.random.default_rng(7).uniform(-9, 9, (10_000, 3)))
    elif change == "tile":
        tile = 10.0
    elif change == "order":
        files = files[::-1]
    else:
        settings = MapSettings(free_space=FreeSpaceSettings(max_slope=0.3))
    with tiled(files, tmp_path / "work", settings, ThisProcess(), tile=tile):
        assert len(reads) == 8


def test_a_copy_of_the_same_files_goes_on(files: list[Path], tmp_path: Path, reads: list[str]) -> None:
    with pytest.raises(KeyboardInterrupt):
        build(files, tmp_path / "work", StopsAfter(5))
    (tmp_path / "moved").mkdir()
    moved = [Path(shutil.copy(path, tmp_path / "moved")) for path in files]
    os.utime(moved[0], (0, 0))
    build(moved, tmp_path / "work")
    assert len(reads) == 8


@pytest.mark.parametrize("suffix", [".laz", ".las"], ids=["found at once", "found while reading"])
def test_a_damaged_second_file_is_named_and_nothing_stays(files: list[Path], tmp_path: Path, suffix: str) -> None:
    broken = tmp_path / f"broken{suffix}"
    save_laz(broken, HERE + np.random.default_rng(3).uniform(-9, 9, (10_000, 3)))
    broken.write_bytes(broken.read_bytes()[: broken.stat().st_size // 2])
    with pytest.raises(InputFileError, match=r"broken\.la[sz]: is (damaged|cut off)"):
        build([files[0], broken], tmp_path / "work")
    assert not (tmp_path / "work").exists()


def test_too_few_points(tmp_path: Path) -> None:
    save_laz(tmp_path / "m.laz", np.random.default_rng(0).uniform(-9, 9, (999, 3)))
    with pytest.raises(CloudError, match="has 999 finite points of 999, fewer than 1000"):
        build([tmp_path / "m.laz"], tmp_path / "work")
    assert not (tmp_path / "work").exists()
