"""HDF5 files read with suspicion and written to the same bytes: the only file that knows h5py.

No link is followed, nothing is unpickled, and what a data set claims to hold is checked before it is read.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from semmap.errors import DatabaseError

_CHUNK_ROWS = 16384
_MAX_PACKING = 1100  # gzip packs no tighter; a file that claims to would fill the memory with nothing
_KIND_TYPE = "S16"
_REBUILD = "build it again with `semmap build`"
_LIBRARY_ERRORS = (OSError, RuntimeError, LookupError, ValueError, TypeError, ArithmeticError, MemoryError)


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Faults found in the block name the file and a mend, if they do not yet."""
    try:
        yield
    except DatabaseError as error:
        raise DatabaseError(
            error.what, file=error.file or path, field=error.field, mend=error.mend or _REBUILD
        ) from None


@dataclass(frozen=True, slots=True)
class Stamp:
    """A file as it was when it was opened, to be opened again later: then it must be the same.

    path : absolute. name : as the user gave it. size : [bytes]. mtime_ns, inode : of its last change, and which it is.
    """

    path: Path
    name: str | Path
    size: int
    mtime_ns: int
    inode: int

    @classmethod
    def of(cls, path: str | Path) -> Self:
        """Of a file; raises `DatabaseError` where there is none."""
        try:
            facts = os.stat(path)
        except OSError:
            raise DatabaseError("is no longer there", file=path, mend="load it from where it is now") from None
        return cls(Path(path).absolute(), path, facts.st_size, facts.st_mtime_ns, facts.st_ino)

    @contextmanager
    def opened(self) -> Iterator[Any]:
        """The root group, if the file is still what it was. Raises `DatabaseError` that names the file."""
        with naming(self.name):
            self._check()
            with opened(self.path) as file:
                yield file
            self._check()

    def _check(self) -> None:
        now = Stamp.of(self.path)
        if (now.size, now.mtime_ns, now.inode) != (self.size, self.mtime_ns, self.inode):
            raise DatabaseError("has changed since it was loaded", mend="load it again")


@contextmanager
def opened(path: str | Path) -> Iterator[Any]:
    """The root group of a file, to read; whatever the library says of a damaged one becomes a `DatabaseError`."""
    if not h5py.is_hdf5(path):
        raise DatabaseError("is not a semantic database (not HDF5)")
    try:
        with h5py.File(path, "r") as file:
            yield file
    except _LIBRARY_ERRORS as reason:
        text = str(reason).splitlines()[0] if str(reason) else type(reason).__name__
        raise DatabaseError(f"is damaged ({text})", mend=f"copy it again or {_REBUILD}") from None


@contextmanager
def created(path: str | Path) -> Iterator[Any]:
    """The root group of a new file."""
    try:
        with h5py.File(path, "w") as file:
            yield file
    except OSError as reason:
        what = f"cannot be written ({str(reason).splitlines()[0]})"
        raise DatabaseError(what, mend="free some space, or choose another --out") from None


def read_text(file: Any, name: str) -> str:
    """An attribute that must be text."""
    value = file.attrs.get(name)
    if not isinstance(value, str):
        raise DatabaseError("is missing or not text", field=name)
    return value


def read_whole_number(file: Any, name: str) -> int:
    """An attribute that must be a whole number."""
    value = file.attrs.get(name)
    if not isinstance(value, np.integer):
        raise DatabaseError("is not a whole number", field=name)
    return int(value)


def read_numbers(file: Any, name: str, count: int) -> NDArray[np.float64]:
    """An attribute that must be ``count`` finite numbers."""
    value = file.attrs.get(name)
    if not isinstance(value, np.ndarray) or value.dtype.kind != "f" or value.shape != (count,):
        raise DatabaseError(f"is not {count} numbers", field=name)
    if not np.isfinite(value).all():
        raise DatabaseError("is not finite", field=name)
    return value.astype(np.float64)


def read_json(file: Any, name: str) -> dict[str, Any]:
    """An attribute that must be a JSON object."""
    try:
        value = json.loads(read_text(file, name))
    except json.JSONDecodeError:
        raise DatabaseError("is not JSON", field=name) from None
    if not isinstance(value, dict):
        raise DatabaseError("is not a mapping", field=name)
    return value


def write_json(file: Any, name: str, value: dict[str, Any]) -> None:
    """An attribute that `read_json` reads."""
    file.attrs[name] = json.dumps(value, sort_keys=True, allow_nan=False)


