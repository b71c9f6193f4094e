"""UWB models, the position solver, the check of ranges, and the predictions that do without an IMU."""

import numpy as np
import pytest
from scipy.stats import chi2

from localize.filter import ErrorStateFilter, InertialTrack
from localize.local_map import LocalMap
from localize.motion import coast, follow
from localize.range_check import RangeCheck
from localize.ranging import Ranging
from localize.settings import OdometrySettings, RangeSettings
from localize.state import BIASES_FROM, ERROR_DIM, GRAVITY, ODOM, POSITION, RANGE_SCALE, ROTATION, VELOCITY
from localize.tag_locator import TagLocator
from localize.tag_position import Ranges, TagFix, find_tag
from localize.uwb import _COLUMNS, TagPosition, TagRange, Vertical, tag_in_map
from semmap.geometry import inverse, se3, so3_exp, transform
from semmap.measurements import UwbRange
from semmap.rig import ImuBlock, LidarBlock, UwbBlock

ANCHORS = {
    100: np.array([11.376, 1.694, 2.249]),
    101: np.array([16.678, 1.769, 2.247]),
    102: np.array([16.550, -1.453, 2.224]),
    103: np.array([11.510, -1.532, 0.115]),
}
"""Of paper 000's experiment."""
POSITIONS = np.array(list(ANCHORS.values()))


def block(**changed):
    return UwbBlock(topic="/uwb", p_imu_tag=(0, 0, 0), anchors={k: tuple(p) for k, p in ANCHORS.items()}, **changed)


@pytest.mark.parametrize("anchor", [3, 8], ids=["with a bias", "without"])
def test_range_jacobian(located, rng, check_jacobian, anchor):
    model = TagRange(anchor, 5.0 * rng.normal(size=3), 4.2, 0.1)
    assert len(model.columns(located)) == 16 + (anchor in located.anchors)
    check_jacobian(model.residual, model.jacobian(located), located, model.columns(located))


def test_position_jacobian(located, rng, check_jacobian):
    model = TagPosition(rng.normal(size=3), np.eye(3))
    check_jacobian(model.residual, model.jacobian(located), located, _COLUMNS)


def test_vertical_jacobian(located, rng, check_jacobian):
    located.g = -9.81 * located.T_map_odom[2, :3]  # vertical, so that its length can stay
    model = Vertical(0.01)
    check_jacobian(model.residual, model.jacobian(located), located, np.r_[GRAVITY, ODOM])
    np.testing.assert_allclose(model.residual(located), 0.0, atol=1e-12)


def test_a_true_range_leaves_no_residual(located):
    """Lever arm, place of odom, scale and bias of the anchor, all as they are."""
    tag = located.T_map_odom @ located.T_odom_imu @ located.T_imu_tag[:, 3]
    np.testing.assert_allclose(tag_in_map(located), tag[:3], atol=1e-12)
    p = np.array([4.0, -2.0, 7.0])
    located.range_scale = 1.05
    distance = 1.05 * np.linalg.norm(tag[:3] - p) + located.range_biases[1]
    np.testing.assert_allclose(TagRange(3, p, distance, 0.1).residual(located), 0.0, atol=1e-12)


def solve(p, rng, *, std=0.05, anchors=POSITIONS, prior=None, outlier=0.0):
    distances = np.linalg.norm(p - anchors, axis=1) + std * rng.normal(size=len(anchors))
    distances[0] += outlier
    return find_tag(Ranges(anchors, distances, np.full(len(anchors), std), np.zeros(len(anchors))), prior=prior)


def test_position_solver_agrees_with_its_covariance():
    rng = np.random.default_rng(0)
    squared = []
    for _ in range(150):
        p = np.array([rng.uniform(5, 20), rng.uniform(-1, 1), rng.uniform(0.3, 1.2)])
        fix = solve(p, rng, prior=TagFix(p + [0.3, 0.3, 0.0], np.diag([2.0, 2.0, 2.0]) ** 2, np.zeros(0)))
        error = fix.p_map - p
        squared.append(error @ np.linalg.solve(fix.covariance, error))
    assert 0.6 < np.mean(squared) / 3 < 1.5


