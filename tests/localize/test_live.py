"""The live stream: the same poses, nothing waits for the work, too many scans are dropped and counted."""

from threading import Event

import numpy as np
import pytest

from localize import LiveLocalizer, Localizer, LocalizeSettings
from semmap.measurements import ImuSample, Scan
from tools.simulator import SimulationSettings, default_rig, fly, scenario, simulate_measurements


@pytest.fixture(scope="module")
def recording():
    it = fly(scenario("demo", seed=1), settings=SimulationSettings(start_s=8.0, duration_s=6.0), seed=1)
    return it.rig, list(simulate_measurements(it))


def scan(k):
    return Scan(k, np.zeros((0, 3), np.float32), np.zeros(0, np.int64))


class Held:
    """A localizer that waits to be let go, or fails."""

    def __init__(self, fails=False):
        self.go, self.fails = Event(), fails

    def add(self, measurement):
        self.go.wait(10.0)
        if self.fails:
            raise ValueError("broken")

    def finish(self):
        return Localizer(default_rig(), settings=LocalizeSettings()).finish()


def test_it_gives_the_poses_of_the_localizer_it_feeds(recording):
    rig, measurements = recording
    updates = []
    live = LiveLocalizer(Localizer(rig), updates.append, max_scans=len(measurements))
    assert all(live.add(m) for m in measurements)
    result = live.close()
    alone = Localizer(rig)
    expected = [update for m in measurements if (update := alone.add(m)) is not None]
    assert [update.stamp_ns for update in updates] == [update.stamp_ns for update in expected]
    np.testing.assert_array_equal(result.odometry.poses, alone.finish().odometry.poses)
    assert result.summary["live_scans_dropped"] == 0 and result.summary["latency_ms_p95"] > 0.0


def test_scans_that_come_too_fast_are_dropped_and_the_imu_is_not():
    held = Held()
    live = LiveLocalizer(held, max_scans=3)
    taken = [live.add(scan(k)) for k in range(10)]
    assert sum(taken) == 3 and all(live.add(ImuSample(k, np.zeros(3), np.zeros(3))) for k in range(100))
    held.go.set()
    assert live.close().summary["live_scans_dropped"] == 7


def test_what_goes_wrong_in_the_thread_is_raised_outside():
    held = Held(fails=True)
    live = LiveLocalizer(held)
    live.add(scan(0))
    held.go.set()
    with pytest.raises(ValueError, match="broken"):
        live.close()
