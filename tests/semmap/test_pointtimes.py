"""Every convention of point times that drivers use is told from its numbers, or refused with the keys that tell."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from semmap.errors import CloudError, RecordingError
from semmap.pointtimes import PointTimeFormat, TimeSample, classify_point_times
from semmap.rig import LidarBlock

EPOCH = 1_700_000_000_123_456_789
SCALE = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
N_POINTS = 2000


def block(**keys) -> LidarBlock:
    return LidarBlock.model_validate({"topic": "/points", "p_imu_lidar": [0, 0, 0], **keys})


def true_offsets(period_ns: float, fraction: float = 0.99) -> np.ndarray:
    return np.linspace(0, fraction * period_ns, N_POINTS).astype(np.int64)


def samples_of(field, dtype, unit, reference, *, rate=10.0, start=EPOCH, n=8, at_end=False, fraction=0.99):
    """Clouds as a driver with this convention sends them. ``at_end``: the stamp is that of the last point."""
    period = 1e9 / rate
    offsets = true_offsets(period, fraction) - (int(period) if at_end else 0)
    clouds = []
    for k in range(n):
        stamp = start + round(k * period)
        exact = offsets + (stamp if reference == "absolute" else 0)
        if reference == "first":
            exact = offsets + 77_000_000_000 + round(k * period)
        dt = np.dtype(dtype)
        if dt.kind == "f":
            # The nearest number the type has, computed without losing digits on the way.
            whole, rest = np.divmod(exact, SCALE[unit])
            values = whole.astype(np.longdouble) + rest.astype(np.longdouble) / SCALE[unit]
        else:
            values = exact // SCALE[unit]
        table = np.zeros(N_POINTS, [("x", "f4"), ("y", "f4"), ("z", "f4"), (field, dt)])
        table[field] = values.astype(dt)
        clouds.append(TimeSample(stamp, table))
    return clouds, offsets


CONVENTIONS = {
    "velodyne": ("time", "f4", "s", "relative", 1e3),
    "velodyne, stamped at the end": ("time", "f4", "s", "relative", 1e3),
    "ouster": ("t", "u4", "ns", "relative", 1),
    "hesai": ("timestamp", "f8", "s", "absolute", 1e3),
    "livox custom": ("offset_time", "u4", "ns", "relative", 1),
    "livox": ("timestamp", "f8", "ns", "absolute", 300),
    "microseconds": ("t", "u4", "us", "relative", 1e3),
    "float microseconds": ("time", "f4", "us", "relative", 10),
    "milliseconds": ("time_stamp", "f4", "ms", "relative", 10),
    "double relative": ("time", "f8", "s", "relative", 1),
    "double milliseconds": ("timestamp", "f8", "ms", "absolute", 300),
    "signed": ("t", "i4", "ns", "relative", 1),
    "capital": ("Time", "f4", "s", "relative", 1e3),
}


@pytest.mark.parametrize("rate", [5.0, 10.0, 20.0, 100.0])
@pytest.mark.parametrize("name", CONVENTIONS)
def test_each_convention_is_told_and_read(name, rate):
    field, dtype, unit, reference, tolerance_ns = CONVENTIONS[name]
    at_end = name.endswith("end")
    clouds, offsets = samples_of(field, dtype, unit, reference, rate=rate, at_end=at_end)
    times = classify_point_times(clouds, block())
    assert times == PointTimeFormat(field, unit, reference)
    read, good = times.offsets_ns(clouds[3].table, clouds[3].header_ns)
    assert good.all()
    assert_allclose(read, offsets, rtol=0, atol=tolerance_ns)


@pytest.mark.parametrize("name", CONVENTIONS)
@pytest.mark.parametrize("start", [0, 5_000_000_000, 3_835_150_000_000])
def test_each_convention_is_told_on_a_simulated_clock_too(name, start):
    field, dtype, unit, reference, _ = CONVENTIONS[name]
    clouds, _ = samples_of(field, dtype, unit, reference, start=start)
    assert classify_point_times(clouds, block()) == PointTimeFormat(field, unit, reference)


@pytest.mark.parametrize("rate_hz", [10.0, None])
@pytest.mark.parametrize("name", CONVENTIONS)
def test_one_cloud_is_enough_where_the_clock_is_not_near_zero(name, rate_hz):
    field, dtype, unit, reference, _ = CONVENTIONS[name]
    clouds, _ = samples_of(field, dtype, unit, reference, n=1)
    assert classify_point_times(clouds, block(rate_hz=rate_hz)) == PointTimeFormat(field, unit, reference)


@pytest.mark.parametrize("fraction", [0.1, 0.33, 0.99, 1.3])
def test_clouds_that_fill_a_part_of_the_turn_or_more_than_it(fraction):
    clouds, _ = samples_of("time", "f4", "s", "relative", fraction=fraction)
    assert classify_point_times(clouds, block()).unit == "s"


def test_a_second_candidate_is_taken_where_the_first_holds_nothing():
    clouds, _ = samples_of("timestamp", "f8", "s", "absolute")
    clouds = [
        TimeSample(c.header_ns, np.rec.fromarrays([np.zeros(N_POINTS), c.table["timestamp"]], names="t,timestamp"))
        for c in clouds
    ]
    assert classify_point_times(clouds, block()) == PointTimeFormat("timestamp", "s", "absolute")


REFUSED = {
    "no time field": (
        lambda: samples_of("when", "f4", "s", "relative")[0],
        {},
        r"no time field; fields are x, y, z, when",
    ),
    "named field missing": (
        lambda: samples_of("time", "f4", "s", "relative")[0],
        {"time_field": "tt"},
        r"no field `tt`",
    ),
    "all zero": (lambda: zeroed(0.0), {}, r"one and the same number \(0\) for all points"),
    "all the stamp": (lambda: zeroed(1.7e9), {}, r"one and the same number \(1700000000\)"),
    "all NaN": (lambda: zeroed(np.nan), {}, r"holds no finite number"),
    "float32 epoch": (lambda: samples_of("timestamp", "f4", "s", "absolute")[0], {}, r"float32.*steps of 1.3e\+02 s"),
    "float32 hours of simulation": (
        lambda: samples_of("time", "f4", "s", "absolute", start=3_835_150_000_000)[0],
        {},
        r"float32.*steps of 0\.00024 s: digits are lost",
    ),
    "clock of its own": (
        lambda: samples_of("t", "u4", "us", "first")[0],
        {},
        r"near neither zero nor the header stamp \(17000",
    ),
    "no scan's duration": (
        lambda: samples_of("time", "f4", "s", "relative", fraction=0.01)[0],
        {"time_unit": "s"},
        r"no scan's duration",
    ),
    "one cloud near zero": (
        lambda: samples_of("time", "f8", "s", "absolute", start=0, n=1)[0],
        {},
        r"can be read as time \[s\], relative or time \[s\], absolute",
    ),
}


def zeroed(value: float) -> list[TimeSample]:
    clouds, _ = samples_of("time", "f8", "s", "relative")
    for cloud in clouds:
        cloud.table["time"] = value
    return clouds


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_unclear_is_refused_and_the_keys_are_named(name):
    make, keys, pattern = REFUSED[name]
    with pytest.raises(RecordingError, match=pattern) as caught:
        classify_point_times(make(), block(**keys))
    assert caught.value.field == "/points"
    assert "time_field" in caught.value.mend


def test_the_rig_overrides():
    clouds, offsets = samples_of("t", "u4", "us", "first")
    times = classify_point_times(clouds, block(time_unit="us", time_reference="first"))
    read, good = times.offsets_ns(clouds[2].table, clouds[2].header_ns)
    assert good.all()
    assert_allclose(read, offsets, atol=1000)
    no_returns = clouds[2].table.copy()
    no_returns["t"][:7] = 0
    read, good = times.offsets_ns(no_returns, clouds[2].header_ns)
    assert not good[:7].any()
    assert_allclose(read[7:], offsets[7:] - offsets[7], atol=1000)


def test_one_key_of_the_rig_settles_what_is_left_open():
    clouds, _ = samples_of("time", "f8", "s", "absolute", start=0, n=1)
    times = classify_point_times(clouds, block(time_reference="absolute"))
    assert times == PointTimeFormat("time", "s", "absolute")
    assert classify_point_times(clouds, block(time_field="TIME", time_reference="relative")).field == "time"


def test_deskewed_clouds_have_no_times():
    clouds, _ = samples_of("when", "f4", "s", "relative")
    times = classify_point_times(clouds, block(time_field="none"))
    assert times == PointTimeFormat(None)
    read, good = times.offsets_ns(clouds[0].table, clouds[0].header_ns)
    assert not read.any()
    assert good.all()
    assert "deskewed" in str(times)


@pytest.mark.parametrize("dtype", ["f4", "f8"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_absurd_times_are_marked(dtype, bad):
    table = np.array([(0.0,), (bad,), (0.05,)], [("time", dtype)])
    read, good = PointTimeFormat("time", "s", "relative").offsets_ns(table, EPOCH)
    assert good.tolist() == [True, False, True]
    assert read[1] == 0


def test_a_cloud_that_lost_its_field():
    with pytest.raises(CloudError, match="time: is missing"):
        PointTimeFormat("time", "s").offsets_ns(np.zeros(3, [("x", "f4")]), 0)
