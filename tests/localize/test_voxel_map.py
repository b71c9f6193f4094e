"""The voxel map's kernels against plain numpy."""

import numpy as np
import pytest

from localize.lidar import _COLUMNS, ScanPart, ScanToMap, _columns_of
from localize.state import ERROR_DIM
from localize.voxel_map import RangeNoise, Shapes, VoxelMap, voxel_means
from semmap.geometry import inverse, transform


def walls(rng, n=4000, noise=0.01):
    """A room corner: floor and two walls, 4 m wide."""
    uv = rng.uniform(0.05, 3.95, size=(3, n, 2))
    parts = [np.insert(uv[axis], axis, rng.normal(size=n) * noise + 0.21, axis=1) for axis in range(3)]
    return np.concatenate(parts)


def test_voxel_means_equal_numpy_groups(rng):
    points = rng.normal(size=(5000, 3)) * 3 - 1
    means = voxel_means(points, 0.7)
    cells = np.floor(points / 0.7).astype(int)
    unique, inverse = np.unique(cells, axis=0, return_inverse=True)
    expected = np.array([points[inverse.ravel() == k].mean(axis=0) for k in range(len(unique))])
    assert len(means) == len(unique)
    order = np.lexsort(np.round(means, 9).T)
    np.testing.assert_allclose(means[order], expected[np.lexsort(np.round(expected, 9).T)], atol=1e-12)


def test_planes_equal_numpy_covariances(rng):
    points = walls(rng)
    voxels = VoxelMap(1.0, max_points=10_000)
    for part in np.array_split(points, 7):
        voxels.insert(part, np.eye(4))
    means, normals, variances = voxels.planes()
    assert len(means) > 20
    for mean, normal, variance in zip(means, normals, variances, strict=True):
        inside = points[(np.floor(points) == np.floor(mean)).all(axis=1)]
        values, vectors = np.linalg.eigh(np.cov(inside.T))
        np.testing.assert_allclose(mean, inside.mean(axis=0), atol=1e-9)
        # planes are refreshed every few points, so the last ones may be missing
        assert abs(normal @ vectors[:, 0]) > 0.999
        # drawn to the roughness taken for granted, by ten points' worth
        n = len(inside)
        np.testing.assert_allclose(variance, (values[0] * (n - 1) + 10 * 0.02**2) / (n + 7), rtol=0.1)


def test_map_grows_past_its_first_tables(rng):
    voxels = VoxelMap(0.5, max_points=20)
    points = rng.uniform(-60, 60, size=(120_000, 3))
    for part in np.array_split(points, 12):
        voxels.insert(part, np.eye(4))
    assert len(voxels) == len(np.unique(np.floor(points / 0.5).astype(int), axis=0))


NOISE = RangeNoise(4e-4, 1e-6)


def expected_information(residuals, state, sigmas, weights_at):
    """A and b in numpy, with H of every residual by central differences over the columns of the model."""
    H = np.empty((*residuals(state).shape, len(_COLUMNS)))
    for k, column in enumerate(_COLUMNS):
        delta = np.zeros(ERROR_DIM)
        delta[column] = 1e-6
        H[..., k] = (residuals(state.boxplus(delta)) - residuals(state.boxplus(-delta))) / 2e-6
    r = residuals(state)
    # a point at the border of two voxels changes its plane within the step
    use = np.isfinite(r) & np.isfinite(H).all(axis=-1) & (np.abs(np.nan_to_num(H)).max(axis=-1) < 50)
    weight = weights_at(r[use], sigmas[use])
    return (H[use].T * weight) @ H[use], -(H[use].T * weight) @ r[use], use


