"""The stopwatch over methods, and rows of what it measured."""

import time

import pytest

from tools.bench.localize_times import HEAD, Stopwatch, _row


class Clock:
    def __init__(self):
        self.ticks = 0

    def tick(self, by, *, fail=False):
        self.ticks += by
        time.sleep(0.002)
        if fail:
            raise ValueError("no")
        return self.ticks


def test_every_call_is_timed_and_the_method_is_as_before_afterwards():
    method, clock = Clock.tick, Clock()
    with Stopwatch(Clock, "tick", lambda that: that.ticks) as watch:
        assert clock.tick(2) == 2 and clock.tick(by=3) == 5
    assert Clock.tick is method
    clock.tick(1)
    assert [told for *_, told in watch.rows] == [2, 5]
    assert all(spent >= 2.0 for spent, *_ in watch.rows)
    # sleep is none of the processor's
    assert all(processor < spent for spent, processor, _ in watch.rows)


def test_what_a_timed_method_raises_comes_through():
    with pytest.raises(ValueError, match="no"), Stopwatch(Clock, "tick"):
        Clock().tick(1, fail=True)
    assert Clock().tick(1) == 1


def test_row():
    row = _row("scan", [(1.0, 0.5, 0), (3.0, 1.5, 0), (2.0, 1.0, 7)])
    assert row == {"what": "scan", "n": 3, "median": 2.0, "p95": 2.9, "most": 3.0, "processor": 1.0}
    assert len(row) == len(HEAD)
