"""Whether rock that the LiDAR has seen lies between a tag and an anchor."""

import numpy as np
import pytest

from localize.local_map import LocalMap
from localize.settings import OdometrySettings
from semmap.geometry import se3, so3_exp, transform
from semmap.rig import LidarBlock


def wall(x, y=(-3.0, 3.0), z=(0.0, 3.0)):
    y, z = np.meshgrid(np.arange(*y, 0.1), np.arange(*z, 0.1))
    rng = np.random.default_rng(1)
    return np.column_stack([x + 0.03 * rng.normal(size=y.size), y.ravel(), z.ravel()])


def hides(points, tags, anchors, T_odom_map=None):
    local_map = LocalMap(LidarBlock(topic="/points", p_imu_lidar=(0.0, 0.0, 0.0)), OdometrySettings())
    local_map.planes.insert(points, np.eye(4))
    T = np.eye(4) if T_odom_map is None else T_odom_map
    return local_map.hides(transform(T, np.array(tags)), transform(T, np.array(anchors)), T)


TAGS = [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [5.6, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]
# behind the wall; before it; hung on it; on the same side as the tag; beside it; over it
ANCHORS = [[9.0, 0.5, 1.5], [4.4, 0.0, 1.0], [5.3, 0.0, 1.0], [9.0, 0.0, 1.0], [0.0, 9.0, 1.0], [9.0, 0.0, 6.0]]


def test_a_wall_between_is_in_the_way_and_one_beside_or_behind_is_not():
    np.testing.assert_array_equal(hides(wall(5.0), TAGS, ANCHORS), [True, False, False, False, False, False])


def test_the_local_map_may_lie_turned_and_moved_in_odom():
    T = se3(so3_exp(np.array([0.1, -0.2, 1.5])), np.array([300.0, -40.0, 7.0]))
    np.testing.assert_array_equal(hides(wall(5.0), TAGS, ANCHORS, T), [True, False, False, False, False, False])


@pytest.mark.parametrize("seed", range(3))
def test_every_way_through_a_wall_is_found_and_none_along_it(seed):
    rng = np.random.default_rng(seed)
    rock = wall(0.0, y=(-20.0, 20.0))
    tags = np.column_stack([rng.uniform(-6.0, -1.0, 400), rng.uniform(-15.0, 15.0, 400), rng.uniform(0.3, 2.6, 400)])
    through = tags * [-1.0, 1.0, 1.0] + np.column_stack([np.zeros(400), rng.uniform(-4.0, 4.0, 400), np.zeros(400)])
    # the wall stands on the border between two voxels, which share its points: the worst case
    assert hides(rock, tags, through).mean() > 0.97
    # an anchor that hangs out of the wall by a hand
    hung = np.column_stack([np.full(400, -0.15), rng.uniform(-19.0, 19.0, 400), rng.uniform(0.3, 2.6, 400)])
    assert not hides(rock, tags, hung).any()
    beside = np.column_stack([rng.uniform(-6.0, -0.3, 400), rng.uniform(-19.0, 19.0, 400), rng.uniform(0.3, 2.6, 400)])
    assert not hides(rock, tags, beside).any()


def test_nothing_seen_or_asked_hides_nothing_and_a_long_way_ends():
    assert not hides(np.zeros((0, 3)), np.zeros((2, 3)), [[0.0, 0.0, 0.0], [1e9, 0.0, 0.0]]).any()
    assert hides(wall(5.0), np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)
    np.testing.assert_array_equal(hides(wall(5.0), [[0.0, 0.0, 1.0]], [[1e9, 0.0, 1.0]]), [True])


def test_a_map_begun_anew_hides_nothing_and_fills_again():
    local_map = LocalMap(LidarBlock(topic="/points", p_imu_lidar=(0.0, 0.0, 0.0)), OdometrySettings())
    way = np.array([[0.0, 0.0, 1.0]]), np.array([[9.0, 0.0, 1.0]]), np.eye(4)
    for _ in range(2):
        local_map.planes.insert(wall(5.0), np.eye(4))
        assert local_map.hides(*way).all()
        local_map.begin()
        assert len(local_map.planes) == 0 and not local_map.hides(*way).any()
