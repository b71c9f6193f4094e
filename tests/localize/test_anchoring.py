"""Alignment of odom with the map from ranges or fixes: right, or silent."""

import numpy as np
import pytest

from localize.anchoring import align_fixes, align_ranges
from localize.local_map import LocalMap
from localize.settings import OdometrySettings
from semmap.geometry import inverse, transform, yaw_rotation
from semmap.rig import LidarBlock

# the anchors of paper 000's experiment
ANCHORS = np.array([[11.376, 1.694, 2.249], [16.678, 1.769, 2.247], [16.550, -1.453, 2.224], [11.510, -1.532, 0.115]])


def track(n=120):
    s = np.linspace(0.0, 1.0, n)
    return np.stack([10.0 * s, 1.2 * np.sin(4.0 * s), 0.1 * s], axis=1)


def ranges(T_map_level, rng, *, outliers=0.0, std=0.06):
    p = track()
    anchors = ANCHORS[np.arange(len(p)) % 4]
    distances = np.linalg.norm(transform(T_map_level, p) - anchors, axis=1) + rng.normal(size=len(p)) * std
    distances[rng.random(len(p)) < outliers] += 2.0
    return p, anchors, distances


@pytest.mark.parametrize("yaw", [-3.0, -1.5, 0.0, 1.0, 2.5])
@pytest.mark.parametrize("outliers", [0.0, 0.1])
def test_ranges_align_from_any_heading(yaw, outliers):
    rng = np.random.default_rng(5)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = yaw_rotation(yaw), [12.0, -0.2, 0.9]
    found = align_ranges(*ranges(T, rng, outliers=outliers), 0.06)
    assert found is not None
    middle = track().mean(axis=0)[None]
    error = np.linalg.norm(transform(found.T_map_level, middle) - transform(T, middle))
    assert error < 0.15 and error < 4.0 * found.position_std
    assert abs(np.angle(np.exp(1j * (np.arctan2(*found.T_map_level[[1, 0], 0]) - yaw)))) < 4.0 * found.yaw_std


def test_straight_track_beside_anchors_in_line_is_not_believed():
    """The mirror image fits as well."""
    rng = np.random.default_rng(0)
    p = np.stack([np.linspace(0, 10, 80), np.zeros(80), np.zeros(80)], axis=1)
    anchors = np.array([[2.0, 2.0, 1.0], [6.0, 2.0, 1.0], [10.0, 2.0, 1.0]])[np.arange(80) % 3]
    distances = np.linalg.norm(p - anchors, axis=1) + rng.normal(size=80) * 0.05
    found = align_ranges(p, anchors, distances, 0.05)
    assert found is None or not found.sure(yaw_std=0.03, position_std=0.2)


def test_mostly_blocked_ranges_are_not_believed():
    rng = np.random.default_rng(1)
    p, anchors, distances = ranges(np.eye(4), rng, outliers=0.0)
    distances += rng.uniform(0.0, 4.0, size=len(distances))
    found = align_ranges(p, anchors, distances, 0.06)
    assert found is None


def test_too_few_ranges_or_anchors_say_nothing():
    rng = np.random.default_rng(2)
    p, anchors, distances = ranges(np.eye(4), rng)
    assert align_ranges(p[:8], anchors[:8], distances[:8], 0.06) is None
    assert align_ranges(p, np.repeat(ANCHORS[:1], len(p), axis=0), distances, 0.06) is None


def test_fixes_align():
    rng = np.random.default_rng(3)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = yaw_rotation(2.0), [5.0, 6.0, 7.0]
    found = align_fixes(track(), transform(T, track()) + rng.normal(size=(120, 3)) * 0.002, 0.002)
    assert found is not None and found.sure(yaw_std=0.01, position_std=0.05)
    np.testing.assert_allclose(found.T_map_level, T, atol=5e-3)


def test_fixes_that_do_not_fit_or_do_not_move_are_not_believed():
    rng = np.random.default_rng(4)
    assert align_fixes(track(), rng.normal(size=(120, 3)) * 5.0, 0.002) is None
    still = np.zeros((50, 3))
    found = align_fixes(still, still + 1.0, 0.002)
    assert found is None


def turn_of(T):
    return np.arctan2(T[1, 0], T[0, 0])