@pytest.mark.parametrize("shapes", [Shapes.PLANES, Shapes.EDGES])
def test_information_is_the_sum_over_points(rng, state, shapes):
    """A and b of the match equal HᵀWH and -HᵀWr built in numpy, for the pose, the extrinsic and the map's place."""
    world = walls(rng) if shapes is Shapes.PLANES else posts(rng)
    voxels = VoxelMap(1.0, max_points=10_000, shapes=shapes)
    voxels.insert(world, np.eye(4))
    seen = world[rng.choice(len(world), 80, replace=False)] + rng.normal(size=(80, 3)) * 0.01
    T_lidar_map = inverse(inverse(state.T_odom_map) @ state.T_odom_imu @ state.T_imu_lidar)
    points = transform(T_lidar_map, seen)

    def match(at, points):
        T_map_imu = inverse(at.T_odom_map) @ at.T_odom_imu
        return voxels.match(points, T_map_imu, at.T_imu_lidar, noise=NOISE, gate=1e3)

    def expected(points):
        return expected_information(
            lambda at: match(at, points).residuals,
            state,
            match(state, points).sigmas,
            lambda r, sigma: 1.0 / (sigma**2 * (1.0 + r**2 / (4 * sigma**2))),
        )

    # without the points that the step takes over the border of a shape
    points = points[expected(points)[2].any(axis=1)]
    found, J = match(state, points), _columns_of(state)
    A, b, use = expected(points)
    assert use.any(axis=1).sum() == found.matched > 40
    assert (use.sum(axis=1) <= (1 if shapes is Shapes.PLANES else 2)).all()
    np.testing.assert_allclose(J @ found.A @ J.T, A, rtol=1e-4, atol=1e-6 * np.abs(A).max())
    np.testing.assert_allclose(J @ found.b, b, rtol=1e-3, atol=1e-5 * np.abs(b).max())


def posts(rng, n=1500):
    """Upright and lying posts, thin and noisy."""
    along = rng.uniform(0.0, 4.0, size=n)
    upright = np.column_stack([np.full(n, 1.4), np.full(n, 2.6), along])
    lying = np.column_stack([along, np.full(n, 3.3), np.full(n, 0.4)])
    return np.concatenate([upright, lying]) + rng.normal(size=(2 * n, 3)) * 0.01


def test_edges_lie_along_the_posts(rng):
    voxels = VoxelMap(1.0, max_points=10_000, shapes=Shapes.EDGES)
    voxels.insert(posts(rng), np.eye(4))
    means, directions = voxels.edges()
    upright = np.hypot(means[:, 0] - 1.4, means[:, 1] - 2.6) < 0.1
    assert upright.sum() == 4 and len(means) == 8
    assert (np.abs(directions[upright, 2]) > 0.999).all()
    assert (np.abs(directions[~upright, 0]) > 0.999).all()


def test_planes_and_edges_are_told_apart_by_the_ratio_of_paper_002(rng):
    voxels = VoxelMap(1.0, max_points=10_000, shapes=Shapes.PLANES_AND_EDGES)
    floor = np.column_stack([rng.uniform(0, 4, size=(4000, 2)), 0.5 + 0.01 * rng.normal(size=4000)])
    post = np.column_stack([np.full((900, 2), 1.5) + 0.01 * rng.normal(size=(900, 2)), rng.uniform(1.05, 3.95, 900)])
    voxels.insert(np.concatenate([floor, post]), np.eye(4))
    _, normals, _ = voxels.planes()
    _, directions = voxels.edges()
    assert len(normals) == 16 and (np.abs(normals[:, 2]) > 0.99).all()
    assert len(directions) == 3 and (np.abs(directions[:, 2]) > 0.99).all()


def test_noise_of_the_map_is_what_wrong_planes_make_of_a_pose(rng, state):
    """Many maps of the same corner from few noisy points: poses matched to them scatter as `map_noise` says."""
    state.T_odom_map = np.eye(4)
    state.map_centre = state.p
    free = range(6)
    world = walls(rng, n=3000, noise=0.0)
    T_lidar_odom = inverse(state.T_odom_imu @ state.T_imu_lidar)
    errors, noises = [], []
    for _ in range(120):
        voxels = VoxelMap(1.0, max_points=10_000)
        voxels.insert(world[rng.choice(len(world), 400, replace=False)] + rng.normal(size=(400, 3)) * 0.03, np.eye(4))
        points = transform(T_lidar_odom, world[rng.choice(len(world), 500, replace=False)])
        model = ScanToMap([ScanPart(points, voxels)], RangeNoise(1e-8, 1e-8), 1e3, 1.0, 30)
        info = model.linearize(state)
        errors.append(np.linalg.solve(info.A[np.ix_(free, free)], info.b[:6]))
        noises.append(model.map_noise(state))
    J = np.eye(6)
    J[:3, :3] = state.R
    scatter = np.cov(np.array(errors).T)
    claimed = J.T @ np.mean(noises, axis=0) @ J
    # the prior roughness makes few points count a little less than they could
    ratio = np.diag(scatter) / np.diag(claimed)
    assert (ratio < 1.6).all() and (ratio > 0.3).all()