def test_anchors_in_one_plane_say_that_there_are_two_places():
    rng = np.random.default_rng(1)
    roof = POSITIONS * [1.0, 1.0, 0.0] + [0.0, 0.0, 2.2]
    p = np.array([13.0, 0.5, 0.9])
    fix = solve(p, rng, anchors=roof)
    below, above = sorted([fix.p_map, fix.mirror], key=lambda q: q[2])
    np.testing.assert_allclose(below, p, atol=0.4)
    np.testing.assert_allclose(above, [13.0, 0.5, 3.5], atol=0.4)
    assert np.sqrt(fix.covariance[2, 2]) > 2.0
    known = solve(p, rng, anchors=roof, prior=TagFix(np.array([13, 0, 1.0]), np.diag([9, 9, 0.1]), np.zeros(0)))
    assert known.mirror is None and np.linalg.norm(known.p_map - p) < 0.4


def test_anchors_in_line_leave_a_circle_open():
    line = np.array([[0.0, 0, 2], [5, 0, 2], [10, 0, 2], [15, 0, 2]])
    fix = solve(np.array([6.0, 2.0, 0.5]), np.random.default_rng(2), anchors=line)
    assert abs(fix.p_map[0] - 6.0) < 0.2
    assert np.sqrt(np.linalg.eigvalsh(fix.covariance)[-1]) > 1.0


def test_too_few_ranges_say_nothing():
    assert solve(np.zeros(3), np.random.default_rng(3), anchors=POSITIONS[:2]) is None


def test_ranges_of_a_moving_tag_are_put_together():
    """Anchors asked one after another over a second, at 1 m/s: the place is that of the last one."""
    rng = np.random.default_rng(4)
    ages = np.linspace(1.0, 0.0, 40)
    anchors = POSITIONS[np.arange(40) % 4]
    p, v = np.array([14.0, 0.2, 0.8]), np.array([0.9, 0.1, 0.0])
    distances = np.linalg.norm(p - ages[:, None] * v - anchors, axis=1) + 0.05 * rng.normal(size=40)
    fix = find_tag(
        Ranges(anchors, distances, np.full(40, 0.05), ages), prior=TagFix(p, np.diag([4.0, 4.0, 0.04]), np.zeros(0))
    )
    np.testing.assert_allclose(fix.p_map, p, atol=0.12)


class TestCheck:
    """A tag that stands 10 m from an anchor, read ten times a second."""

    def run(self, readings, predicted_std=0.02, **settings):
        check = RangeCheck(RangeSettings(**settings))
        return check, [
            check.judge(UwbRange(k * 10**8, 1, float(r)), 10.0, predicted_std, 0.05).refused
            for k, r in enumerate(readings)
        ]

    def test_one_odd_reading_is_a_jump(self):
        _, said = self.run([10.0, 10.02, 9.97, 6.6, 10.01, 10.0])
        assert said == ["", "", "", "jump", "", ""]

    def test_a_burst_of_odd_readings_costs_no_good_one(self):
        _, said = self.run([10.0] * 5 + [6.6, 6.7, 6.6] + [10.0] * 5)
        assert said == [""] * 5 + ["jump"] * 3 + [""] * 5

    def test_even_where_the_filter_does_not_know(self):
        _, said = self.run([10.0, 10.02, 9.97, 6.6, 10.01], predicted_std=3.0)
        assert said == ["", "", "", "jump", ""]

    def test_a_way_that_becomes_blocked(self):
        """Too long again and again: no jump any more, but long; heard again only after a few that agree."""
        check, said = self.run([10.0] * 4 + [11.5] * 10)
        assert said[4:6] == ["jump"] * 2 and set(said[6:]) == {"long"} and check.blocked == {1}
        check, said = self.run([10.0] * 4 + [11.0] * 10 + [10.0] * 10)
        assert said[-4:] == [""] * 4 and "probation" in said and not check.blocked

    def test_too_short_does_not_block(self):
        check, said = self.run([9.0] * 8)
        assert set(said) == {"short"} and not check.blocked

    def test_the_odd_ones_weigh_less(self):
        check = RangeCheck(RangeSettings())
        plain = check.judge(UwbRange(0, 1, 10.02), 10.0, 0.02, 0.05)
        odd = check.judge(UwbRange(10**8, 1, 10.2), 10.0, 0.02, 0.05)
        assert not plain.refused and plain.std == 0.05 and not odd.refused and odd.std > 0.08

    def test_an_anchor_that_fell_silent(self):
        check, _ = self.run([10.0] * 5)
        assert not check.silent(10**9) and check.silent(5 * 10**9) == {1}


