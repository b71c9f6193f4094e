"""`semmap map` as people run it: a recording alone becomes a map and a database; and its faults."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial import cKDTree

from maps.las import las_extent, las_points
from semmap import database
from semmap.geometry import transform
from semmap.trajectory import Trajectory
from tests.small_files import RIG, write_recording
from tools import cli

SECONDS = 40


def run(*words: object) -> int:
    return cli.run([str(word) for word in words])


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording from a built-in mine, and what `semmap map` makes of it: ``own.laz``, ``own.h5``."""
    out = tmp_path_factory.mktemp("mine")
    config = out / "config.yaml"
    config.write_text(f"simulate: {{duration_s: {SECONDS}}}\n")
    assert run("simulate", "demo", "--out", out, "--config", config, "--seed", 4) == 0
    words = ("--rig", out / "rig.yaml", "--out", out / "own.laz", "--database", out / "own.h5")
    assert run("map", out / "recording", *words) == 0
    return out


def points_of(path: Path) -> np.ndarray:
    return np.concatenate(list(las_points(path, 0, las_extent(path).rows, 1 << 20)))


def in_the_mine(mine: Path, p_own: np.ndarray) -> np.ndarray:
    """Points (n, 3) of the run's own frame, in the truth's by the first pose: it begins at odom's origin, level."""
    truth = Trajectory.load_tum(mine / "ground_truth.tum")
    T = truth.poses[0].copy()
    yaw = np.arctan2(T[1, 0], T[0, 0])
    T[:3, :3] = [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
    return transform(T, p_own)


def test_its_points_lie_on_the_rock(mine: Path) -> None:
    rock = cKDTree(points_of(mine / "prior_map.laz"))
    off, _ = rock.query(in_the_mine(mine, points_of(mine / "own.laz")))
    assert np.median(off) < 0.08 and np.percentile(off, 90) < 0.15  # the prior map's points are 0.1 m apart


def test_its_points_are_thinned(mine: Path) -> None:
    points = points_of(mine / "own.laz")
    assert len(points) > 50_000
    assert len(np.unique(np.floor(points / 0.1 + 1e-6).astype(int), axis=0)) > 0.98 * len(points)


def test_the_database_holds_what_was_passed(mine: Path) -> None:
    junctions = np.loadtxt(mine / "junctions.csv", delimiter=",", skiprows=1, usecols=(1, 2, 3))
    found = in_the_mine(mine, np.array([one.p_map for one in database.load(mine / "own.h5").intersections]))
    assert len(found) >= 2
    assert np.linalg.norm(found[:, None, :2] - junctions[None, :, :2], axis=-1).min(axis=1).max() < 2.0


def test_another_run_finds_its_way_in_it(mine: Path) -> None:
    out = mine / "again"
    words = ("--rig", mine / "rig.yaml", "--map", mine / "own.h5", "--out", out)
    assert run("localize", mine / "recording", *words) == 0
    found, truth = (Trajectory.load_tum(path) for path in (out / "trajectory.tum", mine / "ground_truth.tum"))
    assert found.frame == "map" and len(found) > 9 * SECONDS
    off = in_the_mine(mine, found.positions) - truth.at(found.stamps_ns)[:, :3, 3]
    assert np.linalg.norm(off, axis=1).max() < 0.15


@pytest.fixture
def small(tmp_path: Path) -> Path:
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(RIG))
    write_recording(tmp_path / "recording", tmp_path / "rig.yaml")
    return tmp_path


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--out", "{0}/map.xyz"), "name it .laz or .las"),
        (("--out", "{0}/map.laz", "--without", "lidar"), "a map is made of its scans"),
        (("--out", "{0}/map.laz", "--without", "weel"), "did you mean `wheel`"),
        (("--out", "{0}/rig.yaml/map.laz"), "is a file, not a directory"),
        (("--out", "{0}/map.laz", "--database", "{0}"), "is a directory, not a file"),
    ],
)
def test_faults_are_told_in_one_line(
    small: Path, words: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = tuple(word.format(small) for word in words)
    assert run("map", small / "recording", "--rig", small / "rig.yaml", *words) == 2
    assert told in capsys.readouterr().err
    assert not (small / "map.laz").exists()


def test_a_map_in_the_frame_of_a_station_that_never_saw_it_is_refused(
    small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    station = {"topic": "/prism", "position": [0.0, 0.0, 1.5], "point_std": 0.002, "p_imu_prism": [0.0, 0.0, 0.3]}
    (small / "rig.yaml").write_text(yaml.safe_dump({**RIG, "total_station": station}))
    write_recording(small / "unseen", small / "rig.yaml")
    words = ("map", small / "unseen", "--rig", small / "rig.yaml", "--out", small / "map.laz")
    assert run(*words) == 2
    assert "never found its place" in capsys.readouterr().err
    assert not (small / "map.laz").exists()
