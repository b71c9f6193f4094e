"""Ranges as no rig should have them: the place found is right, or none is."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from localize import Localizer
from semmap.measurements import UwbRange
from tools.simulator import SimulationSettings, default_rig, fly, scenario, simulate_measurements, with_uwb

FOUR = (100, 102, 105, 107)


@cache
def flight():
    mine = scenario("drift", 3)
    route = mine.scenario.route_floor()
    rig = default_rig()
    rig = rig.model_copy(update={"lidar": rig.lidar.model_copy(update={"columns": 225})})
    rig = with_uwb(rig, mine, route[len(route) // 6] + [0, 0, 1.3], anchors=10)
    it = fly(mine, rig=rig, settings=SimulationSettings(duration_s=26.0, start_s=6.0), seed=3)
    return it, tuple(simulate_measurements(it))


def with_anchors(rig, anchors):
    return rig.model_copy(update={"uwb": rig.uwb.model_copy(update={"anchors": anchors})})


def moved(rig, offsets):
    """Anchors surveyed wrong by offsets, id -> (3,)."""
    anchors = {i: tuple(np.add(p, offsets.get(i, 0.0))) for i, p in rig.uwb.anchors.items()}
    return with_anchors(rig, anchors)


def four(rig):
    return with_anchors(rig, {i: rig.uwb.anchors[i] for i in FOUR})


def exchanged(rig, a, b):
    anchors = dict(rig.uwb.anchors)
    anchors[a], anchors[b] = anchors[b], anchors[a]
    return with_anchors(rig, anchors)


def readings(measurements, change):
    """The measurements with ``change(reading) -> readings`` done to every range."""
    for m in measurements:
        yield from change(m) if isinstance(m, UwbRange) else (m,)


def read_as(distance):
    return lambda m: (UwbRange(m.stamp_ns, m.anchor, distance),)


def garbage(m):
    return (UwbRange(m.stamp_ns, m.anchor, 1.0 + (m.stamp_ns // 100_000 * 7919) % 60),)


def as_it_is(m):
    return (m,)


def ranges_first(measurements):
    return sorted(measurements, key=lambda m: not isinstance(m, UwbRange))


def ranges_last(measurements):
    return sorted(measurements, key=lambda m: isinstance(m, UwbRange))


def by_hand(measurements):
    """Shuffled by up to twenty readings, each of them twice."""
    rng = np.random.default_rng(0)
    doubled = [m for m in measurements for _ in range(1 + isinstance(m, UwbRange))]
    where = [k for k, m in enumerate(doubled) if isinstance(m, UwbRange)]
    for first in range(0, len(where) - 20, 20):
        slots = where[first : first + 20]
        for slot, m in zip(slots, [doubled[k] for k in rng.permutation(slots)], strict=True):
            doubled[slot] = m
    return doubled


def localized(rig, measurements):
    localizer = Localizer(rig)
    for m in measurements:
        localizer.add(m)
    result = localizer.finish()
    truth = flight()[0].truth()
    off = np.linalg.norm(result.realtime.positions - truth.at(result.realtime.stamps_ns)[:, :3, 3], axis=1)
    return result, off


@pytest.mark.parametrize(
    ("rig_of", "change"),
    [
        (lambda rig: rig, read_as(1e9)),
        (lambda rig: rig, garbage),
        (lambda rig: rig, lambda m: ()),
        (lambda rig: with_anchors(rig, dict.fromkeys(rig.uwb.anchors, rig.uwb.anchors[104])), as_it_is),
        (lambda rig: moved(four(rig), {102: (5.0, 0.0, 0.0)}), as_it_is),
        (lambda rig: exchanged(four(rig), 102, 107), as_it_is),
    ],
    ids=["huge", "garbage", "none", "one place", "wrong survey", "exchanged"],
)
def test_ranges_that_make_no_sense_find_no_place(rig_of, change):
    it, measurements = flight()
    result, off = localized(rig_of(it.rig), readings(measurements, change))
    assert not result.summary["anchored"] and len(off) == 0


@pytest.mark.parametrize("order", [ranges_first, by_hand])
def test_ranges_in_another_order_find_the_place(order):
    it, measurements = flight()
    _, off = localized(it.rig, order(measurements))
    assert len(off) > 50 and np.median(off) < 0.15 and off.max() < 0.6


def test_ranges_after_everything_else_are_too_late():
    it, measurements = flight()
    result, _ = localized(it.rig, ranges_last(measurements))
    assert not result.summary["anchored"] and result.summary["scans"] > 150


def test_anchors_surveyed_wrong_are_outvoted_and_ids_of_no_anchor_told():
    it, measurements = flight()
    rig = moved(it.rig, {103: (5.0, 0.0, 0.0)})
    rig = with_anchors(rig, {i: p for i, p in rig.uwb.anchors.items() if i != 109})
    result, off = localized(rig, measurements)
    assert len(off) > 50 and np.median(off) < 0.15 and off.max() < 0.6
    assert result.summary["unknown_anchors"] == [109]
    refused = [event for event in result.events if event["kind"] == "range_refused" and event["anchor"] == 103]
    assert len(refused) > 50
    stamps = [event["stamp_ns"] for event in result.events]
    assert all(later - before > -1e9 for before, later in pairwise(stamps))
