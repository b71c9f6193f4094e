"""PointCloud2 in every layout drivers send."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from semmap.errors import CloudError
from semmap.measurements import Scan
from semmap.messages import decode_scan
from semmap.pointcloud2 import coordinates, encode_scan, find_column, point_table, within_range
from semmap.pointtimes import PointTimeFormat

VELODYNE = np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4"), ("ring", "u2"), ("time", "f4")])
PADDED = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "t", "reflectivity", "ring"],
        "formats": ["f4", "f4", "f4", "f4", "u4", "u2", "u1"],
        "offsets": [0, 4, 8, 16, 20, 24, 26],
        "itemsize": 48,
    }
)
DOUBLES = np.dtype([("x", "f8"), ("y", "f8"), ("z", "f8"), ("timestamp", "f8"), ("line", "u1")])


def table_of(dtype: np.dtype, n: int = 12) -> np.ndarray:
    rng = np.random.default_rng(0)
    table = np.zeros(n, dtype)
    for name in dtype.names:
        table[name] = rng.uniform(1, 90, n)
    return table


@pytest.mark.parametrize("dtype", [VELODYNE, PADDED, DOUBLES])
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(("height", "padding"), [(1, 0), (3, 0), (3, 7), (1, 5)])
def test_every_layout_reads_the_same(make_cloud, dtype, big, height, padding):
    table = table_of(dtype)
    read = point_table(make_cloud(table, height=height, row_padding=padding, big=big))
    for name in dtype.names:
        assert_array_equal(read[name], table[name])
    assert_array_equal(coordinates(read), np.stack([table[a] for a in "xyz"], axis=1).astype(np.float32))
    assert coordinates(read).dtype == np.float32


def test_columns_of_several_numbers_and_names_twice_are_passed_over(make_cloud):
    dtype = np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("rgb", "u1", (3,)), ("pad", "f4")])
    cloud = make_cloud(np.ones(4, dtype))
    cloud.fields[-1].name = "x"
    read = point_table(cloud)
    assert read.dtype.names == ("x", "y", "z")
    assert_array_equal(coordinates(read), np.ones((4, 3)))


def test_an_empty_cloud_has_no_rows(make_cloud):
    assert len(point_table(make_cloud(np.empty(0, VELODYNE)))) == 0


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        ({"data": np.zeros(50, np.uint8)}, r"data: holds 50 of 264 bytes"),
        ({"point_step": 8}, r"z: lies beyond the 8 bytes of a point"),
        ({"height": 2, "row_step": 10}, r"row_step 10 is shorter than 12 points"),
    ],
)
def test_a_layout_that_contradicts_itself(make_cloud, change, pattern):
    cloud = make_cloud(table_of(VELODYNE))
    vars(cloud).update(change)
    with pytest.raises(CloudError, match=pattern):
        point_table(cloud)


def test_an_unknown_datatype_and_a_missing_axis(make_cloud):
    cloud = make_cloud(table_of(VELODYNE))
    cloud.fields[3].datatype = 11
    with pytest.raises(CloudError, match="intensity: has the unknown datatype 11"):
        point_table(cloud)
    with pytest.raises(CloudError, match="z: is missing; the cloud has x, y"):
        coordinates(np.zeros(3, [("x", "f4"), ("y", "f4")]))


def test_range_limits_drop_no_returns_and_what_is_not_finite():
    points = np.array(
        [[0, 0, 0], [0.5, 0, 0], [3, 4, 0], [79, 0, 0], [81, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0], [3e38, 3e38, 0]],
        np.float32,
    )
    assert_array_equal(np.flatnonzero(within_range(points, 0.6, 80.0)), [2, 3])
    assert not within_range(points, 0.0, 80.0)[0]


def test_names_are_found_in_any_case_and_in_order_of_preference():
    assert find_column(["X", "Reflectivity", "Intensity"], ("intensity", "reflectivity")) == "Intensity"
    assert find_column(["x"], ("ring",)) is None


def test_a_scan_keeps_what_belongs_together(make_cloud, full_rig):
    table = table_of(VELODYNE, 6)
    for axis in "xyz":
        table[axis] *= 0.5
    table["x"][[1, 3]] = np.nan, 1000.0
    table["time"] = np.arange(6) * 0.01
    table["time"][4] = np.nan
    cloud = make_cloud(table, height=2, row_padding=3, stamp_ns=1_700_000_000_000_000_005)
    scan = decode_scan(cloud, full_rig.lidar, PointTimeFormat("time", "s", "relative"))
    keep = [0, 2, 5]
    assert scan.stamp_ns == 1_700_000_000_000_000_005
    assert_array_equal(scan.points, coordinates(table[keep]))
    assert_array_equal(scan.ring, table["ring"][keep])
    assert_array_equal(scan.intensity, table["intensity"][keep])
    assert_allclose(scan.offsets_ns, np.array(keep) * 10_000_000, atol=5)


def test_a_scan_without_a_usable_point_says_nothing(make_cloud, full_rig):
    table = table_of(VELODYNE)
    table["x"] = np.nan
    assert decode_scan(make_cloud(table), full_rig.lidar, PointTimeFormat(None)) is None


@pytest.mark.parametrize("extras", [True, False])
def test_an_encoded_scan_has_the_columns_it_announces(extras):
    rng = np.random.default_rng(0)
    scan = Scan(
        7,
        rng.normal(size=(5, 3)),
        np.arange(5) * 20_000_001,
        ring=np.arange(5, dtype=np.uint16) if extras else None,
        intensity=rng.random(5, dtype=np.float32) if extras else None,
    )
    layout, step, data = encode_scan(scan)
    names = [field.name for field in layout]
    assert names == (["x", "y", "z", "intensity", "ring", "time"] if extras else ["x", "y", "z", "time"])
    assert len(data) == 5 * step
    rows = data.reshape(5, step)
    time = rows[:, layout[-1].offset :].copy().view("<f4")[:, 0]
    assert_allclose(time * 1e9, scan.offsets_ns, atol=10)
