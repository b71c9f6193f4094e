"""Prism fixes from a file beside the recording: CSV, or what Leica instruments export (GSI-8 and GSI-16)."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from semmap.errors import InputFileError
from semmap.measurements import PrismFix
from semmap.trajectory import stamp_ns_of_text

_FOOT_M = 0.3048
_UNITS_M = {"0": 1e-3, "1": 1e-3 * _FOOT_M, "6": 1e-4, "7": 1e-4 * _FOOT_M, "8": 1e-5}
"""Position 6 of a GSI word -> what one of its last digit is [m]."""
_AXES = ("81", "82", "83")
"""Word indices of the target's easting, northing and height."""
_WORD = re.compile(r"(\d\d)(....)([+-])(\S+)")
_TIME_MEND = "export words 18 and 19 (time), or write a CSV `time,x,y,z`"

Fix = tuple[int, list[float]]


def read_prism_file(path: str | Path) -> tuple[PrismFix, ...]:
    """Fixes of a file in order of time, on the instrument's clock; of several at one time the first.

    A CSV has the columns ``time`` (or ``stamp``) in seconds and ``x, y, z`` in metres in the map frame. GSI holds
    easting, northing and height (words 81 to 83) as x, y, z, and the time in words 18 and 19, which is the
    instrument's own, read as if it were UTC: `localize.clock_offset` finds what is between the two clocks.

    Raises
    ------
    InputFileError
        With the line at fault; also where no line holds a fix.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as reason:
        raise InputFileError(f"cannot be read ({reason.strerror})", file=path, mend="check the path") from None
    lines = text.splitlines()
    is_gsi = any(_WORD.match(line.lstrip("* ")) for line in lines[:20])
    found: dict[int, list[float]] = {}
    for stamp_ns, point in _gsi(path, lines) if is_gsi else _csv(path, lines):
        found.setdefault(stamp_ns, point)
    if not found:
        raise InputFileError("holds no prism fixes", file=path, mend="give a CSV `time,x,y,z`, or GSI-8 or GSI-16")
    return tuple(PrismFix(stamp_ns, np.array(found[stamp_ns])) for stamp_ns in sorted(found))


def _csv(path: Path, lines: list[str]) -> Iterator[Fix]:
    reader = csv.DictReader(lines, skipinitialspace=True)
    reader.fieldnames = [name.strip().lower() for name in reader.fieldnames or []]
    clock = "stamp" if "stamp" in reader.fieldnames and "time" not in reader.fieldnames else "time"
    missing = [name for name in (clock, "x", "y", "z") if name not in reader.fieldnames]
    if missing:
        what = f"has no column {missing[0]}"
        raise InputFileError(what, file=path, field="line 1", mend="columns: time,x,y,z")
    for row in reader:
        try:
            stamp_ns, point = stamp_ns_of_text(row[clock].strip()), [float(row[axis]) for axis in "xyz"]
            if not np.isfinite(point).all():
                raise ValueError
        except (AttributeError, TypeError, ValueError):
            field = f"line {reader.line_num}"
            raise InputFileError("is not a prism fix", file=path, field=field, mend="columns: time,x,y,z") from None
        yield stamp_ns, point


def _gsi(path: Path, lines: list[str]) -> Iterator[Fix]:
    """Fixes of the measurement blocks; blocks without the three coordinates (codes, angles) are passed over."""
    for number, line in enumerate(lines, 1):
        words = {match[1]: match for word in line.lstrip("* ").split() if (match := _WORD.fullmatch(word))}
        if not all(axis in words for axis in _AXES):
            continue
        try:
            point = [_metres(words[axis]) for axis in _AXES]
            stamp_ns = _gsi_time(words["18"][4], words["19"][4])
        except KeyError as missing:
            what = f"has no time (word {missing.args[0]})" if missing.args[0] in ("18", "19") else "has no metric unit"
            raise InputFileError(what, file=path, field=f"line {number}", mend=_TIME_MEND) from None
        except ValueError:
            what = "holds digits that are no number or no time"
            raise InputFileError(what, file=path, field=f"line {number}", mend="export it again") from None
        yield stamp_ns, point


def _metres(word: re.Match[str]) -> float:
    """The value of a coordinate word; `KeyError` where its unit is none of length."""
    return int(word[3] + word[4]) * _UNITS_M[word[2][-1]]


def _gsi_time(first: str, second: str) -> int:
    """Nanoseconds of ``YYSSmmm.`` and ``MMDDhhmm``, the (last) eight digits of the two words."""
    year, second_, millisecond = int(first[-8:-6]), int(first[-6:-4]), int(first[-4:-1])
    month, day, hour, minute = (int(second[-8:][k : k + 2]) for k in (0, 2, 4, 6))
    at = datetime(2000 + year, month, day, hour, minute, second_, tzinfo=UTC)
    return int(at.timestamp()) * 1_000_000_000 + millisecond * 1_000_000
