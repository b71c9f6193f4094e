"""Recordings: what is written is read, in all three formats; what is damaged or does not fit is refused in one line."""

import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from semmap.errors import CloudError, RecordingError, SemmapError
from semmap.measurements import ImuSample, PrismFix, Scan, UwbRange, WheelSpeed
from semmap.recordings import RecordingWriter, TopicInfo, describe_recording, read_recording
from semmap.rig import Rig

START = 1_700_000_000_123_456_789
STORAGES = ["mcap", "sqlite3", "bag"]
STORE = get_typestore(Stores.ROS2_HUMBLE)
BENCHMARK = Path(__file__).resolve().parents[3] / "shared" / "data" / "edgar_mine"


def some_measurements(n_scans: int = 6, n_points: int = 300) -> list:
    """Half a second of everything, in arrival order."""
    rng = np.random.default_rng(0)
    out = []
    for k in range(n_scans):
        t = START + k * 100_000_000
        for j in range(10):
            out.append(ImuSample(t + j * 10_000_000, rng.normal(size=3), rng.normal(size=3) + [0, 0, 9.8]))
        out.append(WheelSpeed(t + 91_000_000, rng.normal()))
        out.append(UwbRange(t + 92_000_000, 100 + k % 2, float(np.float32(rng.uniform(1, 20)))))
        out.append(PrismFix(t + 93_000_000, rng.normal(size=3) + [5.7e6, 3.4e6, -600]))
        points = rng.uniform(1, 10, (n_points, 3)).astype(np.float32)
        offsets = np.linspace(0, 99_999_999, n_points).astype(np.int64)
        ring = rng.integers(0, 16, n_points).astype(np.uint16)
        out.append(Scan(t, points, offsets, ring, rng.random(n_points, dtype=np.float32)))
    return out


def record(path: Path, rig: Rig, measurements=None, storage: str = "mcap") -> Path:
    with RecordingWriter(path, rig, storage) as writer:
        for measurement in some_measurements() if measurements is None else measurements:
            writer.write(measurement)
    return path


def assert_same(a, b) -> None:
    assert type(a) is type(b)
    assert a.stamp_ns == b.stamp_ns
    match a:
        case Scan():
            assert_array_equal(a.points, b.points)
            assert_allclose(a.offsets_ns, b.offsets_ns, rtol=0, atol=999)
            assert_array_equal(a.ring, b.ring)
            assert_array_equal(a.intensity, b.intensity)
        case ImuSample():
            assert_array_equal(a.gyro, b.gyro)
            assert_allclose(a.accel, b.accel, rtol=1e-15)
        case WheelSpeed():
            assert a.speed == b.speed
        case UwbRange():
            assert (a.anchor, a.distance) == (b.anchor, b.distance)
        case PrismFix():
            assert_array_equal(a.p_map, b.p_map)


