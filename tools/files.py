"""Where results go: checked before the work, written whole after it."""

from __future__ import annotations

import os
from pathlib import Path

from semmap.errors import InputFileError
from semmap.files import written_whole


def writable_directory(out: Path) -> None:
    """Make sure that ``out`` can take files, before hours of work; raises `InputFileError`."""
    there = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not there.is_dir():
        raise InputFileError("is a file, not a directory", file=there, mend="choose another --out")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputFileError("cannot be written", file=there, mend="choose another --out")


def writable_file(out: Path) -> None:
    """Make sure that ``out`` can become a file, before hours of work; raises `InputFileError`."""
    if out.is_dir():
        raise InputFileError("is a directory, not a file", file=out, mend="choose another --out")
    writable_directory(out.parent)


def write_text(path: Path, text: str) -> None:
    """Write ``text`` to ``path`` whole or not at all."""
    with written_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