def start(level_state, p=(0, 0, 0), v=(0, 0, 0), position_std=0.3, velocity_std=0.3):
    filter = ErrorStateFilter(level_state, np.zeros((ERROR_DIM, ERROR_DIM)), 0, ImuBlock(topic="/imu"))
    filter.state.p, filter.state.v = np.array(p, float), np.array(v, float)
    filter.locate(np.eye(4), np.zeros((6, 6)))
    filter.P[POSITION, POSITION] = position_std**2 * np.eye(3)
    filter.P[VELOCITY, VELOCITY] = velocity_std**2 * np.eye(3)
    return filter


@pytest.fixture
def still(state):
    """At rest in odom, level, no extrinsics: what the predictions start from."""
    state.R, state.T_imu_tag = np.eye(3), np.eye(4)
    return state


def test_following_odometry_is_linearized_rightly(still, rng):
    """F and G of the step, against differences."""
    still.R = so3_exp([0.1, -0.2, 1.0])
    moved, turned = np.array([1.0, 0.2, -0.1]), np.array([0.02, 0.05, 0.4])
    columns = np.r_[ROTATION, POSITION]

    def step(delta, noise):
        filter = start(still.boxplus(delta), position_std=0.0, velocity_std=0.0)
        filter.state.R, filter.state.p = still.boxplus(delta).R, still.boxplus(delta).p
        follow(filter, 10**8, moved + noise[3:], turned + noise[:3], np.zeros(6))
        return filter.state

    end = step(np.zeros(ERROR_DIM), np.zeros(6))
    J = np.empty((6, 12))
    for k in range(12):
        delta, noise = np.zeros(ERROR_DIM), np.zeros(6)
        (delta if k < 6 else noise)[columns[k] if k < 6 else k - 6] = 1e-6
        J[:, k] = step(delta, noise).boxminus(end)[columns] / 1e-6
    filter = ErrorStateFilter(still.copy(), np.zeros((ERROR_DIM, ERROR_DIM)), 0, ImuBlock(topic="/imu"))
    L = 0.01 * rng.normal(size=(6, 6))
    filter.P[np.ix_(columns, columns)] = L @ L.T
    std = np.array([0.01, 0.01, 0.02, 0.03, 0.02, 0.01])
    follow(filter, 10**8, moved, turned, std)
    expected = J[:, :6] @ L @ L.T @ J[:, :6].T + J[:, 6:] @ np.diag(std**2) @ J[:, 6:].T
    np.testing.assert_allclose(filter.P[np.ix_(columns, columns)], expected, rtol=0.1, atol=2e-5)


def test_a_walk_by_constant_velocity_agrees_with_its_covariance(still):
    """White acceleration, ranges with biases: errors over sigma are as they should be."""
    squared, steps, density = [], 300, np.array([0.3, 0.3, 0.02])
    for seed in range(6):
        rng = np.random.default_rng(seed)
        p, v = np.array([10.0, 0.0, 0.8]), np.array([0.3, 0.0, 0.0])
        filter = start(
            still.copy(), p + 0.3 * rng.normal(size=3), v + 0.3 * rng.normal(size=3), position_std=0.3, velocity_std=0.3
        )
        ranging = Ranging(block(range_std=0.05), ANCHORS, RangeSettings(huber_sigmas=10.0))
        biases = dict(zip(ANCHORS, 0.03 * rng.normal(size=4), strict=True))
        for k in range(1, steps):
            a = density * rng.normal(size=3) / np.sqrt(0.05) - 0.05 * (p - [13.0, 0.0, 0.8]) * [1, 1, 1] - 0.3 * v
            p, v = p + 0.05 * v, v + 0.05 * a
            anchor = 100 + k % 4
            distance = np.linalg.norm(p - ANCHORS[anchor]) + biases[anchor] + 0.05 * rng.normal()
            coast(filter, k * 50_000_000, 1.5 * density)
            assert not ranging.take(UwbRange(k * 50_000_000, anchor, distance), filter).refused
            if k > 50:
                error = filter.state.p - p
                squared.append(error @ np.linalg.solve(filter.P[POSITION, POSITION], error))
        assert np.linalg.norm(error) < 0.4
    assert chi2.ppf(0.01, 3) / 3 < np.mean(squared) / 3 < 2.0


