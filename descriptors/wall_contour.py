"""Wall contours: the polar wall contour vector (PWCV) and the cylinder wall contour (CWC) of one place.

Both are what a horizontal look round from the invariant point shows: the first wall in each direction, once for the
whole height of a robot and once for each height layer. A dense map and a few stacked scans show the same first walls,
so their contours compare.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from descriptors.settings import ContourSettings
from semmap.geometry import Array
from semmap.intersections import WallContour

RAYS_PER_SECTOR = 3


def ray_angles(settings: ContourSettings) -> Array:
    """Directions (sectors * RAYS_PER_SECTOR,) [rad] to look in, sector by sector."""
    rays = settings.sectors * RAYS_PER_SECTOR
    return np.asarray(2.0 * np.pi * (np.arange(rays) + 0.5) / rays)


def wall_contour(surface: Array, distance: Array, at_wall: NDArray[np.bool_], settings: ContourSettings) -> WallContour:
    """PWCV and CWC of a place.

    surface : (n, 3) points around the place: x, y relative to it, and height above the floor [m].
    distance : (rays,) along `ray_angles` to where free space ends [m], at most the radius.
    at_wall : (rays,) bool, the ray ends at a wall. One that ends before the radius but not at a wall ends unseen.
    """
    pwcv, observed = _pwcv(distance, at_wall, settings)
    cwc, cwc_observed = _cwc(surface, pwcv, observed, settings)
    return WallContour(pwcv, observed, cwc, cwc_observed)


def _pwcv(
    distance: Array, at_wall: NDArray[np.bool_], settings: ContourSettings
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Mean wall distance of the rays of each sector, 0 where most are open or unseen; observed where most rays tell."""
    wall = at_wall.reshape(settings.sectors, RAYS_PER_SECTOR)
    opened = (~at_wall & (distance >= settings.radius)).reshape(wall.shape)
    walls, opens = wall.sum(axis=1), opened.sum(axis=1)
    total = np.where(wall, distance.reshape(wall.shape), 0.0).sum(axis=1)
    observed = 2 * (walls + opens) > RAYS_PER_SECTOR
    is_wall = observed & (walls >= opens)
    pwcv = np.where(is_wall, total / np.maximum(walls, 1), 0.0).astype(np.float32)
    return pwcv, observed


def _cwc(
    surface: Array, pwcv: NDArray[np.float32], observed: NDArray[np.bool_], settings: ContourSettings
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Mean distance of the surface in each layer and sector, of the wall the PWCV shows and nothing before or behind.

    Where the PWCV is open the layers are, too; where it has a wall but a layer shows none, that layer was not seen.
    """
    away = np.hypot(surface[:, 0], surface[:, 1])
    turn = np.arctan2(surface[:, 1], surface[:, 0]) / (2.0 * np.pi)
    sector = np.floor(turn * settings.sectors).astype(np.int64) % settings.sectors
    layer = np.floor((surface[:, 2] - settings.layer_from) / settings.layer_height).astype(np.int64)
    wall = pwcv[sector]
    of_wall = (wall > 0.0) & (np.abs(away - wall) < settings.wall_depth) & (layer >= 0) & (layer < settings.layers)
    cell = layer[of_wall] * settings.sectors + sector[of_wall]
    size, shape = settings.layers * settings.sectors, (settings.layers, settings.sectors)
    count = np.bincount(cell, minlength=size).reshape(shape)
    total = np.bincount(cell, away[of_wall], minlength=size).reshape(shape)
    cwc = np.where(count > 0, total / np.maximum(count, 1), 0.0).astype(np.float32)
    opened = observed & (pwcv == 0.0)
    return cwc, (count > 0) | opened
