"""Recordings (rosbag1, rosbag2 as sqlite3 or MCAP) as measurements in arrival order, and back, without ROS.

The only file that knows the rosbags library.
"""

from __future__ import annotations

import heapq
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, TypeAlias

from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from semmap.errors import RecordingError, SemmapError
from semmap.measurements import Measurement, Scan
from semmap.messages import DECODERS, MESSAGE_TYPES, MessageMaker, decode_scan, sensor_blocks, stamp_ns
from semmap.plausibility import check_clocks, check_imu, time_samples
from semmap.pointtimes import PointTimeFormat, classify_point_times
from semmap.rig import Rig

Storage: TypeAlias = Literal["mcap", "sqlite3", "bag"]
Progress: TypeAlias = Callable[[int, int], None]

_IMU_SAMPLES = 200
_MAGIC = {b"#ROSBAG V2.0\n": ".bag", b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3\0": ".db3"}
_FORMATS = "a rosbag1 .bag, or a rosbag2 directory, .mcap or .db3"


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic of a recording: its name, message type (ROS 2 spelling) and number of messages."""

    name: str
    type: str
    count: int


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """What a recording holds.

    topics : all topics, by name.
    start_ns, duration_s : by arrival.
    point_times : how the times of the LiDAR's points are read; None without a LiDAR in the rig.
    """

    topics: tuple[TopicInfo, ...]
    start_ns: int
    duration_s: float
    point_times: PointTimeFormat | None


class RecordingReader(Iterator[Measurement]):
    """Measurements of a recording in arrival order, one at a time; made by `read_recording`.

    Attributes
    ----------
    info : `RecordingInfo`.
    dropped : topic -> messages left out so far because they say nothing (not finite, no point in range).
    """

    def __init__(self, path: Path, rig: Rig, progress: Progress | None) -> None:
        self.info = describe_recording(path, rig)
        self.dropped: Counter[str] = Counter()
        self._measurements = self._read(path, rig, progress)

    def __next__(self) -> Measurement:
        return next(self._measurements)

    def _read(self, path: Path, rig: Rig, progress: Progress | None) -> Iterator[Measurement]:
        with _opened(path) as bag:
            decoders = _decoders(rig, self.info.point_times)
            total, done = bag.count(decoders), 0
            for done, (topic, message) in enumerate(bag.messages(decoders), 1):
                measurement = decoders[topic](message)
                if progress is not None and (done % 100 == 0 or done == total):
                    progress(done, total)
                if measurement is None:
                    self.dropped[topic] += 1
                else:
                    yield measurement
            if done < total:
                raise RecordingError(f"breaks off after {done} of {total} messages", mend="record or copy it again")


def read_recording(path: str | Path, rig: Rig, *, progress: Progress | None = None) -> RecordingReader:
    """Measurements of the rig's topics in arrival order, without holding the recording in memory.

    Parameters
    ----------
    path : a rosbag1 ``.bag`` (or a directory with the parts of one), a rosbag2 directory, or a bare ``.mcap``
        or ``.db3``.
    rig : topics, clock offsets, units, range limits.
    progress : called with messages done and messages in all.

    Raises
    ------
    RecordingError
        Where a topic is missing or of another type, stamps or units do not fit, or the recording breaks off.
    CloudError
        Where no cloud has a usable point, or one contradicts its own layout.
    """
    return RecordingReader(Path(path), rig, progress)


def describe_recording(path: str | Path, rig: Rig) -> RecordingInfo:
    """What a recording holds, its clocks, units and point times checked. Raises as `read_recording` does."""
    with _opened(Path(path)) as bag:
        topics = bag.topics()
        _check_topics(topics, rig)
        check_clocks(_first_stamps(bag, rig), bag.duration_s)
        check_imu(islice(bag.messages([rig.imu.topic]), _IMU_SAMPLES), rig.imu)
        point_times = None
        if rig.lidar is not None:
            samples = time_samples((message for _, message in bag.messages([rig.lidar.topic])), rig.lidar)
            point_times = classify_point_times(samples, rig.lidar)
        return RecordingInfo(topics, bag.start_ns, bag.duration_s, point_times)


def _decoders(rig: Rig, times: PointTimeFormat | None) -> dict[str, Callable[[Any], Measurement | None]]:
    decoders: dict[str, Callable[[Any], Measurement | None]] = {
        block.topic: partial(DECODERS[sensor], block=block)
        for sensor, block in sensor_blocks(rig).items()
        if sensor in DECODERS
    }
    if rig.lidar is not None and times is not None:
        decoders[rig.lidar.topic] = partial(decode_scan, block=rig.lidar, times=times)
    return decoders


def _first_stamps(bag: _Bag, rig: Rig) -> dict[str, int]:
    """Topic -> stamp of its first message on the IMU's clock, for the topics that have one."""
    firsts = {block.topic: (block, next(bag.messages([block.topic]), None)) for block in sensor_blocks(rig).values()}
    return {topic: stamp_ns(first[1], block) for topic, (block, first) in firsts.items() if first is not None}


def _check_topics(topics: tuple[TopicInfo, ...], rig: Rig) -> None:
    """Raise where a topic of the rig is missing, of a type it cannot have, or empty where it must not be."""
    present = {topic.name: topic for topic in topics}
    for sensor, block in sensor_blocks(rig).items():
        wanted = MESSAGE_TYPES[sensor]
        fitting = [topic.name for topic in topics if topic.type in wanted]
        others = (
            f"topics that fit: {', '.join(fitting)}" if fitting else f"it has no topic of type {' or '.join(wanted)}"
        )
        topic = present.get(block.topic)
        if topic is None:
            raise RecordingError(f"has no topic {block.topic}", field=f"{sensor}.topic", mend=others)
        if topic.type not in wanted:
            raise RecordingError(f"{block.topic} is of type {topic.type}", field=f"{sensor}.topic", mend=others)
        if not topic.count and sensor in ("imu", "lidar"):
            raise RecordingError(f"{block.topic} has no messages", field=f"{sensor}.topic", mend=others)


class _Bag:
    """Open files of one recording."""

    def __init__(self, readers: list[Any]) -> None:
        self._readers = readers
        self._ros1 = isinstance(readers[0], rosbag1.Reader)
        self._connections: list[Connection] = [x for reader in readers for x in reader.connections]
        self._store = get_typestore(Stores.ROS1_NOETIC if self._ros1 else Stores.ROS2_HUMBLE)
        self.start_ns = min(int(reader.start_time) for reader in readers)
        end_ns = max(int(reader.end_time) for reader in readers)
        self.duration_s = max(end_ns - self.start_ns, 0) * 1e-9

    def topics(self) -> tuple[TopicInfo, ...]:
        counts: Counter[str] = Counter()
        for connection in self._connections:
            counts[connection.topic] += connection.msgcount
        types = {connection.topic: connection.msgtype for connection in self._connections}
        return tuple(TopicInfo(name, types[name], counts[name]) for name in sorted(types))

    def count(self, topics: Collection[str]) -> int:
        return sum(connection.msgcount for connection in self._connections if connection.topic in topics)

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, Any]]:
        """Topic and message by arrival."""
        wanted = [connection for connection in self._connections if connection.topic in topics]
        with _library_errors():
            store = _typestore(wanted, self._store)
        decode = store.deserialize_ros1 if self._ros1 else store.deserialize_cdr
        with _library_errors():
            for connection, _, data in heapq.merge(*self._streams(wanted), key=lambda entry: entry[1]):
                yield connection.topic, decode(data, connection.msgtype)

    def _streams(self, wanted: list[Connection]) -> Iterator[Iterator[tuple[Connection, int, bytes]]]:
        for reader in self._readers:
            mine = [connection for connection in reader.connections if connection in wanted]
            if mine:
                yield reader.messages(connections=mine)