def test_new_share_of_the_map():
    grid = np.stack(np.meshgrid(np.arange(0, 4, 0.1), np.arange(0, 4, 0.1)), axis=-1).reshape(-1, 2) + 0.05
    floor = np.column_stack([grid, np.full(len(grid), 0.5)])
    voxels = VoxelMap(1.0, max_points=250)
    for share in (1.0, 0.5, 50 / 250, 0.0):
        told = voxels.insert(floor, np.eye(4), np.array([1.0, 2.0, 0.5]))
        # a floor tells of the height, and of turns about both level axes
        np.testing.assert_allclose(told.new, share * told.A, atol=1e-6 * told.A.max())
        assert told.A[5, 5] > 100.0 and (np.diag(told.A)[2:5] < 1e-6).all()
        np.testing.assert_allclose(np.diag(told.A)[:2] / told.A[5, 5], [1.25, 2.25], rtol=0.01)


def test_of_what_the_noise_of_old_normals_tells_all_counts_as_new(rng):
    floor = np.column_stack([rng.uniform(0, 4, (4000, 2)), 0.5 + 0.02 * rng.normal(size=4000)])
    voxels = VoxelMap(1.0, max_points=250)
    voxels.insert(floor, np.eye(4))
    told = voxels.insert(floor, np.eye(4))
    assert told.new[5, 5] < 0.05 * told.A[5, 5]
    # each normal leans by chance, so a floor seems to tell of the place on it
    level = np.arange(3, 5)
    assert (told.A[level, level] > 0.1).all()
    assert (told.new[level, level] > 0.3 * told.A[level, level]).all()
    assert (told.new[level, level] < 6.0 * told.A[level, level]).all()


def test_the_far_half_is_forgotten_and_the_near_half_stays_as_it_was(rng):
    points = np.column_stack([rng.uniform(0, 100, 40_000), rng.uniform(0, 3, 40_000), 0.01 * rng.normal(size=40_000)])
    voxels, all_of_it = VoxelMap(0.5, max_points=60), VoxelMap(0.5, max_points=60)
    for part in np.array_split(points, 5):
        voxels.insert(part, np.eye(4))
        all_of_it.insert(part, np.eye(4))
    before = len(voxels)
    voxels.forget_far(np.array([100.0, 1.5, 0.0]), before)
    assert len(voxels) == before
    limit = before - 1
    voxels.forget_far(np.array([100.0, 1.5, 0.0]), limit)
    assert len(voxels) == limit // 2
    means, normals, variances = voxels.planes()
    assert means[:, 0].min() > 45.0
    old_means, old_normals, old_variances = all_of_it.planes()
    kept = [int(np.argmin(np.sum((old_means - mean) ** 2, axis=1))) for mean in means]
    np.testing.assert_array_equal(old_means[kept], means)
    np.testing.assert_array_equal(old_normals[kept], normals)
    np.testing.assert_array_equal(old_variances[kept], variances)
    # it goes on where it was: found again, and new voxels beside the old
    voxels.insert(np.array([[99.9, 1.5, 0.0], [-5.0, 0.0, 0.0]]), np.eye(4))
    assert len(voxels) == limit // 2 + 1


def test_too_few_matches_say_nothing(state):
    model = ScanToMap([ScanPart(np.zeros((5, 3)), VoxelMap(0.5, max_points=20))], NOISE, 4.0, 4.0, 30)
    assert model.linearize(state) is None
    assert model.map_noise(state) is None


def test_a_plane_is_not_drawn_out_beyond_its_points(rng, state):
    """Points on one half of a voxel say nothing of the other half: the rock may bend there."""
    voxels = VoxelMap(1.0, max_points=10_000)
    voxels.insert(
        np.column_stack([rng.uniform(0.0, 0.5, 400), rng.uniform(0.0, 1.0, 400), rng.normal(0.5, 0.01, 400)]), np.eye(4)
    )
    across = np.column_stack([np.linspace(0.05, 0.95, 10), np.full(10, 0.5), np.full(10, 0.5)])
    found = voxels.match(across, np.eye(4), np.eye(4), noise=NOISE, gate=1e3)
    met = np.isfinite(found.residuals[:, 0])
    assert met[across[:, 0] < 0.5].all() and not met[across[:, 0] > 0.7].any()