def test_scale_and_biases_are_found_on_the_way(still):
    """Radios that read 6 % too long, and one of them half a metre more, under exact odometry round the anchors."""
    rng = np.random.default_rng(5)
    p = np.array([5.0, -4.0, 0.5])
    filter = ErrorStateFilter(still, np.zeros((ERROR_DIM, ERROR_DIM)), 0, ImuBlock(topic="/imu"))
    filter.state.p = p.copy()
    filter.locate(np.eye(4), np.zeros((6, 6)), range_scale_std=0.1)
    filter.P[POSITION, POSITION] = 0.05**2 * np.eye(3)
    ranging = Ranging(block(range_std=0.1, bias_std=1.0), ANCHORS, RangeSettings())
    for k in range(1, 1200):
        moved = 0.1 * np.array([np.cos(0.02 * k), np.sin(0.02 * k), 0.0])
        p = p + moved
        follow(filter, k * 10**8, moved, np.zeros(3), np.array([0, 0, 0, 0.002, 0.002, 0.0]))
        anchor = 100 + k % 4
        distance = 1.06 * np.linalg.norm(p - ANCHORS[anchor]) + 0.5 * (anchor == 102) + 0.1 * rng.normal()
        ranging.take(UwbRange(k * 10**8, anchor, distance), filter)
    variance = np.diag(filter.P)
    assert abs(filter.state.range_scale - 1.06) < 3.0 * np.sqrt(variance[RANGE_SCALE][0]) < 0.05
    expected = [0.5 * (anchor == 102) for anchor in filter.state.anchors]
    assert np.all(np.abs(filter.state.range_biases - expected) < 3.0 * np.sqrt(variance[BIASES_FROM:]))
    assert np.linalg.norm(filter.state.p - p) < 0.2


def test_too_many_anchors_keep_the_biases_of_those_heard_last(still):
    filter = start(still, [13.0, 0.0, 1.0])
    many = {k: np.array([float(k), 2.0, 2.0]) for k in range(20)}
    ranging = Ranging(block(), many, RangeSettings())
    for k in range(20):
        coast(filter, (k + 1) * 10**8, np.zeros(3))
        ranging.take(UwbRange((k + 1) * 10**8, k, float(np.linalg.norm(filter.state.p - many[k]))), filter)
    assert filter.state.anchors == tuple(range(4, 20)) and len(filter.P) == filter.state.dim


def test_a_filter_that_all_anchors_contradict_looks_for_its_place_again(still):
    """Sure to be two metres from where it is: refused for two seconds, and then believed."""
    true, rng = np.array([13.0, 0.3, 1.0]), np.random.default_rng(7)
    filter = start(still, true + [2.5, 0.0, 0.0], position_std=0.02, velocity_std=0.02)
    ranging = Ranging(block(range_std=0.05), ANCHORS, RangeSettings())
    for k in range(1, 120):
        anchor = 100 + k % 4
        coast(filter, k * 50_000_000, np.full(3, 0.01))
        distance = np.linalg.norm(true - ANCHORS[anchor]) + 0.05 * rng.normal()
        ranging.take(UwbRange(k * 50_000_000, anchor, float(distance)), filter)
    assert ranging.doubts == 1
    np.testing.assert_allclose(tag_in_map(filter.state), true, atol=0.2)


def test_blocked_ways_do_not_make_the_filter_doubt_itself(still):
    """All too long, none too short: rock in the way, not a wrong place."""
    true = np.array([13.0, 0.3, 1.0])
    filter = start(still, true, position_std=0.05, velocity_std=0.05)
    ranging = Ranging(block(range_std=0.05), ANCHORS, RangeSettings())
    for k in range(1, 120):
        anchor = 100 + k % 4
        coast(filter, k * 50_000_000, np.full(3, 0.01))
        assert ranging.take(
            UwbRange(k * 50_000_000, anchor, float(np.linalg.norm(true - ANCHORS[anchor])) + 2.5), filter
        ).refused
    assert ranging.doubts == 0 and ranging.check.blocked == set(ANCHORS)
    np.testing.assert_allclose(tag_in_map(filter.state), true, atol=1e-9)