class TestRoundTrip:
    @pytest.mark.parametrize("storage", STORAGES)
    def test_what_is_written_is_read_in_arrival_order(self, tmp_path, full_rig, storage):
        written = some_measurements()
        path = record(tmp_path / "r.bag", full_rig, written, storage)
        read = list(read_recording(path, full_rig))
        assert len(read) == len(written)
        for a, b in zip(read, written, strict=True):
            assert_same(a, b)

    @pytest.mark.parametrize("storage", STORAGES)
    def test_clock_offsets_and_units_of_the_rig_cancel(self, tmp_path, full_rig, storage):
        data = full_rig.model_dump()
        data["imu"]["accel_unit"] = "g"
        data["imu"]["time_offset_s"] = 0.0125
        data["lidar"]["time_offset_s"] = -0.031
        rig = Rig.model_validate(data)
        path = record(tmp_path / "r.bag", rig, storage=storage)
        read = {m.stamp_ns: m for m in read_recording(path, rig) if isinstance(m, Scan)}
        for scan in (m for m in some_measurements() if isinstance(m, Scan)):
            assert_same(read[scan.stamp_ns], scan)
        shifted = next(m for m in read_recording(path, full_rig.without("lidar").model_copy(
            update={"imu": rig.imu.model_copy(update={"time_offset_s": 0.0})})))  # fmt: skip
        assert shifted.stamp_ns == START - 12_500_000
        assert np.linalg.norm(shifted.accel) > 5.0

    def test_the_same_measurements_give_the_same_bytes(self, tmp_path, full_rig):
        for name in "ab":
            record(tmp_path / name / "r", full_rig)
        files = [tmp_path / name / "r" / "r.mcap" for name in "ab"]
        assert files[0].read_bytes() == files[1].read_bytes()

    @pytest.mark.parametrize("suffix", [".mcap", ".db3"])
    def test_bare_files_and_directories_without_metadata(self, tmp_path, full_rig, suffix):
        storage = "mcap" if suffix == ".mcap" else "sqlite3"
        path = record(tmp_path / "r", full_rig, storage=storage)
        (bare,) = path.glob(f"*{suffix}")
        n = len(some_measurements())
        assert len(list(read_recording(bare, full_rig))) == n
        (path / "metadata.yaml").unlink()
        assert len(list(read_recording(path, full_rig))) == n

    def test_old_databases_without_message_definitions(self, tmp_path, full_rig):
        (database,) = record(tmp_path / "r", full_rig, storage="sqlite3").glob("*.db3")
        with closing(sqlite3.connect(database)) as connection:
            connection.execute("UPDATE schema SET schema_version = 3")
            connection.execute("DROP TABLE message_definitions")
            connection.commit()
        for a, b in zip(read_recording(database, full_rig), some_measurements(), strict=True):
            assert_same(a, b)

    def test_a_bag_in_parts_is_one_recording(self, tmp_path, full_rig):
        written = some_measurements()
        half = len(written) // 2
        (tmp_path / "split").mkdir()
        record(tmp_path / "split" / "r_1.bag", full_rig, written[half:], "bag")
        record(tmp_path / "split" / "r_0.bag", full_rig, written[:half], "bag")
        read = list(read_recording(tmp_path / "split", full_rig))
        for a, b in zip(read, written, strict=True):
            assert_same(a, b)

    def test_only_the_sensors_of_the_rig_are_read(self, tmp_path, full_rig):
        path = record(tmp_path / "r", full_rig)
        kinds = {type(m) for m in read_recording(path, full_rig.without("uwb", "prism", "lidar"))}
        assert kinds == {ImuSample, WheelSpeed}

    def test_sensors_that_said_nothing_are_no_fault(self, tmp_path, full_rig):
        spoken = [m for m in some_measurements() if isinstance(m, ImuSample | Scan)]
        path = record(tmp_path / "r", full_rig, spoken)
        assert len(list(read_recording(path, full_rig))) == len(spoken)

    def test_a_scan_of_bare_points(self, tmp_path, full_rig):
        bare = [Scan(m.stamp_ns, m.points, m.offsets_ns) if isinstance(m, Scan) else m for m in some_measurements()]
        read = read_recording(record(tmp_path / "r", full_rig, bare), full_rig)
        scans = [m for m in read if isinstance(m, Scan)]
        assert scans[0].ring is None
        assert scans[0].intensity is None


class TestDescription:
    def test_topics_times_and_point_times(self, tmp_path, full_rig):
        info = describe_recording(record(tmp_path / "r", full_rig), full_rig)
        assert TopicInfo("/lidar/points", "sensor_msgs/msg/PointCloud2", 6) in info.topics
        assert [topic.count for topic in info.topics] == [60, 6, 6, 6, 6]
        assert info.start_ns == START
        assert info.duration_s == pytest.approx(0.6, abs=1e-6)
        assert str(info.point_times) == "time [s], relative"

    def test_without_a_lidar_there_are_no_point_times(self, tmp_path, full_rig):
        path = record(tmp_path / "r", full_rig)
        assert describe_recording(path, full_rig.without("lidar")).point_times is None

    def test_progress_ends_at_the_total(self, tmp_path, full_rig):
        seen = []
        path = record(tmp_path / "r", full_rig, some_measurements(30, 20))
        list(read_recording(path, full_rig, progress=lambda done, total: seen.append((done, total))))
        assert seen[-1] == (420, 420)
        assert seen == sorted(seen)