class Group:
    """A group of columns to read; every access checks the link, the type, the shape, and that numbers are finite."""

    def __init__(self, file: Any, name: str) -> None:
        self._name = name
        if not isinstance(file.get(name, getlink=True), h5py.HardLink) or not isinstance(file[name], h5py.Group):
            raise DatabaseError("is missing or not a group", field=name)
        self._group = file[name]

    def fault(self, name: str, what: str) -> DatabaseError:
        """An error about one column."""
        return DatabaseError(what, field=f"{self._name}/{name}")

    def shape(self, name: str, dtype: Any, shape: tuple[int | None, ...]) -> tuple[int, ...]:
        """Shape of a data set, checked but not read; None in ``shape`` stands for any length."""
        return tuple(self._data(name, dtype, shape).shape)

    def column(self, name: str, dtype: Any, shape: tuple[int | None, ...]) -> NDArray[Any]:
        """All of a data set of exactly ``dtype``; None in ``shape`` stands for any length."""
        return self._finite(name, self._data(name, dtype, shape)[()])

    def rows(self, name: str, dtype: Any, shape: tuple[int | None, ...], rows: slice) -> NDArray[Any]:
        """Some rows of a data set."""
        return self._finite(name, self._data(name, dtype, shape)[rows])

    def kinds(self, name: str, n: int, known: tuple[str, ...]) -> NDArray[np.str_]:
        """A column (n,) of words, each one of those known."""
        codes, rows = np.unique(self.column(name, _KIND_TYPE, (n,)), return_inverse=True)
        words = [code.decode("ascii", "replace") for code in codes.tolist()]
        if unknown := set(words) - set(known):
            raise self.fault(name, f"holds {unknown.pop()!r}, which is none of {', '.join(known)}")
        return np.array(words, np.str_)[rows]

    def at_least_0(self, name: str, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
        """A column of numbers none of which is negative."""
        values = self.column(name, np.float64, shape)
        if (values < 0.0).any():
            raise self.fault(name, "holds a negative number")
        return values

    def offsets(self, owner: str, rows: int, values: str, length: int) -> NDArray[np.int64]:
        """Where each of the rows begins in a ragged column of this length, and where the last ends."""
        offsets = self.column(f"{owner}_offsets", np.int64, (rows + 1,))
        if offsets[0] != 0 or offsets[-1] != length or (np.diff(offsets) < 0).any():
            raise self.fault(f"{owner}_offsets", f"do not divide the {length} rows of {owner}_{values}")
        return offsets

    def _data(self, name: str, dtype: Any, shape: tuple[int | None, ...]) -> Any:
        if not isinstance(self._group.get(name, getlink=True), h5py.HardLink):
            raise self.fault(name, "is missing or a link to elsewhere")
        data = self._group[name]
        if not isinstance(data, h5py.Dataset) or data.is_virtual or data.external:
            raise self.fault(name, "is not a data set of this file")
        if data.dtype != np.dtype(dtype):
            raise self.fault(name, f"is of type {data.dtype}, not {np.dtype(dtype)}")
        fits = len(data.shape) == len(shape) and all(w in (None, n) for n, w in zip(data.shape, shape, strict=True))
        if not fits:
            wanted = ", ".join("any" if n is None else str(n) for n in shape)
            raise self.fault(name, f"has shape {data.shape}, not ({wanted})")
        if data.nbytes > _MAX_PACKING * data.id.get_storage_size():
            raise self.fault(name, f"claims {data.nbytes} bytes and holds {data.id.get_storage_size()}")
        return data

    def _finite(self, name: str, values: NDArray[Any]) -> NDArray[Any]:
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise self.fault(name, "holds NaN or infinity")
        return values


def write_column(group: Any, name: str, data: NDArray[Any]) -> None:
    """A data set in one piece: fast to read whole."""
    group.create_dataset(name, data=data, track_times=False)


def write_kinds(group: Any, name: str, kinds: NDArray[np.str_]) -> None:
    """A column (n,) of words, as `Group.kinds` reads it."""
    write_column(group, name, np.char.encode(kinds, "ascii", "replace").astype(_KIND_TYPE))


class Appender:
    """A compressed data set that grows row by row; only a chunk of it is kept in memory."""

    def __init__(self, group: Any, name: str, dtype: Any, row_shape: tuple[int, ...]) -> None:
        self._data = group.create_dataset(
            name,
            shape=(0, *row_shape),
            maxshape=(None, *row_shape),
            dtype=dtype,
            chunks=(_CHUNK_ROWS, *row_shape),
            shuffle=True,
            compression="gzip",
            track_times=False,
        )
        self._waiting: list[NDArray[Any]] = []

    def append(self, rows: NDArray[Any]) -> None:
        """Add rows (k, ...)."""
        self._waiting.append(rows)
        if sum(map(len, self._waiting)) >= _CHUNK_ROWS:
            waiting = np.concatenate(self._waiting)
            whole = len(waiting) - len(waiting) % _CHUNK_ROWS
            self._write(waiting[:whole])
            self._waiting = [waiting[whole:].copy()]

    def _write(self, rows: NDArray[Any]) -> None:
        length = len(self._data)
        self._data.resize(length + len(rows), axis=0)
        self._data[length:] = rows

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None and self._waiting:
            self._write(np.concatenate(self._waiting))
