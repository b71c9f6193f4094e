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
