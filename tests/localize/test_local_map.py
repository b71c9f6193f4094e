"""Which scans the local map takes in."""

import numpy as np

from localize.filter import ErrorStateFilter, start_covariance
from localize.local_map import LocalMap, Surface
from localize.settings import ExtrinsicSettings, OdometrySettings
from semmap.geometry import inverse, transform
from semmap.rig import ImuBlock, LidarBlock

IMU = ImuBlock(topic="/imu")


def room(rng, n):
    """Points (n, 3) on the walls, floor and roof of a room of 8 x 6 x 4 m."""
    half = np.array([4.0, 3.0, 2.0])
    points = rng.uniform(-half, half, (n, 3))
    side = rng.integers(0, 3, n)
    points[np.arange(n), side] = np.where(rng.random(n) < 0.5, -half[side], half[side])
    return points + 0.01 * rng.normal(size=(n, 3))


def at_rest(state):
    """A filter that knows where it is, and a map without anything in it."""
    state.p, state.T_odom_map, state.map_centre = np.zeros(3), np.eye(4), np.zeros(3)
    P = start_covariance(IMU, tilt_std=1e-3, velocity_std=1e-3, g=state.g, mountings=ExtrinsicSettings())
    local_map = LocalMap(LidarBlock(topic="/points", p_imu_lidar=(0.0, 0.0, 0.0)), OdometrySettings())
    return ErrorStateFilter(state, P, 0, IMU), local_map


def take(local_map, filter, points):
    T_lidar_map = inverse(filter.state.T_odom_imu @ filter.state.T_imu_lidar)
    surfaces = [Surface(transform(T_lidar_map, points), local_map.planes)]
    match = local_map.match(surfaces, filter)
    local_map.extend(surfaces, filter)
    return match


def test_where_one_return_in_thirty_is_rock_scans_from_one_place_add_up_until_they_tell(rng, state):
    filter, local_map = at_rest(state)
    place = filter.state.p.copy()
    matches = [take(local_map, filter, room(rng, 300)) for _ in range(60)]
    assert matches[1].information is None
    assert matches[-1].information is not None
    np.testing.assert_allclose(filter.state.p, place, atol=0.02)


def test_scans_that_tell_are_not_taken_in_twice_from_one_place(rng, state):
    filter, local_map = at_rest(state)
    take(local_map, filter, room(rng, 8000))
    known = len(local_map.planes)
    assert take(local_map, filter, room(rng, 8000)).information is not None
    for _ in range(5):
        take(local_map, filter, room(rng, 8000) + 1e-3)
    assert len(local_map.planes) == known
