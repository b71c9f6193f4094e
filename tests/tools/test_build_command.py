"""`semmap build` as people run it: the same bytes whatever tiles and workers, killed and run again, and its faults."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from maps.columns import Columns
from maps.las import save_laz
from maps.work_directory import work_directory
from semmap import database
from tools import cli

HERE = np.array([612_000.0, 5_400_000.0, -250.0])
N_FILES, N_PARTS = 6, 22


def ladder() -> np.ndarray:
    """Points (n, 3) on floor, walls and roof of two roadways that four others join, 0.1 m apart, in a mine grid."""
    step = 0.1
    x, y = np.meshgrid(np.arange(-30, 70, step), np.arange(-30, 50, step), indexing="ij")
    inside = (np.abs(y) < 2.2) | (np.abs(y - 20) < 2.0)
    inside |= np.minimum.reduce([np.abs(x - centre) for centre in (-10, 15, 40)]) < 1.9
    inside &= (x > -27) & (x < 67) & (y > -27) & (y < 47)
    wall = ndimage.binary_dilation(inside) & ~inside
    level = np.arange(0.0, 3.0, step)
    plan = [np.column_stack([x[inside], y[inside], np.full(inside.sum(), z)]) for z in (0.0, 3.0)]
    upright = np.column_stack(
        [np.repeat(x[wall], len(level)), np.repeat(y[wall], len(level)), np.tile(level, wall.sum())]
    )
    points = np.concatenate([*plan, upright])
    return HERE + points + np.random.default_rng(1).normal(0.0, 0.01, points.shape)


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The mine in several files that have nothing to do with places, with a few strays kilometres off."""
    directory = tmp_path_factory.mktemp("maps")
    points = np.random.default_rng(0).permutation(ladder())
    points[:40] += np.random.default_rng(2).uniform(-9000.0, 9000.0, (40, 3))
    paths = [directory / f"scan{k}.laz" for k in range(N_FILES)]
    for path, part in zip(paths, np.array_split(points, N_FILES), strict=True):
        save_laz(path, part)
    return paths


