"""Ranges between the filter and the graph: each is counted once, and a moment's readings count as one."""

import numpy as np
import pytest

from localize.settings import SightingSettings
from localize.sightings import Sightings
from semmap.measurements import UwbRange
from semmap.rig import Rig

RIG = Rig.model_validate(
    {
        "imu": {"topic": "/imu"},
        "uwb": {"topic": "/uwb", "range_std": 0.1, "p_imu_tag": [0, 0, 0], "anchors": {"7": [1, 2, 3], "8": [4, 5, 6]}},
    }
)


def shares(rate_hz, seconds=10.0):
    """What goes to the filter, and to the graph as (stamp, alike), of readings of two anchors by turns."""
    sightings = Sightings(RIG, SightingSettings(), np.zeros(3))
    sightings.shared = True
    filters, graphs = [], []
    for k in range(round(seconds * rate_hz)):
        for anchor in (7, 8):
            stamp_ns = round(k / rate_hz * 1e9) + anchor
            if sightings.add(UwbRange(stamp_ns, anchor, 5.0)):
                filters.append((stamp_ns, anchor))
            graphs += [((s.stamp_ns, s.anchor), s.alike) for s in sightings.reached(stamp_ns, np.eye(4))]
    return filters, graphs


@pytest.mark.parametrize("rate_hz", [1.0, 2.0, 5.0, 20.0])
def test_every_reading_is_used_once(rate_hz):
    filters, graphs = shares(rate_hz)
    used = filters + [reading for reading, _ in graphs]
    assert len(used) == len(set(used)) == round(20 * rate_hz)
    assert len(filters) >= 0.4 * min(len(used), 40)


@pytest.mark.parametrize("rate_hz", [1.0, 2.0, 5.0, 20.0])
def test_a_moments_readings_count_as_one(rate_hz):
    _, graphs = shares(rate_hz)
    counted = sum(1.0 / alike for _, alike in graphs)
    assert counted <= 2 * 10.0 / SightingSettings().interval_s + 2
    assert counted >= 0.4 * min(2 * 10.0 / SightingSettings().interval_s, 20 * rate_hz)


def test_before_the_place_is_known_one_reading_a_moment_is_kept():
    sightings = Sightings(RIG, SightingSettings(), np.zeros(3))
    for k in range(100):
        assert not sightings.add(UwbRange(k * 100_000_000, 7, 5.0))
        sightings.reached(k * 100_000_000, np.eye(4))
    assert len(sightings.kept) == 20
