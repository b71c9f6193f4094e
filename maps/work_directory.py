"""A directory for what is finished of a long build: kept when the build breaks off, gone when it is done."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from semmap.errors import BuildError, InputFileError, SemmapError
from semmap.files import written_whole

_MANIFEST, _LOCK = "manifest.json", "lock"


@contextmanager
def work_directory(path: Path, identity: Mapping[str, Any]) -> Iterator[None]:
    """Hold the directory ``path`` for one build.

    identity : plain data that says what is built from what. What a build with the same one left there stays; anything
        else is removed first. The directory goes when the block ends, or fails because of the user's input; it stays
        where the build breaks off for another reason, and can go on later.

    Raises
    ------
    BuildError
        Where another build holds the directory, or it holds files that no build put there.
    InputFileError
        Where it cannot be made.
    """
    lock = _locked(path)
    try:
        with writing(path):
            _prepare(path, json.loads(json.dumps(identity)))
        try:
            yield
        except BuildError:
            raise
        except SemmapError:
            _remove(path)
            raise
        _remove(path)
    finally:
        os.close(lock)


@contextmanager
def kept_whole(path: Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place when the block ends well. Raises `BuildError`."""
    with writing(path):
        try:
            with written_whole(path) as temporary:
                yield temporary
        except InputFileError as error:
            if error.file != path:
                raise  # what the block reads is at fault, not what it writes
            raise BuildError(error.what, file=path, mend=_MAKE_ROOM) from None


_MAKE_ROOM = "make room there and run the same command again, it goes on with what is finished"


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """A full or failing disk in the block is a `BuildError` that names ``path``."""
    try:
        yield
    except OSError as reason:
        raise BuildError(f"cannot be written ({reason.strerror})", file=path, mend=_MAKE_ROOM) from None


def _locked(path: Path) -> int:
    """Make the directory and lock it; the lock goes with the process, however it ends."""
    while True:
        try:
            if path.is_dir() and (others := {entry.name for entry in path.iterdir()}) and _LOCK not in others:
                raise BuildError("holds files that are not semmap's", file=path, mend="move it away")
            path.mkdir(parents=True, exist_ok=True)
            lock = os.open(path / _LOCK, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as reason:
            what = f"cannot be made ({reason.strerror})"
            raise InputFileError(what, file=path, mend="choose another --out") from None
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            mend = "wait for it, or choose another --out"
            raise BuildError("another build is at work there", file=path, mend=mend) from None
        except OSError:
            return lock  # a file system without locks
        if _is_at(path / _LOCK, lock):
            return lock
        os.close(lock)  # the build that held it just ended and took the directory with it


def _is_at(path: Path, file: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(file))
    except FileNotFoundError:
        return False


def _prepare(path: Path, identity: dict[str, Any]) -> None:
    """Empty the directory unless what is there was made from the same."""
    manifest = path / _MANIFEST
    try:
        if json.loads(manifest.read_text(encoding="utf-8")) == identity:
            return
    except (FileNotFoundError, ValueError):
        pass
    manifest.unlink(missing_ok=True)
    for entry in path.iterdir():
        if entry.name != _LOCK:
            entry.unlink()
    with written_whole(manifest) as temporary:
        temporary.write_text(json.dumps(identity), encoding="utf-8")


def _remove(path: Path) -> None:
    """Take the directory out of the way at once, then remove it: nobody finds half of it."""
    aside = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    path.replace(aside)
    shutil.rmtree(aside, ignore_errors=True)
