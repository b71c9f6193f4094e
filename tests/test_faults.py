"""Bad input, one by one: one clear line on standard error, exit status 2, and no file left behind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml
from small_files import RIG, small_map, write_recording

from maps.settings import MapSettings
from semmap import database
from semmap.geometry import se3
from semmap.intersections import SemanticMap
from semmap.trajectory import Trajectory
from tools import cli


@dataclass(frozen=True)
class Bench:
    """A directory with one good file of every sort."""

    path: Path
    rig: Path
    recording: Path
    map: Path
    truth: Path

    def localize(self, **other: object) -> list[str]:
        """A good command line, with some of its parts replaced."""
        parts = {"recording": self.recording, "rig": self.rig, "map": self.map, "out": self.path / "out"} | other
        return ["localize", str(parts.pop("recording")), *(f"--{key}={value}" for key, value in parts.items())]

    def merge(self, other: Path, first: Path | None = None) -> list[str]:
        """Merge another database into the good one, or into ``first``."""
        return ["merge", str(first or self.map), str(other), f"--out={self.path / 'out.h5'}"]

    def write(self, name: str, content: str | bytes) -> Path:
        """A file of this content."""
        path = self.path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    def rig_with(self, **blocks: object) -> Path:
        """The rig with some blocks replaced."""
        return self.write("other_rig.yaml", yaml.safe_dump(RIG | blocks))

    def files(self) -> dict[str, int]:
        """Name and size of everything there."""
        return {str(path.relative_to(self.path)): path.stat().st_size for path in self.path.rglob("*")}


@pytest.fixture
def bench(tmp_path: Path, rig_file: Path, recording: Path, semantic_map: SemanticMap) -> Bench:
    database.save(semantic_map, tmp_path / "mine.h5")
    stamps = np.int64(1e8) * np.arange(20)
    Trajectory("map", stamps, np.repeat(np.eye(4)[None], 20, axis=0)).save_tum(tmp_path / "truth.tum")
    return Bench(tmp_path, rig_file, recording, tmp_path / "mine.h5", tmp_path / "truth.tum")


def truncated(path: Path, part: float = 0.5) -> None:
    """Cut a file off."""
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * part)])


def _truncated_mcap(bench: Bench) -> list[str]:
    (file,) = bench.recording.glob("*.mcap")
    truncated(file)
    return bench.localize()


def _truncated_bag(bench: Bench) -> list[str]:
    bag = write_recording(bench.path / "flight.bag", bench.rig, "bag")
    truncated(bag)
    return bench.localize(recording=bag)


def _truncated_database(bench: Bench) -> list[str]:
    truncated(bench.map)
    return bench.localize()


def _empty_run(bench: Bench) -> list[str]:
    (bench.path / "empty").mkdir()
    return ["evaluate", str(bench.path / "empty"), f"--truth={bench.truth}"]


def _run_later_than_the_truth(bench: Bench) -> list[str]:
    poses = np.repeat(se3(np.eye(3), np.zeros(3))[None], 5, axis=0)
    Trajectory("map", np.int64(1e15) + np.arange(5), poses).save_tum(bench.path / "run" / "trajectory.tum")
    return ["evaluate", str(bench.path / "run"), f"--truth={bench.truth}"]


def _newer_database(bench: Bench) -> Path:
    path = bench.write("newer.h5", bench.map.read_bytes())
    with h5py.File(path, "r+") as file:
        file.attrs["schema_version"] = 3
    return path


def _database_of(bench: Bench, **fields: object) -> Path:
    """The good database with other fields."""
    path = bench.path / ("other.h5" if fields != {"crs": "EPSG:1"} else "first.h5")
    database.save(replace(small_map(), **fields), path)
    return path


def _database_with(bench: Bench, **settings: object) -> Path:
    """The good database, made with other settings."""
    return _database_of(bench, settings=MapSettings.model_validate(settings).model_dump(mode="json"))


def _build(name: str, content: str | bytes) -> Callable[[Bench], list[str]]:
    return lambda bench: ["build", str(bench.write(name, content)), f"--out={bench.path / 'out.h5'}"]


def _pcd(points: str, count: int) -> str:
    head = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    return f"{head}WIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA ascii\n{points}"


LIDAR_WITHOUT_PLACE = {"topic": "/lidar/points"}

FAULTS: dict[str, tuple[Callable[[Bench], list[str]], tuple[str, ...]]] = {
    "no recording": (lambda b: b.localize(recording=b.path / "nothing"), ("nothing",)),
    "recording is text": (lambda b: b.localize(recording=b.write("a.bag", "hello")), ("a.bag",)),
    "recording is an empty directory": (lambda b: b.localize(recording=b.path), ("rosbag",)),
    "truncated mcap": (_truncated_mcap, ("recording",)),
    "truncated bag": (_truncated_bag, ("flight.bag",)),
    "missing topic": (
        lambda b: b.localize(rig=b.rig_with(lidar=RIG["lidar"] | {"topic": "/velodyne"})),
        ("/velodyne", "/lidar/points"),
    ),
    "topic of another type": (
        lambda b: b.localize(rig=b.rig_with(wheel=RIG["wheel"] | {"topic": "/imu/data"})),
        ("/imu/data",),
    ),
    "no rig": (lambda b: b.localize(rig=b.path / "no.yaml"), ("no.yaml", "no such file")),
    "missing extrinsic": (lambda b: b.localize(rig=b.rig_with(lidar=LIDAR_WITHOUT_PLACE)), ("lidar.p_imu_lidar",)),
    "misspelt rig key": (lambda b: b.localize(rig=b.rig_with(weel=RIG["wheel"])), ("weel", "did you mean `wheel`")),
    "rig without an imu": (lambda b: b.localize(rig=b.write("r.yaml", "frame: map")), ("imu", "missing")),
    "rig is not yaml": (lambda b: b.localize(rig=b.write("r.yaml", "a: [1, 2")), ("r.yaml", "YAML")),
    "no database": (lambda b: b.localize(map=b.path / "no.h5"), ("no.h5",)),
    "database is text": (lambda b: b.localize(map=b.write("a.h5", "hello")), ("a.h5",)),
    "database is a directory": (lambda b: b.localize(map=b.path), ("semmap build",)),
    "truncated database": (_truncated_database, ("mine.h5",)),
    "misspelt aid": (lambda b: b.localize(without="wheels"), ("wheels", "did you mean `wheel`")),
    "out is a file": (lambda b: b.localize(out=b.rig), ("rig.yaml", "--out")),
    "misspelt setting": (
        lambda b: [*b.localize(), "--config", str(b.write("c.yaml", "localize: {matcher: {min_pwvc: 0.5}}"))],
        ("localize.matcher.min_pwvc", "did you mean `min_pwcv`"),
    ),
    "setting out of range": (
        lambda b: [*b.localize(), "--config", str(b.write("c.yaml", "localize: {matcher: {min_pwcv: 5}}"))],
        ("min_pwcv", "5"),
    ),
    "no settings": (lambda b: [*b.localize(), "--config", "no.yaml"], ("no.yaml",)),
    "info of no database": (lambda b: ["info", str(b.rig)], ("rig.yaml",)),
    "info of a newer database": (
        lambda b: ["info", str(_newer_database(b))],
        ("newer.h5", "schema version 3", "1 to 2"),
    ),
    "merge with nothing": (lambda b: b.merge(b.path / "no.h5"), ("no.h5", "no such file")),
    "merge with text": (lambda b: b.merge(b.write("a.h5", "hello")), ("a.h5", "semmap build")),
    "merge of other settings": (
        lambda b: b.merge(_database_with(b, contour={"radius": 10.0})),
        ("other.h5", "settings.contour.radius", "10.0", "12.0"),
    ),
    "merge of another frame": (lambda b: b.merge(_database_of(b, frame="mine")), ("other.h5", "frame", "mine")),
    "merge of another crs": (lambda b: b.merge(_database_of(b, crs="EPSG:2"), _database_of(b, crs="EPSG:1")), ("crs",)),
    "merge that cannot align": (lambda b: [*b.merge(b.map), "--align"], ("align", "too few")),
    "merge into a directory": (
        lambda b: ["merge", str(b.map), str(b.map), f"--out={b.path}"],
        ("directory", "--out"),
    ),
    "export of nothing": (lambda b: ["export", str(b.map)], ("--geojson", "--graphml")),
    "export of no database": (lambda b: ["export", str(b.rig), f"--geojson={b.path / 'a.json'}"], ("rig.yaml",)),
    "export to a directory": (lambda b: ["export", str(b.map), f"--graphml={b.path}"], ("directory",)),
    "report of no database": (lambda b: ["report", str(b.rig), f"--out={b.path / 'r.html'}"], ("rig.yaml",)),
    "report of nothing": (lambda b: ["report", str(b.path / "no"), f"--out={b.path / 'r.html'}"], ("no",)),
    "report of no run": (lambda b: ["report", str(b.path), f"--out={b.path / 'r.html'}"], ("semmap localize",)),
    "page is a directory": (lambda b: ["report", str(b.map), f"--out={b.path}"], ("directory", "--out")),
    "database to write is a directory": (lambda b: ["build", str(b.truth), f"--out={b.path}"], ("directory", "--out")),
    "evaluate no run": (_empty_run, ("empty", "semmap localize")),
    "truth of another time": (_run_later_than_the_truth, ("overlap",)),
    "map without points": (_build("a.pcd", _pcd("", 0)), ("a.pcd",)),
    "map of NaN": (_build("a.pcd", _pcd("nan nan nan\n" * 3, 3)), ("a.pcd",)),
    "truncated map": (_build("a.pcd", _pcd("1 2 3\n", 9)), ("a.pcd",)),
    "map is text": (_build("a.laz", "hello"), ("a.laz",)),
    "map of an unknown format": (_build("a.stl", "solid"), ("a.stl",)),
    "map that is empty": (_build("a.ply", b""), ("a.ply",)),
    "no map": (lambda b: ["build", str(b.path / "no.laz"), f"--out={b.path / 'out.h5'}"], ("no.laz",)),
    "unknown scenario": (lambda b: ["simulate", "demmo", f"--out={b.path / 'sim'}"], ("demmo", "demo")),
    "mesh is text": (lambda b: ["simulate", str(b.write("a.ply", "hello")), f"--out={b.path / 'sim'}"], ("a.ply",)),
    "route is text": (
        lambda b: ["simulate", "demo", f"--route={b.write('r.csv', 'hello')}", f"--out={b.path / 'sim'}"],
        ("r.csv",),
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_bad_input_is_one_line_and_leaves_nothing(fault: str, bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    arrange, words = FAULTS[fault]
    args = arrange(bench)
    before = bench.files()
    assert cli.run(args) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("semmap: error: ")
    assert captured.err.count("\n") == 1
    for word in words:
        assert word in captured.err
    assert bench.files() == before


def test_an_earlier_run_survives_a_failed_one(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    out = bench.path / "out"
    out.mkdir()
    (out / "trajectory.tum").write_text("# of before\n")
    assert cli.run(bench.localize(map=bench.rig)) == 2
    assert [path.name for path in out.iterdir()] == ["trajectory.tum"]
    assert (out / "trajectory.tum").read_text() == "# of before\n"
