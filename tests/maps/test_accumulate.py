"""Points added up by voxel: means as numpy has them, wherever they lie and however often the table grows."""

import numpy as np
import pytest

from maps.accumulate import AccumulatedCloud
from semmap.errors import CloudError

ORIGIN = np.array([431_000.0, 5_127_000.0, -1_000.0])


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def means_by_voxel(points, voxel):
    """The oracle: voxel -> mean, count."""
    keys, owner, count = np.unique(
        np.floor(points / voxel).astype(int), axis=0, return_inverse=True, return_counts=True
    )
    means = np.stack([np.bincount(owner.ravel(), points[:, k]) for k in range(3)], axis=1) / count[:, None]
    return keys, means, count


@pytest.mark.parametrize("batches", [1, 40])
def test_means_are_those_of_each_voxel(rng, batches):
    points = rng.normal(scale=[20.0, 20.0, 3.0], size=(60_000, 3))
    cloud = AccumulatedCloud(0.5, ORIGIN)
    for batch in np.array_split(points, batches):
        cloud.add(ORIGIN + batch)
    _, means, count = means_by_voxel(points, 0.5)
    assert len(cloud) == len(means)
    # np.unique sorts by x, then y, then z: the order of the keys
    np.testing.assert_allclose(np.concatenate(list(cloud.blocks())) - ORIGIN, means, atol=1e-6)
    np.testing.assert_allclose(np.concatenate(list(cloud.blocks(3))) - ORIGIN, means[count >= 3], atol=1e-6)


def test_it_grows_with_the_mine_and_not_with_the_recording(rng):
    points = rng.uniform(-5.0, 5.0, size=(5_000, 3))
    cloud = AccumulatedCloud(0.2, np.zeros(3))
    cloud.add(points)
    voxels, size = len(cloud), len(cloud._keys)
    for _ in range(300):
        cloud.add(points)
    assert (len(cloud), len(cloud._keys)) == (voxels, size)
    # a voxel has its fill: the mean of its points stays what it is
    np.testing.assert_allclose(np.concatenate(list(cloud.blocks())), means_by_voxel(points, 0.2)[1], atol=2e-4)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e6])
def test_what_has_no_voxel_is_refused(bad):
    with pytest.raises(CloudError, match="not finite, or too far"):
        AccumulatedCloud(0.1, np.zeros(3)).add(np.array([[0.0, bad, 0.0]]))


def test_of_nothing_there_is_nothing():
    cloud = AccumulatedCloud(0.1, np.zeros(3))
    cloud.add(np.zeros((0, 3)))
    assert len(cloud) == 0 and list(cloud.blocks()) == []
