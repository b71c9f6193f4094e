"""Recordings: rosbag1, and rosbag2 as sqlite3 or MCAP, as measurements in arrival order, and back. Needs no ROS.

The only file that knows the rosbags library.
"""

from __future__ import annotations

import heapq
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from semmap.errors import CloudError, RecordingError, SemmapError
from semmap.measurements import Measurement, Scan
from semmap.messages import MESSAGE_TYPES, MessageMaker, sensor_blocks
from semmap.rig import Rig

Storage = Literal["mcap", "sqlite3", "bag"]


class RecordingWriter:
    """Writes measurements as a recording, whole or not at all.

    Use as a context manager. A block that fails leaves nothing behind. Every topic of the rig is announced, even if
    nothing is written on it.

    Parameters
    ----------
    path : directory (rosbag2) or ``.bag`` file (rosbag1) to make; it must not exist.
    rig : topics, clock offsets and units of the messages.
    storage : ``mcap`` (zstd-compressed), ``sqlite3``, or ``bag`` for rosbag1 (lz4-compressed).

    Raises
    ------
    RecordingError
        If ``path`` exists or cannot be made, or a measurement has no block in the rig.
    """

    def __init__(self, path: str | Path, rig: Rig, storage: Storage = "mcap") -> None:
        self._path, self._rig, self._storage = Path(path), rig, storage
        self._store = get_typestore(Stores.ROS1_NOETIC if storage == "bag" else Stores.ROS2_HUMBLE)
        self._serialize = self._store.serialize_ros1 if storage == "bag" else self._store.serialize_cdr
        self._maker = MessageMaker(self._store.types, rig, ros1=storage == "bag")
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> Self:
        if self._path.exists():
            raise RecordingError("exists already", file=self._path, mend="remove it or write somewhere else")
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._aside = Path(tempfile.mkdtemp(prefix=f".{self._path.name}.", dir=self._path.parent))
        except OSError as reason:
            what = f"cannot be written ({reason.strerror})"
            raise RecordingError(what, file=self._path, mend="write somewhere else") from None
        self._writer = self._open_writer(self._aside / self._path.name)
        self._writer.open()
        for sensor, block in sensor_blocks(self._rig).items():
            self._connections[sensor] = self._writer.add_connection(
                block.topic, MESSAGE_TYPES[sensor][0], typestore=self._store
            )
        return self

    def _open_writer(self, path: Path) -> Any:
        if self._storage == "bag":
            bag = rosbag1.Writer(path)
            bag.set_compression(bag.CompressionFormat.LZ4)
            return bag
        plugin = rosbag2.StoragePlugin.MCAP if self._storage == "mcap" else rosbag2.StoragePlugin.SQLITE3
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        if self._storage == "mcap":
            writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)
        return writer

    def write(self, measurement: Measurement) -> None:
        """Append a measurement. It arrives at its stamp, a scan when its last point is measured."""
        sensor = self._maker.sensor_of(measurement)
        message = self._maker.make(measurement)
        arrival_ns = measurement.end_ns if isinstance(measurement, Scan) else measurement.stamp_ns
        data = self._serialize(message, MESSAGE_TYPES[sensor][0])
        self._writer.write(self._connections[sensor], arrival_ns, data)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._writer.close()
                (self._aside / self._path.name).rename(self._path)
            else:
                self._writer.abort()
        finally:
            shutil.rmtree(self._aside, ignore_errors=True)