def _typestore(connections: list[Connection], builtin: Any) -> Any:
    """Message types as the recording itself defines them; the built-in ones where it does not (old sqlite3 bags)."""
    types: dict[str, Any] = {}
    for connection in connections:
        if connection.msgdef.format != MessageDefinitionFormat.MSG:
            return builtin
        types.update(get_types_from_msg(connection.msgdef.data, connection.msgtype))
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store


@contextmanager
def _opened(path: Path) -> Iterator[_Bag]:
    """The recording, opened; faults found in the block name it."""
    try:
        with ExitStack() as stack:
            with _library_errors():
                bag = _Bag([stack.enter_context(reader) for reader in _readers(path)])
            yield bag
    except SemmapError as error:
        if error.file is not None:
            raise
        raise type(error)(error.what, file=path, field=error.field, mend=error.mend) from None


@contextmanager
def _library_errors() -> Iterator[None]:
    """Damaged files make the library fail in a dozen ways (assertions, struct, zstd, SQLite): one error for all."""
    try:
        yield
    except SemmapError:
        raise
    except Exception as reason:
        text = str(reason).splitlines()[0].rstrip(".") if str(reason) else type(reason).__name__
        mend = "it is damaged or was not closed: try `mcap recover` or `rosbag reindex`, or copy it again"
        raise RecordingError(f"cannot be read ({text})", mend=mend) from None


def _readers(path: Path) -> list[Any]:
    """Unopened readers of the files of a recording."""
    if not path.exists():
        raise RecordingError("no such file or directory", mend="check the path")
    if not path.is_dir():
        return [_file_reader(path)]
    if (path / "metadata.yaml").exists():
        return [rosbag2.Reader(path)]
    for suffix in _MAGIC.values():
        if parts := sorted(path.glob(f"*{suffix}")):
            return [_file_reader(part) for part in parts]
    raise RecordingError("holds no recording", mend=f"give {_FORMATS}")


def _file_reader(path: Path) -> Any:
    with path.open("rb") as file:
        start = file.read(16)
    suffix = next((suffix for magic, suffix in _MAGIC.items() if start.startswith(magic)), None)
    if suffix is None:
        what = "is not a recording" if start else "is empty"
        raise RecordingError(what, file=path, mend=f"give {_FORMATS}")
    if suffix == ".bag":
        return rosbag1.Reader(path)
    if path.suffix != suffix:
        raise RecordingError(f"is a {suffix} file by its content", file=path, mend=f"rename it to end in {suffix}")
    return rosbag2.Reader(path)


class RecordingWriter:
    """Writes measurements as a recording, whole or not at all.

    Use as a context manager. A block that fails leaves nothing behind. Every topic of the rig is announced,
    even if nothing is written on it.

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