def test_a_reading_that_fits_but_came_through_rock_is_not_used(still):
    true = np.array([13.0, 0.3, 1.0])
    filter = start(still, true, position_std=0.05, velocity_std=0.05)
    ranging, before = Ranging(block(range_std=0.05), ANCHORS, RangeSettings()), filter.P.copy()
    local_map = LocalMap(LidarBlock(topic="/points", p_imu_lidar=(0.0, 0.0, 0.0)), OdometrySettings())
    y, z = np.meshgrid(np.arange(-3.0, 3.0, 0.1), np.arange(0.0, 4.0, 0.1))
    wall = np.column_stack([np.full(y.size, 15.1), y.ravel(), z.ravel()])
    T_map_local = filter.state.T_map_odom @ filter.state.T_odom_map
    local_map.planes.insert(transform(inverse(T_map_local), wall), np.eye(4))
    behind, before_it = ANCHORS[101], ANCHORS[100]
    reading = UwbRange(0, 101, float(np.linalg.norm(true - behind)) + 0.1)
    assert ranging.take(reading, filter, local_map).refused == "rock"
    np.testing.assert_array_equal(filter.P[:ERROR_DIM, :ERROR_DIM], before[:ERROR_DIM, :ERROR_DIM])
    assert not ranging.take(UwbRange(0, 100, float(np.linalg.norm(true - before_it))), filter, local_map).refused


def test_fixes_one_after_another_follow_a_walk_with_odd_readings():
    """The locator stays on the right side of its anchors' wall and leaves out what jumps."""
    rng = np.random.default_rng(8)
    wall = {
        1: np.array([0.0, -2, 0.5]),
        2: np.array([0.0, 2, 0.5]),
        3: np.array([0.0, 0, 3.0]),
        4: np.array([0.4, 0, 1]),
    }
    level = TagFix(np.array([5.0, 0.0, 1.0]), np.diag([10.0, 10.0, 0.15]) ** 2, np.zeros(0))
    locator = TagLocator(UwbBlock(topic="", p_imu_tag=(0, 0, 0), anchors=wall), wall, RangeSettings(), level)
    off, refused = [], 0
    for k in range(1, 400):
        p = np.array([4.0 + 0.02 * k, 1.5 * np.sin(0.02 * k), 1.0])
        distance = np.linalg.norm(p - wall[1 + k % 4]) + 0.05 * rng.normal() - 3.0 * (k % 50 == 49)
        fix, verdict = locator.add(UwbRange(k * 25_000_000, 1 + k % 4, float(distance)))
        refused += verdict is not None and bool(verdict.refused)
        if fix is not None and k > 40:
            off.append(np.linalg.norm(fix.p_map - p))
    assert np.median(off) < 0.25 and max(off) < 1.5 and refused >= 7


def test_a_track_moves_with_its_end(rng):
    """What a range moves the pose by, the scan's beginning moves by as well."""
    n = 5
    R = np.array([so3_exp(0.1 * rng.normal(size=3)) for _ in range(n)])
    track = InertialTrack(0, np.arange(n) * 0.01, R, *(rng.normal(size=(n, 3)) for _ in range(4)))
    T = se3(so3_exp(rng.normal(size=3)), rng.normal(size=3))
    np.testing.assert_allclose(track.moved(T).poses, T @ track.poses, atol=1e-12)
    np.testing.assert_allclose(track.moved(T).v, track.v @ T[:3, :3].T)


def test_a_fix_places_the_tag(still):
    """Eq. 5, 6 through the filter: the robot goes where the tag was found, less the lever arm."""
    still.T_imu_tag[:3, 3] = [0.0, 0.0, 0.3]
    filter = start(still, position_std=10.0)
    filter.update(TagPosition(np.array([3.0, 2.0, 1.0]), 1e-4 * np.eye(3)))
    np.testing.assert_allclose(filter.state.p, [3.0, 2.0, 0.7], atol=1e-3)
