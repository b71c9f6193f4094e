"""What a scan does not know it must not pretend to know: smooth tunnels, and the filter's way with blind directions."""

import numpy as np
import pytest

from localize._numba_knowledge import beyond_noise
from localize.filter import ErrorStateFilter, Information
from localize.lidar import ScanPart, ScanToMap, _columns_of
from localize.local_map import renewed
from localize.state import ERROR_DIM, LIDAR, MAP, POSITION, ROTATION, VELOCITY
from localize.voxel_map import RangeNoise, Renewal, VoxelMap
from semmap.geometry import inverse, se3_log, so3_exp, transform
from semmap.rig import ImuBlock

NOISE = RangeNoise(4e-4, 1e-6)
AXIS = np.array([1.0, 0.0, 0.0])
IMU = ImuBlock(topic="/imu")


def tunnel(rng, bumps=0.0, n=30_000):
    """A tunnel along x, 30 m long, 4 m wide and 3 m high; its walls wave by ``bumps`` [m] along it."""
    x, around = rng.uniform(-15.0, 15.0, n), rng.uniform(0.0, 14.0, n)
    side = np.digitize(around, [4.0, 7.0, 11.0])
    y = np.choose(side, [around - 2.0, np.full(n, 2.0), 9.0 - around, np.full(n, -2.0)])
    z = np.choose(side, [np.full(n, -1.5), around - 5.5, np.full(n, 1.5), 12.5 - around])
    outward = np.array([[0, 0, -1], [0, 1, 0], [0, 0, 1], [0, -1, 0]])[side]
    return np.column_stack([x, y, z]) + bumps * np.sin(2.0 * np.pi * x / 2.3 + side)[:, None] * outward


def matched(rng, state, bumps, moved=0.0, noise=0.02):
    """The model of a scan from a map of the tunnel, the pose wrong by ``moved`` [m] along it."""
    state.T_odom_map = np.eye(4)
    state.map_centre = state.p.copy()
    voxels = VoxelMap(0.5, max_points=60)
    voxels.insert(tunnel(rng, bumps) + noise * rng.normal(size=(30_000, 3)), np.eye(4))
    seen = tunnel(rng, bumps, 30_000)[:1500] + noise * rng.normal(size=(1500, 3)) - moved * AXIS
    points = transform(inverse(state.T_odom_imu @ state.T_imu_lidar), seen)
    return ScanToMap([ScanPart(points, voxels)], NOISE, 8.0, 1.0, 30)


