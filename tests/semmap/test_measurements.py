"""Measurements are checked once, where they are made."""

import numpy as np
import pytest

from semmap.errors import MeasurementError
from semmap.measurements import ImuSample, PrismFix, Scan, UwbRange, WheelSpeed


def test_a_scan_brings_its_columns_into_shape():
    scan = Scan(5, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], [0, 70])
    assert (scan.points.dtype, scan.points.shape) == (np.float32, (2, 3))
    assert (scan.offsets_ns.dtype, scan.end_ns) == (np.int64, 75)
    assert scan.ring is None


def test_an_empty_scan_ends_when_it_starts():
    assert Scan(5, np.empty((0, 3)), []).end_ns == 5


def test_a_scan_stamped_at_its_end_ends_there():
    assert Scan(1000, np.ones((2, 3)), [-900, 0]).end_ns == 1000


def test_vectors_become_float64():
    assert ImuSample(0, [0, 0, 1], (0, 0, 9)).gyro.dtype == np.float64
    assert PrismFix(0, [1, 2, 3]).p_map.dtype == np.float64


BAD = {
    "points (2, 4)": (lambda: Scan(0, np.ones((2, 4)), [0, 0]), r"Scan\.points: has shape"),
    "one point flat": (lambda: Scan(0, np.ones(3), [0]), r"Scan\.points: has shape"),
    "NaN point": (lambda: Scan(0, [[np.nan, 0, 0]], [0]), r"Scan\.points: holds NaN"),
    "too few offsets": (lambda: Scan(0, np.ones((2, 3)), [0]), r"Scan\.offsets_ns: .*for 2 points"),
    "too many rings": (lambda: Scan(0, np.ones((1, 3)), [0], ring=np.zeros(2)), r"Scan\.ring"),
    "intensity (1, 1)": (
        lambda: Scan(0, np.ones((1, 3)), [0], intensity=np.zeros((1, 1))),
        r"Scan\.intensity",
    ),
    "gyro of two": (lambda: ImuSample(0, [0, 0], [0, 0, 9]), r"ImuSample\.gyro: has shape \(2,\)"),
    "accel NaN": (lambda: ImuSample(0, [0, 0, 0], [0, np.nan, 9]), r"ImuSample\.accel: is not finite"),
    "speed inf": (lambda: WheelSpeed(0, np.inf), r"WheelSpeed\.speed: is not finite"),
    "distance NaN": (lambda: UwbRange(0, 1, float("nan")), r"UwbRange\.distance"),
    "fix (1, 3)": (lambda: PrismFix(0, [[1, 2, 3]]), r"PrismFix\.p_map: has shape"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_measurements_are_refused(name):
    make, pattern = BAD[name]
    with pytest.raises(MeasurementError, match=pattern):
        make()


def test_measurements_are_frozen():
    with pytest.raises(AttributeError):
        WheelSpeed(0, 1.0).speed = 2.0


def scan_of(points, offsets, **columns):
    return Scan(1_000, np.asarray(points, np.float32), np.asarray(offsets, np.int64), **columns)


@pytest.mark.parametrize("by", ["ring", "column"])
def test_a_thinned_scan_keeps_some_of_every_ring_and_column(by):
    """Evenly, whatever the order in which a driver writes the points."""
    ring, column = np.meshgrid(np.arange(16), np.arange(900), indexing="ij" if by == "ring" else "xy")
    ring, column = ring.ravel(), column.ravel()
    scan = scan_of(np.column_stack([column, ring, 0 * ring]), column, ring=ring.astype(np.uint16))
    thin = scan.thinned(6000)
    assert abs(len(thin.points) - 6000) < 10
    counts = np.bincount(thin.ring, minlength=16)
    assert counts.min() > 0.9 * 375 and counts.max() < 1.1 * 375
    per_sector = np.bincount(thin.offsets_ns // 30, minlength=30)
    assert per_sector.min() > 0.9 * 200 and per_sector.max() < 1.1 * 200
    np.testing.assert_array_equal(thin.points[:, 1], thin.ring)
    assert scan.thinned(14_400) is scan


def test_the_part_of_a_scan_since_a_time():
    scan = scan_of(np.arange(12).reshape(4, 3), [-20, 0, 10, 30], intensity=np.arange(4, dtype=np.float32))
    assert scan.since(980) is scan
    late = scan.since(1_005)
    np.testing.assert_array_equal(late.offsets_ns, [10, 30])
    np.testing.assert_array_equal(late.intensity, [2, 3])
    assert late.ring is None and late.stamp_ns == 1_000