class TestWriter:
    @pytest.mark.parametrize("storage", STORAGES)
    def test_a_block_that_fails_leaves_nothing(self, tmp_path, full_rig, storage):
        def break_off():
            with RecordingWriter(tmp_path / "r", full_rig, storage) as writer:
                writer.write(some_measurements()[0])
                raise ZeroDivisionError

        with pytest.raises(ZeroDivisionError):
            break_off()
        assert os.listdir(tmp_path) == []

    @pytest.mark.parametrize("storage", STORAGES)
    def test_it_does_not_overwrite(self, tmp_path, full_rig, storage):
        (tmp_path / "r").mkdir()
        with pytest.raises(RecordingError, match="exists already"), RecordingWriter(tmp_path / "r", full_rig, storage):
            pass

    def test_a_sensor_the_rig_lacks(self, tmp_path, full_rig):
        with pytest.raises(RecordingError, match="the rig has no wheel"):
            record(tmp_path / "r", full_rig.without("wheel"))

    def test_a_place_that_cannot_be_written(self, tmp_path, full_rig):
        (tmp_path / "file").write_text("")
        with pytest.raises(RecordingError, match="cannot be written"):
            record(tmp_path / "file" / "r", full_rig)

    def test_negative_time(self, tmp_path, full_rig):
        with pytest.raises(SemmapError, match="negative"):
            record(tmp_path / "r", full_rig, [WheelSpeed(-1, 0.0)])


# Messages of others, made by hand.


def header(stamp_ns: int, frame: str = "x"):
    time = STORE.types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    return STORE.types["std_msgs/msg/Header"](time, frame)


def vector(x=0.0, y=0.0, z=0.0):
    return STORE.types["geometry_msgs/msg/Vector3"](float(x), float(y), float(z))


def imu(stamp_ns: int, accel=(0, 0, 9.81)):
    T = STORE.types
    q = T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    nine = np.zeros(9)
    return T["sensor_msgs/msg/Imu"](header(stamp_ns), q, nine, vector(), nine, vector(*accel), nine)


def cloud(stamp_ns: int, table: np.ndarray):
    code = {"f4": 7, "f8": 8, "u4": 6, "u2": 4}
    T = STORE.types
    fields = [
        T["sensor_msgs/msg/PointField"](n, table.dtype.fields[n][1], code[table.dtype[n].str[1:]], 1)
        for n in table.dtype.names
    ]
    data = np.frombuffer(table.tobytes(), np.uint8)
    step = table.dtype.itemsize
    return T["sensor_msgs/msg/PointCloud2"](
        header(stamp_ns), 1, len(table), fields, False, step, step * len(table), data, False
    )


def twist(speed: float):
    return STORE.types["geometry_msgs/msg/Twist"](vector(speed), vector())


def uwb(stamp_ns: int, frame: str, distance: float, limits=(0.0, 0.0)):
    return STORE.types["sensor_msgs/msg/Range"](header(stamp_ns, frame), 1, 0.0, *limits, distance)