@pytest.fixture(scope="module")
def whole(maps: list[Path], tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """What an undisturbed build writes."""
    out = tmp_path_factory.mktemp("whole") / "mine.h5"
    assert build(maps, out) == 0
    return out.read_bytes()


@pytest.fixture(autouse=True)
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that a small mine has many parts."""
    monkeypatch.setattr("maps.tiles.PART_POINTS", 20_000)


def words(maps: list[Path], out: Path, *options: str) -> list[str]:
    return ["build", *map(str, maps), "--out", str(out), *options]


def build(maps: list[Path], out: Path, *options: str) -> int:
    return cli.run(words(maps, out, *options))


def test_the_mine_is_found(whole: bytes, tmp_path: Path) -> None:
    (tmp_path / "mine.h5").write_bytes(whole)
    found = database.load(tmp_path / "mine.h5")
    expected = {(x, y, kind) for x in (-10, 15, 40) for y, kind in ((0, "X"), (20, "X"))}
    places = [(one, one.p_map - HERE) for one in found.intersections]
    assert {(round(p[0] / 5) * 5, round(p[1] / 5) * 5, one.kind) for one, p in places} == expected
    assert list(found.sources) == [f"scan{k}.laz" for k in range(N_FILES)]


@pytest.mark.parametrize("options", [["--tile", "7"], ["--workers", "2"]], ids=" ".join)
def test_tiles_and_workers_do_not_change_a_byte(
    maps: list[Path], whole: bytes, tmp_path: Path, options: list[str]
) -> None:
    assert build(maps, tmp_path / "mine.h5", *options) == 0
    assert (tmp_path / "mine.h5").read_bytes() == whole
    assert [path.name for path in tmp_path.iterdir()] == ["mine.h5"]


def test_a_cluster_with_threads_does_not_change_a_byte(maps: list[Path], whole: bytes, tmp_path: Path) -> None:
    from distributed import LocalCluster

    with LocalCluster(1, threads_per_worker=3, processes=False, dashboard_address=":0") as cluster:
        assert build(maps, tmp_path / "mine.h5", "--scheduler", cluster.scheduler_address) == 0
    assert (tmp_path / "mine.h5").read_bytes() == whole


SLOWED = """
import sys, time
import maps.tiles, maps.tile_files, maps.engine
from tools import cli
maps.tiles.PART_POINTS = 20_000
real = {module}.{name}
def slow(*args):
    time.sleep(0.2)
    return real(*args)
{module}.{name} = slow
sys.exit(cli.run(sys.argv[1:]))
"""


def slowed(step: tuple[str, str], maps: list[Path], out: Path, *options: str) -> subprocess.Popen[str]:
    """A build in a process of its own that takes its time for every call of one function."""
    code = SLOWED.format(module=step[0], name=step[1])
    return subprocess.Popen(
        [sys.executable, "-c", code, *words(maps, out, *options)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # a suite in the background of a script has interrupts ignored, and its children with it
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def wait_for(work: Path, pattern: str, count: int, process: subprocess.Popen[str]) -> None:
    """Until so many files are finished."""
    limit = time.monotonic() + 60.0
    while len(list(work.glob(pattern))) < count:
        assert process.poll() is None and time.monotonic() < limit
        time.sleep(0.01)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """How many pieces are read and how many columns made in this process."""
    import maps.tile_files
    import maps.tiles

    counts = {"blocks": 0, "columns_of": 0}
    for module, name in ((maps.tile_files, "blocks"), (maps.tiles, "columns_of")):
        real = getattr(module, name)

        def counted(*args: object, real=real, name: str = name) -> Columns:
            counts[name] += 1
            return real(*args)

        monkeypatch.setattr(module, name, counted)
    return counts


def finished(work: Path, pattern: str) -> dict[str, int]:
    """Finished files and when they were written."""
    return {path.name: path.stat().st_mtime_ns for path in work.glob(pattern)}


def test_a_build_killed_twice_goes_on(maps: list[Path], whole: bytes, tmp_path: Path, made: dict[str, int]) -> None:
    out, work = tmp_path / "mine.h5", tmp_path / "mine.h5.work"
    with slowed(("maps.tile_files", "blocks"), maps, out) as process:
        wait_for(work, "*.tiles.npz", 3, process)
        process.send_signal(signal.SIGKILL)
    tiles = finished(work, "*.tiles.npz")
    assert 3 <= len(tiles) < N_FILES
    with slowed(("maps.tiles", "columns_of"), maps, out) as process:
        wait_for(work, "*.columns.npz", 3, process)
        process.send_signal(signal.SIGKILL)
    assert finished(work, "*.tiles.npz").items() >= tiles.items()
    columns = finished(work, "*.columns.npz")
    assert not out.exists()
    assert build(maps, out) == 0
    assert out.read_bytes() == whole
    assert not work.exists()
    assert made["blocks"] == 0
    assert made["columns_of"] == N_PARTS - len(columns) > 0


@pytest.mark.parametrize("options", [[], ["--workers", "2"]], ids=["alone", "with workers"])
def test_ctrl_c_is_quiet_and_leaves_what_is_finished(maps: list[Path], tmp_path: Path, options: list[str]) -> None:
    out, work = tmp_path / "mine.h5", tmp_path / "mine.h5.work"
    step = ("maps.engine._Cluster", "_threads") if options else ("maps.tile_files", "blocks")
    with slowed(step, maps, out, *options) as process:
        wait_for(work, "*.tiles.npz", 2, process)
        os.killpg(process.pid, signal.SIGINT)
        printed, complaints = process.communicate(timeout=60)
    assert process.returncode in (130, -signal.SIGINT)
    assert printed + complaints == ""
    assert len(list(work.glob("*.tiles.npz"))) >= 2
    assert not out.exists()


def complains(capsys: pytest.CaptureFixture[str], *parts: str) -> None:
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("semmap: error: ")
    assert captured.err.count("\n") == 1
    for part in parts:
        assert part in captured.err


def test_two_builds_to_one_output(maps: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with work_directory(tmp_path / "mine.h5.work", {}):
        assert build(maps, tmp_path / "mine.h5") == 2
        complains(capsys, "mine.h5.work", "another build is at work there", "--out")


def test_a_second_file_that_is_cut_off(maps: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    broken = tmp_path / "broken.laz"
    broken.write_bytes(maps[1].read_bytes()[: maps[1].stat().st_size // 2])
    assert build([maps[0], broken], tmp_path / "mine.h5") == 2
    complains(capsys, "broken.laz")
    assert [path.name for path in tmp_path.iterdir()] == ["broken.laz"]


def test_a_work_directory_that_is_not_ours(
    maps: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    work = tmp_path / "mine.h5.work"
    work.write_text("")
    assert build(maps, tmp_path / "mine.h5") == 2
    complains(capsys, "mine.h5.work", "cannot be made")
    work.unlink()
    work.mkdir()
    (work / "notes.txt").write_text("mine")
    assert build(maps, tmp_path / "mine.h5") == 2
    complains(capsys, "mine.h5.work", "holds files that are not semmap's")
    assert (work / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (["--workers", "0"], ["--workers"]),
        (["--workers", "two"], ["--workers"]),
        (["--tile", "0"], ["--tile"]),
        (["--scheduler", "tcp://127.0.0.1:1"], ["tcp://127.0.0.1:1", "does not answer", "--scheduler"]),
        (["--scheduler", "here"], ["here", "--scheduler"]),
        (["--workers", "2", "--scheduler", "tcp://127.0.0.1:1"], ["--workers", "--scheduler"]),
    ],
    ids=" ".join,
)
def test_wrong_options(
    maps: list[Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    options: list[str],
    parts: list[str],
) -> None:
    monkeypatch.setattr("maps.engine._CONNECT_S", 0.5)
    assert build(maps, tmp_path / "mine.h5", *options) == 2
    complains(capsys, *parts)
    assert list(tmp_path.iterdir()) == []
