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


def nothing_hidden(tags, anchors):
    return np.zeros(len(tags), bool)


def shares(rate_hz, seconds=10.0):
    """What goes to the filter, and to the graph as (stamp, alike), of readings of two anchors by turns."""
    sightings = Sightings(RIG, SightingSettings(), np.zeros(3), nothing_hidden)
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


def test_before_the_place_is_known_all_readings_are_kept_too_and_count_as_one_a_moment():
    """Those near the anchors, at the start, tell the most."""
    sightings = Sightings(RIG, SightingSettings(), np.zeros(3), nothing_hidden)
    for k in range(100):
        assert not sightings.add(UwbRange(k * 100_000_000, 7, 5.0))
        sightings.reached(k * 100_000_000, np.eye(4))
    assert len(sightings.kept) == 100
    assert 20.0 <= sum(1.0 / sighting.alike for sighting in sightings.kept) <= 21.0


def test_a_long_rest_does_not_end_the_search_for_the_place():
    """The window is full of one spot long before the robot sets off."""
    anchors = {1: [2.0, 3.0, 2.5], 2: [9.0, -3.0, 0.5], 3: [15.0, 3.0, 1.0], 4: [5.0, -4.0, 3.0]}
    rig = Rig.model_validate(
        {"imu": {"topic": "/imu"}, "uwb": {"topic": "/u", "p_imu_tag": [0, 0, 0], "anchors": anchors}}
    )
    sightings, T = Sightings(rig, SightingSettings(window=60), np.zeros(3), nothing_hidden), np.eye(4)
    found, rng = [], np.random.default_rng(0)
    for k in range(600):
        p = np.array([max(0.0, 0.05 * (k - 400)), 0.4 * np.sin(0.05 * max(0, k - 400)), 0.0])
        T[:3, 3] = p
        for anchor, at in anchors.items():
            distance = float(np.linalg.norm(p + [3.0, 0.0, 1.0] - at)) + 0.05 * rng.normal()
            sightings.add(UwbRange(k * 100_000_000 + anchor, anchor, distance))
        sightings.reached(k * 100_000_000 + 10, T.copy())
        alignment = sightings.align(np.eye(3))
        if alignment is not None:
            found.append((k, alignment))
    assert found and found[0][0] > 400
    for _, alignment in found:
        np.testing.assert_allclose(alignment.T_map_level[:3, 3], [3.0, 0.0, 1.0], atol=0.3)