LEVEL = np.array([[11.4, 1.7, 2.25], [16.7, 1.8, 2.25], [16.5, -1.5, 2.25], [11.5, -1.5, 2.25]])
LEANING = np.array([[11.376, 1.694, 2.249], [16.678, 1.769, 2.247], [11.510, -1.532, 0.115]])
UPRIGHT = np.array([[11.4, 1.7, 2.25], [16.7, 1.7, 0.3], [20.1, 1.7, 1.9]])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("anchors", "climb", "bend", "told"),
    [
        (LEVEL, 0.0, 1.2, False),  # below or above the anchors?
        (LEVEL, 0.1, 1.2, True),  # above them it would descend
        (UPRIGHT, 0.0, 0.0, False),  # on which side of the wall?
        (UPRIGHT, 0.0, 1.2, True),  # there it would bend the other way
        (LEANING, 0.0, 1.2, True),
    ],
)
def test_mirror_image_behind_the_anchors_is_ruled_out_or_nothing_is_told(anchors, climb, bend, told, seed):
    rng = np.random.default_rng([seed, 7])
    s = np.linspace(0.0, 1.0, 240)
    p = np.stack([10.0 * s, bend * np.sin(4.0 * s), 10.0 * climb * s], axis=1)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = yaw_rotation(0.1), [10.0, -0.4, 0.9 - 5.0 * climb]
    at = anchors[np.arange(len(p)) % len(anchors)]
    distances = np.linalg.norm(transform(T, p) - at, axis=1) + 0.05 * rng.normal(size=len(p))
    found = align_ranges(p, at, distances, 0.05)
    sure = found is not None and found.sure(yaw_std=0.03, position_std=0.2)
    assert sure == told
    if sure:
        middle = p.mean(axis=0)[None]
        assert np.linalg.norm(transform(found.T_map_level, middle) - transform(T, middle)) < 4.0 * found.position_std
        assert abs(turn_of(found.T_map_level) - 0.1) < 4.0 * found.yaw_std


def test_biased_ranges_are_known_to_be_worth_less():
    """Each anchor reads up to decimetres too long: the place is off by as much, and it is told."""
    scores = []
    for seed in range(12):
        rng = np.random.default_rng([seed, 3])
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = yaw_rotation(0.7), [12.0, -0.2, 0.9]
        p, anchors, distances = ranges(T, rng)
        bias = rng.normal(size=4) * 0.1
        found = align_ranges(p, anchors, distances + bias[np.arange(len(p)) % 4], 0.06, 0.1)
        assert found is not None and found.position_std > 0.05
        middle = p.mean(axis=0)[None]
        off = transform(found.T_map_level, middle) - transform(T, middle)
        scores.append(np.linalg.norm(off) / found.position_std)
    assert np.sqrt(np.mean(np.square(scores))) < 1.8


ROOF = np.array([[11.4, 1.5, 3.3], [16.7, 1.4, 3.3], [16.5, -1.5, 3.3], [11.5, -1.5, 3.3]])


def floor_and_roof(T_map_level):
    """A drift as the LiDAR sees it, in level odom: floor at z = 0 and roof at z = 3.5 of the map."""
    x, y = np.meshgrid(np.arange(0.0, 30.0, 0.1), np.arange(-2.5, 2.5, 0.1))
    planes = [np.column_stack([x.ravel(), y.ravel(), np.full(x.size, z)]) for z in (0.0, 3.5)]
    return transform(inverse(T_map_level), np.concatenate(planes))


@pytest.mark.parametrize("seed", range(3))
def test_mirror_image_below_the_floor_is_told_by_the_rock_that_lies_between(seed):
    """Anchors in a level plane, a level way: above or below them fits alike, but there the roof would be in the way."""
    rng = np.random.default_rng([seed, 8])
    s = np.linspace(0.0, 1.0, 240)
    p = np.stack([10.0 * s, np.sin(4.0 * s), np.zeros(240)], axis=1)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = yaw_rotation(0.1), [10.0, -0.4, 1.0]
    at = ROOF[np.arange(len(p)) % 4]
    distances = np.linalg.norm(transform(T, p) - at, axis=1) + 0.05 * rng.normal(size=len(p))
    assert align_ranges(p, at, distances, 0.05) is None
    rock = LocalMap(LidarBlock(topic="/points", p_imu_lidar=(0.0, 0.0, 0.0)), OdometrySettings())
    rock.planes.insert(floor_and_roof(T), np.eye(4))
    found = align_ranges(p, at, distances, 0.05, hidden=lambda tags, anchors: rock.hides(tags, anchors, np.eye(4)))
    assert found is not None and found.sure(yaw_std=0.03, position_std=0.2)
    middle = p.mean(axis=0)[None]
    assert np.linalg.norm(transform(found.T_map_level, middle) - transform(T, middle)) < 4.0 * found.position_std


