"""Files that are there whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from semmap.errors import InputFileError


@contextmanager
def written_whole(path: str | Path) -> Iterator[Path]:
    """A temporary path beside ``path``: takes its place when the block ends well, vanishes when it does not.

    Raises `InputFileError` where the place cannot be written.
    """
    path = Path(path)
    if path.is_dir():
        raise InputFileError("is a directory", file=path, mend="name a file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=path.suffix, dir=path.parent)
    except OSError as reason:
        what = f"cannot be written ({reason.strerror})"
        raise InputFileError(what, file=path, mend="choose another --out") from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o644)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
