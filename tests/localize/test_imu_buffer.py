"""Samples over an interval, whatever its ends and however long the buffer has been in use."""

import numpy as np

from localize.imu_buffer import ImuBuffer
from semmap.measurements import ImuSample

STEP_NS = 5_000_000


def ramp(stamp_ns):
    """Six values that grow with time, so that interpolation must give them back at any time."""
    return 1e-9 * stamp_ns * np.arange(1.0, 7.0)


def filled(count):
    buffer = ImuBuffer()
    for stamp_ns in STEP_NS * np.arange(count):
        buffer.append(ImuSample(int(stamp_ns), ramp(stamp_ns)[:3], ramp(stamp_ns)[3:]))
    return buffer


def test_an_interval_holds_its_ends_interpolated_and_the_samples_between():
    interval = filled(100).between(12_000_000, 31_000_000)
    np.testing.assert_array_equal(interval.stamps_ns * 1e-6, [12, 15, 20, 25, 30, 31])
    np.testing.assert_allclose(np.hstack([interval.gyro, interval.accel]), [ramp(t) for t in interval.stamps_ns])


def test_an_end_on_a_sample_is_there_once_and_an_interval_within_a_step_has_its_two_ends():
    buffer = filled(100)
    np.testing.assert_array_equal(buffer.between(10_000_000, 20_000_000).stamps_ns * 1e-6, [10, 15, 20])
    within = buffer.between(11_000_000, 12_000_000)
    np.testing.assert_allclose(within.accel, [ramp(t)[3:] for t in (11_000_000, 12_000_000)])


def test_before_the_first_sample_the_first_holds():
    buffer = filled(100)
    buffer.forget_before(50_000_000)
    np.testing.assert_allclose(buffer.between(40_000_000, 55_000_000).gyro[0], ramp(50_000_000)[:3])


def test_hours_of_samples_pass_through_without_the_buffer_growing():
    buffer = ImuBuffer()
    for k in range(20_000):
        stamp_ns = k * STEP_NS
        buffer.append(ImuSample(stamp_ns, ramp(stamp_ns)[:3], ramp(stamp_ns)[3:]))
        if k % 20 == 19:
            interval = buffer.between(stamp_ns - 10 * STEP_NS, stamp_ns - STEP_NS // 2)
            np.testing.assert_allclose(interval.gyro, [ramp(t)[:3] for t in interval.stamps_ns])
            buffer.forget_before(stamp_ns - STEP_NS // 2)
    assert len(buffer) == 2 and buffer.last_ns == 19_999 * STEP_NS
    assert len(buffer._stamps) == 1024
