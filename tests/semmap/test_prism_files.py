"""Prism fixes from files: CSV and GSI, and the line that says what is wrong with one."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest
from numpy.testing import assert_allclose

from semmap.errors import InputFileError
from semmap.prism_files import read_prism_file

AT = datetime(2026, 11, 22, 22, 41, 7, 250_000, tzinfo=UTC)
STAMP_NS = int(datetime(2026, 11, 22, 22, 41, 7, tzinfo=UTC).timestamp()) * 1_000_000_000 + 250_000_000
TIME_8 = "18....+26072500 19....+11222241"
TIME_16 = "18....+0000000026072500 19....+0000000011222241"


def written(tmp_path, text: str, name: str = "fixes.gsi"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("header", ["time,x,y,z", "stamp, X, Y, Z, note", "\ufefftime,x,y,z"])
def test_csv(tmp_path, header) -> None:
    lines = [header, "1700000001.123456789,1.5,-2.5,3.25,a", "1700000000.5,1,2,3,b"]
    first, second = read_prism_file(written(tmp_path, "\n".join(lines), "fixes.csv"))
    assert first.stamp_ns == 1_700_000_000_500_000_000
    assert second.stamp_ns == 1_700_000_001_123_456_789
    assert_allclose(second.p_map, [1.5, -2.5, 3.25])


@pytest.mark.parametrize(
    "line",
    [
        f"110001+0000A110 81..00+00005387 82..00-00000992 83..00+00001500 {TIME_8}",
        f"*110001+000000000000A110 81..06+0000000000053870 82..06-0000000000009920 83..06+0000000000015000 {TIME_16}",
        f"*110001+000000000000A110 81..08+0000000000538700 82..08-0000000000099200 83..08+0000000000150000 {TIME_16}",
    ],
)
def test_gsi(tmp_path, line) -> None:
    (fix,) = read_prism_file(written(tmp_path, line + "\n"))
    assert fix.stamp_ns == STAMP_NS == round(AT.timestamp() * 1e3) * 1_000_000
    assert_allclose(fix.p_map, [5.387, -0.992, 1.5], atol=1e-12)


def test_gsi_in_feet_with_mine_coordinates(tmp_path) -> None:
    line = f"*110001+0000000000000007 81..11+0000000001000000 82..11+0000000002000000 83..11-0000000000100000 {TIME_16}"
    (fix,) = read_prism_file(written(tmp_path, line))
    assert_allclose(fix.p_map, np.array([1000.0, 2000.0, -100.0]) * 0.3048)


def test_code_blocks_and_blocks_without_coordinates_are_passed_over(tmp_path) -> None:
    text = "\n".join(
        [
            "410001+00130027 42....+00001810",
            "110002+00130021 21.102+19723700 22.102+10000000 31..00+00045179",
            f"110003+00000003 81..00+00001000 82..00+00002000 83..00+00003000 {TIME_8}",
            f"110004+00000004 81..00+00009000 82..00+00002000 83..00+00003000 {TIME_8}",
        ]
    )
    (fix,) = read_prism_file(written(tmp_path, text))
    assert_allclose(fix.p_map, [1.0, 2.0, 3.0])  # the first of two at one time


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("time,x,y\n1,2,3\n", "a.csv", r"a\.csv: line 1: has no column z; columns: time,x,y,z"),
        ("time,x,y,z\n1,2,3,4\n2,a,3,4\n", "a.csv", r"line 3: is not a prism fix"),
        ("time,x,y,z\n1,nan,3,4\n", "a.csv", r"line 2: is not a prism fix"),
        ("time,x,y,z\n1,2\n", "a.csv", r"line 2: is not a prism fix"),
        ("time,x,y,z\n", "a.csv", "holds no prism fixes"),
        ("", "a.csv", "has no column"),
        (
            "110001+00000001 81..00+00005387 82..00-00000992 83..00+00001500",
            "a.gsi",
            r"line 1: has no time \(word 18\); export words 18 and 19",
        ),
        (f"110001+00000001 81..02+00005387 82..00-00000992 83..00+00001500 {TIME_8}", "a.gsi", "no metric unit"),
        (f"110001+00000001 81..00+0000538A 82..00-00000992 83..00+00001500 {TIME_8}", "a.gsi", "no number"),
        (
            "110001+00000001 81..00+00005387 82..00+00000992 83..00+00001500 18....+26072500 19....+13222241",
            "a.gsi",
            "no time",
        ),
        ("110002+00130021 21.102+19723700 22.102+10000000", "a.gsi", "holds no prism fixes"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, text, name, message) -> None:
    with pytest.raises(InputFileError, match=message):
        read_prism_file(written(tmp_path, text, name))


def test_a_file_that_is_not_there(tmp_path) -> None:
    with pytest.raises(InputFileError, match="cannot be read"):
        read_prism_file(tmp_path / "none.csv")
