"""The voxel map's kernels against plain numpy."""

import numpy as np

from localize.lidar import _COLUMNS, PointToPlane
from localize.voxel_map import VoxelMap, voxel_means
from semmap.geometry import transform


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
        voxels.insert(part)
    means, normals, variances = voxels.planes()
    assert len(means) > 20
    for mean, normal, variance in zip(means, normals, variances, strict=True):
        inside = points[(np.floor(points) == np.floor(mean)).all(axis=1)]
        values, vectors = np.linalg.eigh(np.cov(inside.T))
        np.testing.assert_allclose(mean, inside.mean(axis=0), atol=1e-9)
        # planes are refreshed every few points, so the last ones may be missing
        assert abs(normal @ vectors[:, 0]) > 0.999
        np.testing.assert_allclose(variance, values[0], rtol=0.2)


def test_map_grows_past_its_first_tables(rng):
    voxels = VoxelMap(0.5, max_points=20)
    points = rng.uniform(-60, 60, size=(120_000, 3))
    for part in np.array_split(points, 12):
        voxels.insert(part)
    assert len(voxels) == len(np.unique(np.floor(points / 0.5).astype(int), axis=0))


def test_point_to_plane_information_is_the_sum_over_points(rng, state):
    """A and b of the kernel equal HᵀWH and -HᵀWr built in numpy, with H by central differences."""
    voxels = VoxelMap(1.0, max_points=10_000)
    state.p[:] = [1.5, 1.5, 1.5]
    world = walls(rng)
    voxels.insert(world)
    seen = world[rng.choice(len(world), 60, replace=False)] + rng.normal(size=(60, 3)) * 0.01
    T = np.linalg.inv(state.T_odom_imu @ state.T_imu_lidar)
    points = transform(T, seen)

    def residuals(at):
        _, _, r, sigma, _ = voxels.point_to_plane(points, at.T_odom_imu, at.T_imu_lidar, range_variance=4e-4, gate=1e3)
        return r, sigma

    A, b, _, _, matched = voxels.point_to_plane(
        points, state.T_odom_imu, state.T_imu_lidar, range_variance=4e-4, gate=1e3
    )
    r, sigma = residuals(state)
    H = np.empty((len(points), 12))
    for k, column in enumerate(_COLUMNS):
        delta = np.zeros(42)
        delta[column] = 1e-6
        H[:, k] = (residuals(state.boxplus(delta))[0] - residuals(state.boxplus(-delta))[0]) / 2e-6
    use = np.isfinite(r) & np.isfinite(H).all(axis=1) & (np.abs(H).max(axis=1) < 50)
    assert use.sum() == matched > 40
    r, sigma = np.where(use, r, 0.0), np.where(use, sigma, 1.0)
    weight = 1.0 / (sigma**2 * (1.0 + r**2 / (4 * sigma**2)))
    np.testing.assert_allclose(A, (H[use].T * weight[use]) @ H[use], rtol=1e-4, atol=1e-2 * weight[use].max())
    np.testing.assert_allclose(b, -(H[use].T * weight[use]) @ r[use], rtol=1e-3, atol=1e-3 * weight[use].max())


def test_too_few_matches_say_nothing(state):
    voxels = VoxelMap(0.5, max_points=20)
    model = PointToPlane(np.zeros((5, 3)), voxels, 4e-4, 4.0, 4.0, 30)
    assert model.linearize(state) is None
