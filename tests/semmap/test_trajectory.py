"""Trajectories and TUM files."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from semmap.errors import InputFileError, TrajectoryError
from semmap.geometry import se3_exp
from semmap.trajectory import Trajectory, stamp_ns_of_text, text_of_stamp_ns

EPOCH = 1_700_000_000_123_456_789


def track(n: int = 5, frame: str = "map") -> Trajectory:
    xi = np.random.default_rng(0).normal(size=(n, 6)) * [1, 1, 1, 50, 50, 50]
    return Trajectory(frame, EPOCH + 100_000_001 * np.arange(n), se3_exp(xi))


@pytest.mark.parametrize("n", [0, 1, 5])
@pytest.mark.parametrize("frame", ["map", "odom"])
def test_a_tum_file_reads_back_to_the_nanosecond_and_the_micrometre(tmp_path, n, frame):
    written = track(n, frame)
    written.save_tum(tmp_path / "t.tum", comment="one\ntwo")
    read = Trajectory.load_tum(tmp_path / "t.tum")
    assert read.frame == frame
    assert_array_equal(read.stamps_ns, written.stamps_ns)
    assert_allclose(read.positions, written.positions, atol=6e-7)
    assert_allclose(read.poses[:, :3, :3], written.poses[:, :3, :3], atol=1e-8)


def test_mine_grid_coordinates_keep_their_millimetres(tmp_path):
    poses = se3_exp([[0, 0, 0.1, 5_712_345.678, 3_401_234.567, -612.345]])
    Trajectory("map", np.array([EPOCH]), poses).save_tum(tmp_path / "t.tum")
    assert_allclose(Trajectory.load_tum(tmp_path / "t.tum").positions, poses[:, :3, 3], rtol=0, atol=1e-6)


def test_a_tum_file_of_others_is_in_the_map_unless_told(tmp_path):
    (tmp_path / "t.tum").write_text("# time x y z qx qy qz qw\n\n1.5 1 2 3 0 0 0 1\n  2 4 5 6 0 0 0 -2\n")
    read = Trajectory.load_tum(tmp_path / "t.tum")
    assert (read.frame, read.stamps_ns.tolist()) == ("map", [1_500_000_000, 2_000_000_000])
    assert_allclose(read.poses[:, :3, :3], [np.eye(3)] * 2)
    assert Trajectory.load_tum(tmp_path / "t.tum", frame="odom").frame == "odom"


def test_length_and_interpolation():
    poses = se3_exp([[0, 0, 0, 0, 0, 0], [0, 0, 0, 3, 4, 0], [0, 0, 0, 3, 4, 12]])
    straight = Trajectory("map", np.array([0, 10, 20]), poses)
    assert straight.length() == pytest.approx(17.0)
    assert_allclose(straight.at(np.array([5, 20, 99]))[:, :3, 3], [[1.5, 2, 0], [3, 4, 12], [3, 4, 12]])
    assert track(1).length() == track(0).length() == 0.0


@pytest.mark.parametrize(
    ("text", "stamp_ns"),
    [
        ("1700000000.123456789", EPOCH),
        ("1.7000000001234568e9", 1_700_000_000_123_456_800),
        ("0", 0),
        (".5", 500_000_000),
        ("3.", 3_000_000_000),
        ("-0.25", -250_000_000),
        ("+2.0000000004", 2_000_000_000),
    ],
)
def test_stamps_are_exact(text, stamp_ns):
    assert stamp_ns_of_text(text) == stamp_ns


@pytest.mark.parametrize("stamp_ns", [EPOCH, 0, 1, -1, -1_500_000_000])
def test_stamps_survive_their_text(stamp_ns):
    assert stamp_ns_of_text(text_of_stamp_ns(stamp_ns)) == stamp_ns


BAD_FILES = {
    "seven columns": ("0 1 2 3 0 0 0\n", r"line 1: has 7 columns; write `stamp x y z qx qy qz qw`"),
    "words": ("# c\n0 a 2 3 0 0 0 1\n", r"line 2: could not convert"),
    "a word for a stamp": ("now 1 2 3 0 0 0 1\n", r"line 1: stamp 'now' is not a number of seconds"),
    "NaN for a stamp": ("nan 1 2 3 0 0 0 1\n", r"line 1: stamp 'nan'"),
    "an endless stamp": ("1e999 1 2 3 0 0 0 1\n", r"line 1: stamp '1e999'"),
    "NaN": ("0 nan 2 3 0 0 0 1\n", "not finite or not a rotation"),
    "zero quaternion": ("0 1 2 3 0 0 0 0\n", "not finite or not a rotation"),
    "time runs back": ("1 1 2 3 0 0 0 1\n0 1 2 3 0 0 0 1\n", "stamps do not increase; sort"),
    "a stamp twice": ("1 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n", "stamps do not increase"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_tum_files(name, tmp_path):
    text, pattern = BAD_FILES[name]
    (tmp_path / "t.tum").write_text(text)
    with pytest.raises(TrajectoryError, match=pattern) as caught:
        Trajectory.load_tum(tmp_path / "t.tum")
    assert caught.value.file == tmp_path / "t.tum"


def test_files_that_are_not_text(tmp_path):
    (tmp_path / "t.tum").write_bytes(b"\x80\xff")
    for path in (tmp_path / "t.tum", tmp_path / "none.tum", tmp_path):
        with pytest.raises(TrajectoryError, match="cannot be read"):
            Trajectory.load_tum(path)


def test_a_trajectory_refuses_what_is_none():
    with pytest.raises(TrajectoryError, match="2 stamps for 1 poses"):
        Trajectory("map", np.array([0, 1]), np.eye(4)[None])
    with pytest.raises(TrajectoryError, match="not finite"):
        Trajectory("map", np.array([0]), np.full((1, 4, 4), np.nan))
    with pytest.raises(TrajectoryError, match="no poses"):
        track(0).at(np.array([0]))


def test_a_place_that_cannot_be_written(tmp_path):
    with pytest.raises(InputFileError, match="is a directory"):
        track().save_tum(tmp_path)
