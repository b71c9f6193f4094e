"""Wall contours of rooms that are known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from descriptors.settings import ContourSettings
from descriptors.wall_contour import RAYS_PER_SECTOR, ray_angles, wall_contour
from semmap.geometry import Array

SETTINGS = ContourSettings(radius=10.0, sectors=60)


def nothing() -> Array:
    return np.zeros((0, 3))


def rays(distance: Array) -> tuple[Array, NDArray[np.bool_]]:
    """What a look round shows whose walls are at these distances: open beyond the radius."""
    return np.minimum(distance, SETTINGS.radius), distance < SETTINGS.radius


def sector_of(angle: float) -> int:
    return int(angle / (2.0 * np.pi) * SETTINGS.sectors) % SETTINGS.sectors


def test_rays_fill_their_sectors_evenly() -> None:
    angles = ray_angles(SETTINGS)
    sectors = np.floor(angles / (2.0 * np.pi) * SETTINGS.sectors).astype(int)
    assert_array_equal(np.bincount(sectors), RAYS_PER_SECTOR)


def test_a_round_room_has_the_same_wall_everywhere() -> None:
    angles = ray_angles(SETTINGS)
    contour = wall_contour(nothing(), *rays(np.full(len(angles), 4.0)), SETTINGS)
    assert_allclose(contour.pwcv, 4.0)
    assert contour.pwcv_observed.all()
    assert contour.pwcv.dtype == np.float32


def test_a_corridor_is_open_along_its_axis() -> None:
    angles = ray_angles(SETTINGS)
    contour = wall_contour(nothing(), *rays(2.0 / np.abs(np.sin(angles))), SETTINGS)
    assert contour.pwcv_observed.all()
    for along in (0.01, np.pi - 0.01, np.pi + 0.01, -0.01):
        assert contour.pwcv[sector_of(along)] == 0.0
    assert_allclose(contour.pwcv[sector_of(np.pi / 2)], 2.0, atol=0.02)
    assert_allclose(contour.pwcv[sector_of(np.radians(33.0))], 2.0 / np.sin(np.radians(33.0)), atol=0.05)


def test_open_and_unseen_are_told_apart() -> None:
    angles = ray_angles(SETTINGS)
    distance, at_wall = rays(np.full(len(angles), 50.0))
    ahead = np.abs(np.angle(np.exp(1j * angles))) < 0.5
    distance[ahead] = 6.0  # ends before the radius and not at a wall: nobody saw on
    contour = wall_contour(nothing(), distance, at_wall, SETTINGS)
    assert_array_equal(contour.pwcv, 0.0)
    assert not contour.pwcv_observed[sector_of(0.1)]
    assert contour.pwcv_observed[sector_of(np.pi)]
    assert not contour.cwc_observed[:, sector_of(0.1)].any()
    assert contour.cwc_observed[:, sector_of(np.pi)].all()


def room_surface(lean: float) -> Array:
    """Points of a round wall 4 m away at the floor that leans in by ``lean`` metres a metre."""
    rng = np.random.default_rng(1)
    angle, height = rng.uniform(0, 2 * np.pi, 40000), rng.uniform(0, 3, 40000)
    away = 4.0 - lean * height
    return np.column_stack([away * np.cos(angle), away * np.sin(angle), height])


@pytest.mark.parametrize("lean", [0.0, 0.2])
def test_the_cwc_follows_a_leaning_wall(lean: float) -> None:
    contour = wall_contour(room_surface(lean), *rays(np.full(len(ray_angles(SETTINGS)), 4.0)), SETTINGS)
    middle = SETTINGS.layer_from + (np.arange(SETTINGS.layers) + 0.5) * SETTINGS.layer_height
    assert contour.cwc_observed.all()
    assert_allclose(contour.cwc.mean(axis=1), 4.0 - lean * middle, atol=0.02)


def test_the_cwc_takes_no_surface_before_or_behind_the_wall() -> None:
    wall = room_surface(0.0)
    roof, behind = wall * [0.2, 0.2, 1.0], wall * [1.6, 1.6, 1.0]
    distance, at_wall = rays(np.full(len(ray_angles(SETTINGS)), 4.0))
    alone = wall_contour(wall, distance, at_wall, SETTINGS)
    among = wall_contour(np.vstack([roof, wall, behind]), distance, at_wall, SETTINGS)
    assert_allclose(among.cwc, alone.cwc)


def test_a_layer_without_points_was_not_seen() -> None:
    low = room_surface(0.0)
    low = low[low[:, 2] < 1.3]
    contour = wall_contour(low, *rays(np.full(len(ray_angles(SETTINGS)), 4.0)), SETTINGS)
    assert contour.cwc_observed[:2].all()
    assert not contour.cwc_observed[2:].any()
    assert_array_equal(contour.cwc[2:], 0.0)
