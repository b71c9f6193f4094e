"""Dust is told from rock by how it fills space; clear air is left alone, whatever the rock is like."""

import numpy as np
import pytest

from localize.dust import Air, _cubes
from tools.simulator import SensorFaults, SimulationSettings, fly, scenario
from tools.simulator.lidar import scans


def wall(rng, count=4000, roughness=0.02):
    """A wall 2.5 m to the left, seen from the origin."""
    x, z = rng.uniform(-4.0, 4.0, count), rng.uniform(-1.0, 1.0, count)
    return np.column_stack([x, 2.5 + roughness * rng.normal(size=count), z])


def cloud(rng, count):
    """Dust: any direction, up to 3 m."""
    u = rng.normal(size=(count, 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True) * rng.uniform(0.6, 3.0, (count, 1))


@pytest.mark.parametrize("roughness", [0.0, 0.02, 0.04])
def test_rock_is_not_dust(rng, roughness):
    air = Air(wall(rng, roughness=roughness))
    assert air.dust < 0.01
    assert air.clear.all()


@pytest.mark.parametrize("share", [0.5, 1.0, 3.0])
def test_dust_goes_and_rock_stays(rng, share):
    rock, dust = wall(rng), cloud(rng, int(share * 6000))
    # the wall's neighbourhood has none: what is in one cube with dust cannot be told from it
    dust = dust[dust[:, 1] < 1.8]
    air = Air(np.concatenate([rock, dust]))
    assert air.dusty
    assert air.clear[: len(rock)].mean() > 0.9
    assert air.clear[len(rock) :].mean() < 0.1


def test_what_is_far_is_kept(rng):
    far = np.array([20.0, 0.0, 0.0]) + rng.normal(size=(500, 3))
    air = Air(np.concatenate([cloud(rng, 8000), far]))
    assert air.dusty
    assert air.clear[-500:].all()


def test_an_empty_scan_says_nothing():
    air = Air(np.empty((0, 3)))
    assert not air.dusty
    assert air.dust == 0.0
    assert air.clear.shape == (0,)


@pytest.mark.parametrize("name", ["demo", "ramp", "coal-tunnel"])
def test_simulated_mines_are_clear_and_then_dusty(name):
    mine = scenario(name, 3)
    for dust, dusty in ((0.0, False), (50.0, True), (200.0, True)):
        settings = SimulationSettings(faults=SensorFaults(dust=dust), start_s=30.0, duration_s=0.25)
        for scan in scans(fly(mine, seed=1, settings=settings)):
            air = Air(scan.points)
            assert air.dusty == dusty
            near = np.linalg.norm(scan.points, axis=1) < 6.0
            assert air.clear[~near].all()


def test_cubes_are_counted_as_in_numpy(rng):
    points = np.concatenate([wall(rng, 1500), cloud(rng, 1500), 20.0 * rng.normal(size=(300, 3))])
    count, thickness, cube = _cubes(points)
    near = np.linalg.norm(points, axis=1) < 6.0
    assert (cube >= 0).tolist() == near.tolist()
    keys = np.floor(points / 0.4).astype(int)
    for number in range(len(count)):
        inside = cube == number
        assert inside.sum() == count[number] and len(np.unique(keys[inside], axis=0)) == 1
        least = np.linalg.eigvalsh(np.cov(points[inside].T, bias=True))[0] if count[number] > 1 else 0.0
        np.testing.assert_allclose(thickness[number] ** 2, max(least, 0.0), atol=1e-9)
    assert len(count) == len(np.unique(keys[near], axis=0))


@pytest.mark.parametrize("count", [1, 8, 40])
def test_little_dust_is_found(rng, count):
    """What of all returns is called dusty, half of them must not call clear: plumes of any size beside the rock."""
    dusty = 0
    for share in rng.uniform(0.04, 0.3, 40):
        plumes = rng.uniform([-3.0, -2.0, -1.0], [3.0, 1.5, 1.0], (count, 3))
        dust = np.repeat(plumes, int(share * 5000 / count), axis=0)
        points = np.concatenate([wall(rng, 5000), dust + rng.uniform(-0.3, 0.3, dust.shape)])
        found = _cubes(rng.permutation(points))
        thick = (found.inside >= 6) & (found.thickness > 0.05)
        whole = found.inside[thick].sum() / found.inside.sum() > 0.05
        assert Air(points).dusty == whole
        dusty += whole
    assert dusty > 10