def write_messages(path: Path, messages) -> Path:
    """An MCAP recording of (topic, arrival, message)."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for topic, arrival, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], arrival, STORE.serialize_cdr(message, kind))
    return path


POINTS = np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("time", "f4")])


def good_cloud(n: int = 100) -> np.ndarray:
    table = np.ones(n, POINTS)
    table["time"] = np.linspace(0, 0.099, n)
    return table


def messages(clouds=None, accel=(0, 0, 9.81), extra=(), stamp=lambda t: t, imu_stamp=lambda t: t):
    """Ten scans and fifty IMU samples on one clock, with some of it changed."""
    out = []
    for k in range(10):
        t = START + k * 100_000_000
        table = good_cloud() if clouds is None else clouds(k)
        if table is not None:
            out.append(("/lidar/points", t, cloud(stamp(t), table)))
        out += [("/imu/data", t + j, imu(imu_stamp(t + j), accel)) for j in range(0, 100_000_000, 20_000_000)]
    return out + list(extra)


@pytest.fixture
def lidar_rig(full_rig) -> Rig:
    return full_rig.without("uwb", "wheel", "prism")


class TestMessagesOfOthers:
    def test_wheel_speed_of_any_kind(self, tmp_path, full_rig):
        T = STORE.types
        covariance = np.zeros(36)
        pose = T["geometry_msgs/msg/PoseWithCovariance"](
            T["geometry_msgs/msg/Pose"](
                T["geometry_msgs/msg/Point"](0.0, 0.0, 0.0), T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
            ),
            covariance,
        )
        with_covariance = T["geometry_msgs/msg/TwistWithCovariance"](twist(1.5), covariance)
        kinds = {
            "stamped": T["geometry_msgs/msg/TwistStamped"](header(START), twist(1.5)),
            "covariance": T["geometry_msgs/msg/TwistWithCovarianceStamped"](header(START), with_covariance),
            "odometry": T["nav_msgs/msg/Odometry"](header(START), "base", pose, with_covariance),
        }
        rig = full_rig.without("uwb", "prism")
        for name, message in kinds.items():
            path = write_messages(tmp_path / name, messages(extra=[("/wheel/twist", START, message)]))
            (wheel,) = (m for m in read_recording(path, rig) if isinstance(m, WheelSpeed))
            assert (wheel.stamp_ns, wheel.speed) == (START, 1.5)

    def test_what_says_nothing_is_dropped_and_counted(self, tmp_path, full_rig):
        nan = float("nan")
        extra = [
            ("/imu/data", START + 10**9, imu(START + 10**9, (nan, 0, 9))),
            ("/uwb/range", START + 1, uwb(START + 1, "anchor_100", nan)),
            ("/uwb/range", START + 2, uwb(START + 2, "anchor_100", 50.0, (0.1, 40.0))),
            ("/uwb/range", START + 3, uwb(START + 3, "anchor_101", 5.0, (0.1, 40.0))),
            ("/lidar/points", START + 10**9, cloud(START + 10**9, good_cloud(0))),
        ]
        reader = read_recording(
            write_messages(tmp_path / "r", messages(extra=extra)), full_rig.without("wheel", "prism")
        )
        read = list(reader)
        assert reader.dropped == {"/imu/data": 1, "/uwb/range": 2, "/lidar/points": 1}
        assert [m.anchor for m in read if isinstance(m, UwbRange)] == [101]
        assert len(read) == 61

    def test_clouds_that_begin_empty(self, tmp_path, lidar_rig):
        path = write_messages(tmp_path / "r", messages(lambda k: good_cloud(100 if k > 6 else 0)))
        reader = read_recording(path, lidar_rig)
        assert sum(isinstance(m, Scan) for m in reader) == 3
        assert reader.dropped == {"/lidar/points": 7}

    def test_deskewed_clouds_if_the_rig_says_so(self, tmp_path, lidar_rig):
        bare = np.ones(50, POINTS)[["x", "y", "z"]].astype([("x", "f4"), ("y", "f4"), ("z", "f4")])
        path = write_messages(tmp_path / "r", messages(lambda k: bare))
        rig = lidar_rig.model_copy(update={"lidar": lidar_rig.lidar.model_copy(update={"time_field": "none"})})
        scan = next(m for m in read_recording(path, rig) if isinstance(m, Scan))
        assert not scan.offsets_ns.any()

    def test_accelerations_in_g_if_the_rig_says_so(self, tmp_path, lidar_rig):
        path = write_messages(tmp_path / "r", messages(accel=(0, 0, 1.0)))
        rig = lidar_rig.model_copy(update={"imu": lidar_rig.imu.model_copy(update={"accel_unit": "g"})})
        sample = next(m for m in read_recording(path, rig) if isinstance(m, ImuSample))
        assert_allclose(sample.accel, [0, 0, 9.80665])


def with_time(value):
    def table(k):
        out = good_cloud()
        out["time"] = value
        return out

    return table


def scaled(factor):
    def table(k):
        out = good_cloud()
        for axis in "xyz":
            out[axis] *= factor
        return out

    return table


UNFIT = {
    "no such topic": (
        lambda: messages(lambda k: None),
        RecordingError,
        r"lidar\.topic: has no topic /lidar/points; it has no",
    ),
    "another topic fits": (
        lambda: [("/velodyne" if topic == "/lidar/points" else topic, t, m) for topic, t, m in messages()],
        RecordingError,
        r"lidar\.topic: has no topic /lidar/points; topics that fit: /velodyne",
    ),
    "a topic of another type": (
        lambda: [("/lidar/points", t, m) for topic, t, m in messages() if topic == "/imu/data"] + messages()[1:6],
        RecordingError,
        r"lidar\.topic: /lidar/points is of type sensor_msgs/msg/Imu",
    ),
    "empty clouds": (
        lambda: messages(lambda k: good_cloud(0)),
        CloudError,
        r"/lidar/points: none of 0 points in 10 clouds",
    ),
    "clouds of NaN": (lambda: messages(scaled(np.nan)), CloudError, r"/lidar/points: none of 1000 points in 10 clouds"),
    "clouds of no returns": (lambda: messages(scaled(0.0)), CloudError, r"is finite and 0\.6 to 80 m away"),
    "millimetres": (
        lambda: messages(scaled(1000.0)),
        CloudError,
        r"`max_range` in the rig, and that coordinates are metres",
    ),
    "no time in the points": (
        lambda: messages(lambda k: np.ones(9, [("x", "f4"), ("y", "f4"), ("z", "f4")])),
        RecordingError,
        r"points have no time field; fields are x, y, z; set `time_field`",
    ),
    "times of zero": (lambda: messages(with_time(0.0)), RecordingError, r"one and the same number"),
    "no z": (
        lambda: messages(lambda k: np.ones(9, [("x", "f4"), ("y", "f4"), ("time", "f4")])),
        CloudError,
        r"z: is missing; the cloud has x, y, time",
    ),
    "accelerations in g": (lambda: messages(accel=(0, 0, 1.0)), RecordingError, r"looks like g; set `accel_unit: g`"),
    "gravity taken out": (lambda: messages(accel=(0, 0, 0.05)), RecordingError, r"not gravity in m/s2 or g"),
    "IMU of NaN": (
        lambda: messages(accel=(0, 0, np.nan)),
        RecordingError,
        r"/imu/data: none of the first samples is finite",
    ),
    "clocks apart": (
        lambda: messages(stamp=lambda t: t - START),
        RecordingError,
        r"are 1\.7e\+09 s apart in .*`time_offset_s`",
    ),
    "scan stamps stand still": (
        lambda: messages(stamp=lambda t: START),
        RecordingError,
        r"/lidar/points: header stamps stand",
    ),
    "IMU stamps stand still": (
        lambda: messages(imu_stamp=lambda t: START),
        RecordingError,
        r"/imu/data: header stamps stand",
    ),
}


@pytest.mark.parametrize("name", UNFIT)
def test_recordings_that_do_not_fit_the_rig(name, tmp_path, lidar_rig):
    make, error, pattern = UNFIT[name]
    path = write_messages(tmp_path / "r", make())
    with pytest.raises(error, match=pattern) as caught:
        read_recording(path, lidar_rig)
    assert_one_line_that_names(path, caught.value)


def assert_one_line_that_names(path: Path, error: SemmapError) -> None:
    assert str(error).startswith(str(path))
    assert "\n" not in str(error)
    assert error.mend
    assert error.__cause__ is None


@pytest.mark.parametrize(
    ("frame", "pattern"),
    [
        ("anchor_7", r"anchor 7 is not in the rig \(known: 100, 101\); add its position to `uwb.anchors`"),
        ("uwb", r"frame_id 'uwb' names no anchor; set `anchor_<id>`"),
        ("anchor_x", r"names no anchor"),
    ],
)
def test_ranges_to_anchors_the_rig_does_not_know(frame, pattern, tmp_path, full_rig):
    path = write_messages(tmp_path / "r", messages(extra=[("/uwb/range", START, uwb(START, frame, 3.0))]))
    with pytest.raises(RecordingError, match=pattern) as caught:
        list(read_recording(path, full_rig.without("wheel", "prism")))
    assert_one_line_that_names(path, caught.value)


def storage_file(path: Path) -> Path:
    return path if path.is_file() else next(p for p in path.iterdir() if p.suffix in (".mcap", ".db3"))


@pytest.fixture(scope="module")
def recordings(tmp_path_factory) -> dict[str, Path]:
    """One good recording a storage, to be copied and spoilt."""
    root = tmp_path_factory.mktemp("recordings")
    rig = Rig.model_validate(
        {
            "imu": {"topic": "/imu/data"},
            "lidar": {"topic": "/lidar/points", "p_imu_lidar": [0, 0, 0]},
        }
    )
    kept = [m for m in some_measurements(40, 2000) if isinstance(m, Scan | ImuSample)]
    return {storage: record(root / f"{storage}.bag", rig, kept, storage) for storage in STORAGES}


def spoilt(path: Path, tmp_path: Path, change) -> Path:
    copy = tmp_path / path.name
    shutil.copytree(path, copy) if path.is_dir() else shutil.copy(path, copy)
    file = storage_file(copy)
    file.write_bytes(change(file.read_bytes()))
    return copy


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("share", [0.0, 0.0001, 0.3, 0.7, 0.999])
def test_recordings_cut_off(storage, share, recordings, tmp_path, lidar_rig):
    path = spoilt(recordings[storage], tmp_path, lambda data: data[: int(share * len(data))])
    with pytest.raises(SemmapError) as caught:
        list(read_recording(path, lidar_rig))
    assert isinstance(caught.value, RecordingError)
    assert_one_line_that_names(path, caught.value)


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("seed", range(12))
def test_recordings_with_a_hole_are_refused_or_read_but_never_crash(storage, seed, recordings, tmp_path, lidar_rig):
    def punch(data: bytes) -> bytes:
        start = int(np.random.default_rng(seed).integers(0, len(data) - 400))
        return data[:start] + bytes(400) + data[start + 400 :]

    path = spoilt(recordings[storage], tmp_path, punch)
    try:
        read = list(read_recording(path, lidar_rig))
    except SemmapError as error:
        assert_one_line_that_names(path, error)
    else:
        assert all(np.isfinite(m.points).all() for m in read if isinstance(m, Scan))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_directory_whose_metadata_promises_more(storage, recordings, tmp_path, lidar_rig):
    path = tmp_path / recordings[storage].name
    shutil.copytree(recordings[storage], path)
    meta = path / "metadata.yaml"
    meta.write_text(meta.read_text().replace("message_count: 40\n", "message_count: 50\n"))
    with pytest.raises(RecordingError, match="breaks off after 440 of 450 messages"):
        list(read_recording(path, lidar_rig))


NO_RECORDING = {
    "nothing there": (lambda p: None, r"no such file or directory"),
    "an empty directory": (lambda p: p.mkdir(), r"holds no recording; give a rosbag1 \.bag"),
    "an empty file": (lambda p: p.write_bytes(b""), r"is empty"),
    "text": (lambda p: p.write_text("hello, this is no recording"), r"is not a recording"),
    "an MCAP by another name": (lambda p: p.write_bytes(b"\x89MCAP0\r\n" + bytes(100)), r"rename it to end in \.mcap"),
    "broken metadata": (
        lambda p: (p.mkdir(), (p / "metadata.yaml").write_text("{")),
        r"cannot be read",
    ),
    "metadata alone": (
        lambda p: (p.mkdir(), (p / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 5}")),
        r"cannot be read",
    ),
}


@pytest.mark.parametrize("name", NO_RECORDING)
def test_what_is_no_recording(name, tmp_path, lidar_rig):
    make, pattern = NO_RECORDING[name]
    path = tmp_path / "r"
    make(path)
    with pytest.raises(RecordingError, match=pattern) as caught:
        describe_recording(path, lidar_rig)
    assert_one_line_that_names(path, caught.value)


@pytest.mark.skipif(not BENCHMARK.exists(), reason="the benchmark mine is not beside the repository")
def test_the_benchmark_recording():
    rig = Rig.from_yaml(BENCHMARK / "rig.yaml")
    reader = read_recording(BENCHMARK / "recording_60s", rig)
    assert str(reader.info.point_times) == "time [s], relative"
    first = [next(reader) for _ in range(600)]
    scans = [m for m in first if isinstance(m, Scan)]
    assert len(scans) > 15
    for scan in scans:
        assert 8000 < len(scan.points) <= 16 * 900
        assert scan.offsets_ns.min() >= 0
        assert scan.offsets_ns.max() < 100_000_000
        assert scan.ring.max() == 15
    stamps = np.array([m.stamp_ns for m in first if isinstance(m, ImuSample)])
    assert_allclose(np.diff(stamps), 5_000_000)