def test_what_noise_explains_is_taken_out_as_numpy_does(rng):
    for _ in range(50):
        M, N = rng.normal(size=(20, 6)), rng.uniform(0.0, 1.2) * rng.normal(size=(20, 6))
        A, C, B, b = M.T @ M, N.T @ N, 0.3 * M.T @ M, rng.normal(size=6)
        T, Tb, odds = np.zeros((6, 6)), np.zeros((6, 6)), []
        for block in (slice(0, 3), slice(3, 6)):
            L = np.linalg.cholesky(A[block, block])
            share, V = np.linalg.eigh(np.linalg.solve(L, np.linalg.solve(L, C[block, block]).T))
            counts = np.clip(1.0 - 2.0 * share, 0.0, None) / np.maximum(1.0 - share, 0.5)
            odds += list(np.where(counts > 0.0, share / (1.0 - share), 1.0))
            left, right = L @ V, V.T @ np.linalg.inv(L)
            T[block, block] = left @ np.diag((1.0 - share) * np.sqrt(counts)) @ right
            Tb[block, block] = left @ np.diag((1.0 - share) * counts) @ right
        A_left, b_left, B_left, doubt = A.copy(), b.copy(), B.copy(), np.empty((6, 6))
        beyond_noise(A_left, b_left, B_left, C, 0.5, doubt)
        np.testing.assert_allclose(A_left, T @ A @ T.T, atol=1e-8)
        np.testing.assert_allclose(b_left, Tb @ b, atol=1e-8)
        np.testing.assert_allclose(B_left, T @ B @ T.T, atol=1e-8)
        length = np.linalg.norm(doubt, axis=0)
        np.testing.assert_allclose(np.sort(length), np.sort(odds), atol=1e-8)
        np.testing.assert_allclose(A_left @ doubt[:, length > 1.0 - 1e-9], 0.0, atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_a_smooth_tunnel_is_blind_along_its_axis_and_only_there(seed, state):
    model = matched(np.random.default_rng(seed), state, bumps=0.0)
    info = model.linearize(state)
    assert model.blind.shape == (6, 1)
    np.testing.assert_allclose(model.blind[:3], 0.0, atol=1e-12)
    assert abs(state.R @ model.blind[3:, 0] @ AXIS) > np.cos(np.radians(1.0))
    known = np.linalg.eigvalsh(info.A[np.ix_(range(6), range(6))])
    assert known[0] < 1e-6 * known[1] and known[1] > 1e4


@pytest.mark.parametrize("seed", range(3))
def test_rough_walls_are_not_blind(seed, state):
    model = matched(np.random.default_rng(seed), state, bumps=0.1)
    model.linearize(state)
    assert model.blind.shape == (6, 0)


def test_a_step_along_waved_walls_is_not_underrated(state):
    """Noise in the normals draws plain least squares towards no step at all; what is left is right in the mean."""
    plain, put_right = [], []
    for seed in range(12):
        model = matched(np.random.default_rng(seed), state, bumps=0.12, moved=0.05, noise=0.03)
        info = model.linearize(state)
        (match,) = model._matches(state)
        plain.append(AXIS @ state.R @ np.linalg.solve(match.A, match.b)[3:])
        put_right.append(AXIS @ np.linalg.solve(info.A[:6, :6], info.b[:6])[3:])
    assert np.mean(plain) < 0.8 * 0.05
    assert 0.85 * 0.05 < np.mean(put_right) < 1.25 * 0.05


def test_a_blind_update_is_schmidts(state, rng):
    """The blind error keeps its variance; the errors agree with the covariance, over many draws."""
    state.p, state.v = np.zeros(3), np.zeros(3)
    P0 = np.zeros((ERROR_DIM, ERROR_DIM))
    index = np.r_[POSITION, VELOCITY]
    root = rng.normal(size=(6, 6))
    P0[np.ix_(index, index)] = root @ root.T
    blind = np.array([[0.8, 0.6, 0.0]])
    # what the sensor does see is across the blind direction, but for a little
    H = np.array([[-0.6, 0.8, 0.01], [0.02, 0.0, 1.0]])
    errors = []
    for _ in range(3000):
        error = root @ rng.normal(size=6)
        z = H @ error[:3] + 0.1 * rng.normal(size=2)
        filter = ErrorStateFilter(state, P0.copy(), 0, IMU)
        before = filter.P[POSITION, POSITION]
        along = blind[0] @ before @ blind[0]
        filter.update(_Linear(H, z, blind))
        P = filter.P
        errors.append(error - np.r_[filter.state.p, filter.state.v])
    np.testing.assert_allclose(blind[0] @ P[POSITION, POSITION] @ blind[0], along, rtol=1e-9)
    scatter = np.cov(np.array(errors).T)
    scale = np.sqrt(np.diag(P)[index])
    each = np.outer(scale, scale)
    np.testing.assert_allclose(scatter / each, P[np.ix_(index, index)] / each, atol=0.12)
    # across, it is as sure as the sensor
    assert H[1] @ P[POSITION, POSITION] @ H[1] < 0.02


class _Linear:
    """A sensor ``z = H p + noise`` of 0.1, with a blind direction."""

    def __init__(self, H, z, blind):
        self.H, self.z, self.blind = H, z, blind

    def linearize(self, state):
        H = self.H
        return Information(100.0 * H.T @ H, 100.0 * H.T @ (self.z - H @ state.p), np.r_[POSITION], self.blind)


def test_along_a_blind_direction_the_map_is_where_the_pose_is(state, rng):
    """What a later scan finds there is what was put in now, so map and pose err alike; elsewhere the share decides."""
    filter = ErrorStateFilter(state, np.zeros((ERROR_DIM, ERROR_DIM)), 0, IMU)
    L = rng.normal(size=(ERROR_DIM, ERROR_DIM))
    L[LIDAR] = 0.0  # a mounting that is known moves nothing
    filter.P = L @ L.T
    root = rng.normal(size=(8, 6))
    A, blind = root.T @ root, np.concatenate([np.zeros(3), AXIS])[:, None]
    apart = _apart(filter.P)
    filter.extend_map(renewed(Renewal(1e6 * A, 0.25e6 * A), so3_exp(rng.normal(size=3)), blind))
    np.testing.assert_allclose(_apart(filter.P)[0], 0.0, atol=1e-9)
    np.testing.assert_allclose(_apart(filter.P)[1:, 1:], 0.75**2 * apart[1:, 1:], rtol=1e-3)


def test_the_nearer_a_scan_came_to_being_blind_the_newer_the_map_is(rng):
    root = rng.normal(size=(8, 6))
    A, along = root.T @ root, np.concatenate([np.zeros(3), AXIS])
    renewal = Renewal(1e6 * A, 0.25e6 * A)
    share = [along @ renewed(renewal, np.eye(3), odds * along[:, None]) @ along for odds in (0.0, 0.3, 0.6, 0.9, 1.0)]
    np.testing.assert_allclose(share, 1.0 - 0.75 * (1.0 - np.array([0.0, 0.3, 0.6, 0.9, 1.0]) ** 2), rtol=1e-3)


def test_the_first_rock_ahead_is_new_though_hardly_any_of_the_map_is(rng):
    """What later scans match to along the axis lies as wrong as the pose now, whatever the walls' planes lie as."""
    voxels = VoxelMap(0.5, max_points=500)
    for _ in range(4):
        voxels.insert(tunnel(rng) + 0.02 * rng.normal(size=(30_000, 3)), np.eye(4))
    walls = tunnel(rng) + 0.02 * rng.normal(size=(30_000, 3))
    face = np.column_stack([np.full(400, 16.2), rng.uniform(-2, 2, 400), rng.uniform(-1.5, 1.5, 400)])
    rock = face + 0.02 * rng.normal(size=(400, 3))
    renewal = voxels.insert(np.concatenate([walls, rock]), np.eye(4), np.zeros(3))
    share = np.diag(renewed(renewal, np.eye(3), np.zeros((6, 0))))
    assert share[3] > 0.9 and (share[4:] < 0.35).all()


@pytest.mark.parametrize("blind", [0, 1, 3])
def test_however_little_the_map_knows_no_step_makes_more_of_its_error(rng, blind):
    """In dust there are a few shapes of a few points: what their normals' noise pretends to tell is more than all."""
    in_metres = np.repeat([10.0, 1.0], 3)
    error, square = np.eye(6), []
    for _ in range(200):
        told, noise = 30.0 * rng.normal(size=(3, 6)), 100.0 * rng.normal(size=(3, 6))
        renewal = Renewal(told.T @ told, 0.2 * told.T @ told + noise.T @ noise)
        directions = np.linalg.qr(rng.normal(size=(6, max(blind, 1))))[0][:, :blind]
        new = in_metres[:, None] * renewed(renewal, so3_exp(rng.normal(size=3)), directions) / in_metres
        share = np.linalg.eigvalsh(new)
        np.testing.assert_allclose(new, new.T, atol=1e-9)
        assert share.min() > -1e-9 and share.max() < 1.0 + 1e-9
        error = (np.eye(6) - new) @ error
        square.append(np.linalg.norm(error, 2))
    assert max(square) <= 1.0 + 1e-9


def _apart(P):
    """Covariance (3, 3) of the pose's place less the map's."""
    J = np.zeros((3, ERROR_DIM))
    J[:, POSITION], J[:, MAP.start + 3 : MAP.stop] = np.eye(3), -np.eye(3)
    return J @ P @ J.T


def test_moving_robot_and_map_together_tells_nothing_of_how_they_are_turned(state):
    """The first rock after a drift moves both by many metres; a lever arm of as much would take turns for places."""
    state.T_odom_map, state.map_centre = np.eye(4), state.p.copy()
    filter = ErrorStateFilter(state, np.zeros((ERROR_DIM, ERROR_DIM)), 0, IMU)
    alike = np.zeros((ERROR_DIM, 6))
    alike[ROTATION, :3], alike[POSITION, 3:] = state.R.T, np.eye(3)
    alike[MAP] = np.eye(6)
    filter.P = alike @ np.diag([1e-3, 1e-3, 1e-3, 20.0, 0.1, 0.1]) ** 2 @ alike.T
    filter.update(_PlaceAndMatch(state, state.p + 10.0 * AXIS), iterations=4)
    assert filter.state.p[0] - state.p[0] > 9.9
    np.testing.assert_allclose(np.sqrt(np.diag(filter.P)[MAP][:3]), 1e-3, rtol=1e-3)
    np.testing.assert_allclose(np.sqrt(np.diag(filter.P)[MAP][4:]), 0.1, rtol=1e-3)


class _PlaceAndMatch:
    """A sensor of the place along the axis, of 0.1 m, and of the pose in the map, of 1e-4 rad and 1 mm."""

    def __init__(self, state, place):
        self.in_map, self.place = inverse(state.T_odom_map) @ state.T_odom_imu, place

    def linearize(self, state):
        J, weights = _columns_of(state), np.diag(np.repeat([1e8, 1e6], 3))
        moved = se3_log(inverse(self.in_map) @ inverse(state.T_odom_map) @ state.T_odom_imu)
        A, b = J @ weights @ J.T, -J @ weights @ moved
        A[3, 3] += 100.0
        b[3] += 100.0 * (self.place - state.p)[0]
        return Information(A, b, np.r_[ROTATION, POSITION, LIDAR, MAP])
