"""Random crossings as wall contours, straight from their plan: a mining district of them without a point cloud."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from descriptors.settings import ContourSettings
from descriptors.wall_contour import RAYS_PER_SECTOR, ray_angles
from semmap.geometry import Array
from semmap.intersections import WallContour

_KINDS_DEG = ((0, 90, 180), (0, 120, 240), (0, 50, 180), (0, 90, 180, 270), (0, 90), (0, 72, 144, 216, 288))
_SHARES = (0.45, 0.15, 0.08, 0.2, 0.08, 0.04)
"""Directions in which roadways leave, and how many crossings are like that: T, Y, a sharp fork, X, L, five ways."""
_FARTHEST = 60.0
"""Walls are at most this far [m]."""
_AT_ONCE = 4000


def random_crossings(n: int, settings: ContourSettings, rng: np.random.Generator) -> Array:
    """Wall distance (n, rays) [m] along `ray_angles` from the middle of crossings, no two alike."""
    return np.concatenate([_crossings(min(_AT_ONCE, n - k), settings, rng) for k in range(0, n, _AT_ONCE)])


def _crossings(n: int, settings: ContourSettings, rng: np.random.Generator) -> Array:
    """Roadways of random width, direction, bend and offset that leave a place, corners cut more or less round."""
    angles = ray_angles(settings)
    kind = rng.choice(len(_KINDS_DEG), size=n, p=_SHARES)
    width, heading, roundness = rng.uniform(3.0, 6.5, n), rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(5.0, 16.0, n)
    total = np.zeros((n, len(angles)))
    for branch in range(max(map(len, _KINDS_DEG))):
        there = [branch < len(directions) for directions in _KINDS_DEG]
        planned = [np.radians(directions[branch % len(directions)]) for directions in _KINDS_DEG]
        bearing = heading + np.array(planned)[kind] + rng.normal(0.0, 0.2, n)
        half = 0.5 * width * rng.uniform(0.8, 1.2, n)
        away = _roadway(angles - bearing[:, None], half[:, None], rng)
        total += np.where(np.array(there)[kind][:, None], (away / 10.0) ** roundness[:, None], 0.0)
    return 10.0 * total ** (1.0 / roundness[:, None]) + rock(n, len(angles), rng, 0.25)


def _roadway(angle: Array, half: Array, rng: np.random.Generator) -> Array:
    """Distance (n, rays) to the walls of one roadway each that leaves along angle 0, bent a little."""
    n = len(angle)
    offset, bend = rng.normal(0.0, 0.25, (n, 1)), rng.normal(0.0, 0.012, (n, 1))
    away = np.full(angle.shape, 3.0)
    for _ in range(3):
        off = angle - bend * away
        side = np.sin(off)
        wall = half + np.sign(side) * offset
        away = np.where(np.cos(off) > 0.0, np.minimum(wall / np.maximum(np.abs(side), 1e-6), _FARTHEST), half)
    return away


def rock(n: int, rays: int, rng: np.random.Generator, roughest: float) -> Array:
    """How far rock (n, rays) stands back from a smooth wall [m], standard deviations from 0.02 to ``roughest``."""
    wave = np.arange(rays // 2 + 1)
    height = np.where((wave > 0) & (wave < rays // 6), 1.0 / np.maximum(wave, 6), 0.0)
    rough = np.fft.irfft(height * (rng.normal(size=(n, len(wave))) + 1j * rng.normal(size=(n, len(wave)))), rays)
    return np.asarray(rough / rough.std(axis=1, keepdims=True) * rng.uniform(0.02, roughest, (n, 1)))


def looked_at_from(walls: Array, p: Array, turn: Array, settings: ContourSettings) -> Array:
    """The walls (n, rays) as they are seen from p (n, 2) [m] by somebody turned clockwise [rad]."""
    angles = ray_angles(settings)
    x, y = walls * np.cos(angles) - p[:, :1], walls * np.sin(angles) - p[:, 1:]
    angle, away = np.arctan2(y, x) + turn[:, None], np.hypot(x, y)
    return np.array([np.interp(angles, *one, period=2.0 * np.pi) for one in zip(angle, away, strict=True)])


def partly_seen(n: int, sectors: int, share: Array, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Masks (n, sectors) in which the ``share`` (n,) of the sectors is hidden, in up to three arcs."""
    hidden = np.round(share[:, None] * sectors * rng.dirichlet([1.0, 1.0, 1.0], n)).astype(np.int64)
    after = (np.arange(sectors) - rng.integers(sectors, size=(n, 3, 1))) % sectors
    return np.asarray((after >= hidden[:, :, None]).all(axis=1))


def contours_of(walls: Array, seen: NDArray[np.bool_], settings: ContourSettings) -> WallContour:
    """Stacked contours of walls (n, rays) of which the sectors ``seen`` (n, sectors) were; the same in every layer."""
    near = (walls < settings.radius).reshape(*seen.shape, RAYS_PER_SECTOR)
    count = near.sum(axis=-1)
    mean = np.where(near, walls.reshape(near.shape), 0.0).sum(axis=-1) / np.maximum(count, 1)
    pwcv = np.where(seen & (2 * count > RAYS_PER_SECTOR), mean, 0.0).astype(np.float32)
    layered = (len(pwcv), settings.layers, settings.sectors)
    return WallContour(pwcv, seen, np.broadcast_to(pwcv[:, None], layered), np.broadcast_to(seen[:, None], layered))
