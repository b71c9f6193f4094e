"""The floor under a few views: found on slopes, under clutter, and without a roof."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_mine import straight

from maps.ground import ground_of
from maps.settings import FreeSpaceSettings
from semmap.errors import CloudError

SETTINGS = FreeSpaceSettings()
MIDDLE = np.column_stack([np.linspace(-18.0, 18.0, 60), np.zeros(60)])


@pytest.mark.parametrize("degrees", [0.0, 8.0, 15.0])
@pytest.mark.parametrize("roofed", [True, False])
def test_floor_of_a_slope(degrees: float, roofed: bool) -> None:
    rise = float(np.tan(np.radians(degrees)))
    mine = replace(straight(), slope=(rise, -0.1), yaw=0.4)
    truth = mine.to_map(MIDDLE)
    ground = ground_of(mine.cloud(roofed=roofed), SETTINGS)
    assert np.abs(ground.at(truth[:, :2]) - truth[:, 2]).max() < 0.08


def test_reflections_below_the_floor_do_not_pull_it_down() -> None:
    rng = np.random.default_rng(2)
    stray = np.column_stack([rng.uniform(-18, 18, 40), rng.uniform(-1.8, 1.8, 40), rng.uniform(-4.0, -1.0, 40)])
    ground = ground_of(np.vstack([straight().cloud(), stray]), SETTINGS)
    assert np.abs(ground.at(MIDDLE)).max() < 0.2


def test_floor_under_a_parked_machine_is_carried_on() -> None:
    cloud = straight().cloud()
    under = (np.abs(cloud[:, 0]) < 1.5) & (np.abs(cloud[:, 1]) < 0.8) & (cloud[:, 2] < 1.0)
    rng = np.random.default_rng(3)
    top = np.column_stack([rng.uniform(-1.5, 1.5, 900), rng.uniform(-0.8, 0.8, 900), np.full(900, 1.5)])
    ground = ground_of(np.vstack([cloud[~under], top]), SETTINGS)
    assert np.abs(ground.at(MIDDLE)).max() < 0.1


def test_a_cloud_of_walls_only_has_no_floor() -> None:
    cloud = straight().cloud(roofed=False)
    with pytest.raises(CloudError, match="shows no floor"):
        ground_of(cloud[(np.abs(cloud[:, 1]) > 1.9) & (np.abs(cloud[:, 0]) < 19.0)], SETTINGS)
    with pytest.raises(CloudError, match="shows no floor"):
        ground_of(np.zeros((0, 3)), SETTINGS)