def test_place_from_which_rock_hides_the_anchors_is_not_believed():
    rng = np.random.default_rng(9)
    p, anchors, distances = ranges(np.eye(4), rng)
    assert align_ranges(p, anchors, distances, 0.06, hidden=lambda tags, at: np.zeros(len(tags), bool)) is not None
    assert align_ranges(p, anchors, distances, 0.06, hidden=lambda tags, at: np.ones(len(tags), bool)) is None


ALONG = np.array([[15.0, 0.6, 3.1], [8.6, 1.8, 1.2], [-0.2, -0.6, 3.4], [7.4, -1.8, 1.2], [13.0, -1.9, 0.4]])


@pytest.mark.parametrize(("count", "off", "told"), [(4, 1.0, False), (4, 5.0, False), (5, 1.0, True)])
def test_three_anchors_are_no_proof_against_a_fourth_but_four_are_against_a_fifth(count, off, told):
    """With one of four surveyed wrong, the other three fit at a wrong place too."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = yaw_rotation(0.02), [0.0, 0.0, 1.5]
    surveyed = ALONG[:count]
    wrong = surveyed + np.where(np.arange(count) == 1, off, 0.0)[:, None] * [1.0, 0.0, 0.0]
    for seed in range(4):
        rng = np.random.default_rng([seed, 4])
        s = np.linspace(0.0, 22.0, 160)
        p = np.stack([s, 0.6 * np.sin(0.2 * s), 0.02 * s], axis=1)
        which = np.arange(len(p)) % count
        distances = np.linalg.norm(transform(T, p) - surveyed[which], axis=1) + 0.06 * rng.normal(size=len(p))
        assert align_ranges(p, surveyed[which], distances, 0.06) is not None
        found = align_ranges(p, wrong[which], distances, 0.06)
        assert (found is not None) == told
        if found is not None:
            middle = p.mean(axis=0)[None]
            error = np.linalg.norm(transform(found.T_map_level, middle) - transform(T, middle))
            assert error < 4.0 * found.position_std


def fixes_of_a_drive(speed, offset_s, rng):
    """Points in odom, how fast they move, and fixes that are ``offset_s`` later than they say (n, 3), for a speed that
    is a function of time [s]."""
    t = np.arange(0.0, 20.0, 0.5)
    s = np.concatenate([[0.0], np.cumsum(speed(np.arange(0.0, 21.0, 0.01)) * 0.01)])

    def along(t):
        x = np.interp(t, 0.01 * np.arange(len(s)), s)
        return np.column_stack([x, np.zeros((len(x), 2))])

    v = np.column_stack([speed(t), np.zeros((len(t), 2))])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = yaw_rotation(1.0), [5.0, -3.0, 1.0]
    return T, along(t), v, transform(T, along(t + offset_s)) + 0.002 * rng.normal(size=(len(t), 3))


@pytest.mark.parametrize("offset_s", [-0.15, 0.0, 0.15])
def test_at_constant_speed_the_place_is_known_no_better_than_the_clock(offset_s):
    rng = np.random.default_rng(3)
    T, p, v, fixes = fixes_of_a_drive(lambda t: 1.5 + 0.0 * t, offset_s, rng)
    found = align_fixes(p, fixes, 0.002, v_level=v, clock_std=0.1)
    assert found is not None
    off = np.linalg.norm(found.T_map_level[:3, 3] - T[:3, 3])
    assert 0.149 < found.position_std < 0.17 and off < 2.0 * found.position_std
    np.testing.assert_allclose(found.clock_std, 0.1, rtol=0.02)


@pytest.mark.parametrize("offset_s", [-0.3, 0.0, 0.3])
def test_a_changing_speed_tells_the_clock(offset_s):
    rng = np.random.default_rng(4)
    T, p, v, fixes = fixes_of_a_drive(lambda t: 1.0 + 0.8 * np.sin(0.4 * t), offset_s, rng)
    found = align_fixes(p, fixes, 0.002, v_level=v, clock_std=0.1)
    assert found is not None and found.clock_std < 0.02
    assert abs(found.clock_offset - offset_s) < 2.5 * found.clock_std
    assert np.linalg.norm(found.T_map_level[:3, 3] - T[:3, 3]) < 2.5 * found.position_std < 0.1
