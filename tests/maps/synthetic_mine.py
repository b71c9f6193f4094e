"""Mines that are known exactly: straight roadways with vertical walls, as dense clouds and as LiDAR views."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from skimage.measure import find_contours

from maps.views import View
from semmap.geometry import Array


@dataclass(frozen=True)
class SyntheticMine:
    """Roadways (x0, y0, x1, y1, width) in plan, on a floor ``z = slope · (x, y)``, 3 m high, turned by ``yaw``."""

    roadways: tuple[tuple[float, float, float, float, float], ...]
    slope: tuple[float, float] = (0.0, 0.0)
    yaw: float = 0.0
    roof: float = 3.0

    def turned(self, yaw: float) -> SyntheticMine:
        return replace(self, yaw=yaw)

    @property
    def R(self) -> Array:
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[c, -s], [s, c]])

    def to_map(self, xy: Array) -> Array:
        """Plan points (n, 2) as points (n, 3) on the floor."""
        xy = np.atleast_2d(np.asarray(xy, dtype=np.float64))
        return np.column_stack([xy @ self.R.T, xy @ np.array(self.slope)])

    def inside(self, xy: Array) -> Array:
        """How far (n,) plan points lie inside the roadways [m]; negative in the rock. Ends are square."""
        depth = np.full(len(xy), -np.inf)
        for x0, y0, x1, y1, width in self.roadways:
            start, along = np.array([x0, y0]), np.array([x1 - x0, y1 - y0])
            length = float(np.hypot(*along))
            along = along / length
            s = (xy - start) @ along
            across = np.abs((xy - start) @ np.array([-along[1], along[0]]))
            depth = np.maximum(depth, np.minimum.reduce([0.5 * width - across, s, length - s]))
        return depth

    def cloud(self, spacing: float = 0.1, *, seed: int = 0, noise: float = 0.005, roofed: bool = True) -> Array:
        """Points (n, 3) on floor, walls and roof, map frame."""
        rng = np.random.default_rng(seed)
        corners = np.array(self.roadways)[:, :4].reshape(-1, 2)
        low, high = corners.min(axis=0) - 6.0, corners.max(axis=0) + 6.0
        xy = rng.uniform(low, high, (int(np.prod(high - low) / spacing**2), 2))
        xy = xy[self.inside(xy) > 0.0]
        parts = [np.column_stack([xy, np.zeros(len(xy))])]
        if roofed:
            parts.append(np.column_stack([xy, np.full(len(xy), self.roof)]))
        outline = self._outline(low, high, spacing)
        levels = np.arange(0.0, self.roof, spacing)
        wall = np.repeat(outline, len(levels), axis=0)
        parts.append(np.column_stack([wall, np.tile(levels, len(outline))]))
        local = np.concatenate(parts)
        local += noise * rng.normal(size=local.shape)
        return self.to_map(local[:, :2]) + np.array([0.0, 0.0, 1.0]) * local[:, 2:]

    def _outline(self, low: Array, high: Array, spacing: float) -> Array:
        axes = [np.arange(low[k], high[k], spacing) for k in (0, 1)]
        mesh = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        depth = self.inside(mesh.reshape(-1, 2)).reshape(mesh.shape[:2])
        return low + spacing * np.concatenate(find_contours(depth, 0.0))

    def view(self, xy: tuple[float, float], *, height: float = 1.3, columns: int = 450, seed: int = 0) -> View:
        """What a 16-beam LiDAR at a plan point, ``height`` above the floor, sees; the gravity-aligned map frame."""
        rng = np.random.default_rng([seed, 1])
        azimuth = 2.0 * np.pi * (np.arange(columns) + 0.5) / columns
        walls = self._distance_to_wall(np.array(xy, dtype=np.float64), azimuth)
        tangent = np.tan(np.radians(np.linspace(-15.0, 15.0, 16)))[:, None]
        direction = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
        climb = direction @ np.array(self.slope)
        sink = tangent - climb  # of a beam above the floor, for each metre it goes
        with np.errstate(divide="ignore"):
            to_floor = np.where(sink < 0.0, -height / sink, np.inf)
            to_roof = np.where(sink > 0.0, (self.roof - height) / sink, np.inf)
        reach = np.minimum(np.minimum(walls, to_floor), to_roof)
        reach += 0.01 * rng.normal(size=reach.shape)
        hit = (reach > 0.6) & (reach < 60.0) & (rng.random(reach.shape) > 0.02)
        plan = np.asarray(xy) + reach[..., None] * direction
        points = np.concatenate([plan @ self.R.T, (self._sensor_z(xy, height) + reach * tangent)[..., None]], axis=-1)
        sensor = np.append(self.to_map(np.array(xy))[0, :2], self._sensor_z(xy, height))
        return View(points[hit], sensor)

    def _sensor_z(self, xy: tuple[float, float], height: float) -> float:
        return float(np.array(xy) @ np.array(self.slope)) + height

    def _distance_to_wall(self, xy: Array, azimuth: Array) -> Array:
        direction = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
        distance = np.zeros(len(azimuth))
        for _ in range(400):
            step = self.inside(xy + distance[:, None] * direction)
            distance += np.maximum(0.95 * step, 0.0)
        return distance


def straight(width: float = 4.0) -> SyntheticMine:
    """One roadway along x, 40 m."""
    return SyntheticMine(((-20.0, 0.0, 20.0, 0.0, width),))


def t_junction(width: float = 4.0, side_width: float | None = None) -> SyntheticMine:
    """A roadway along x, 60 m, and one that leaves it at (0, 0) along -y."""
    return SyntheticMine(((-30.0, 0.0, 30.0, 0.0, width), (0.0, 0.0, 0.0, -30.0, side_width or width)))


def x_junction(width: float = 4.0) -> SyntheticMine:
    """Two roadways of 60 m that cross at (0, 0) at a right angle."""
    return SyntheticMine(((-30.0, 0.0, 30.0, 0.0, width), (0.0, -30.0, 0.0, 30.0, width)))


def y_junction(width: float = 4.0) -> SyntheticMine:
    """Three roadways of 30 m that meet at (0, 0) at 120 degrees."""
    ends = [(30.0 * np.cos(a), 30.0 * np.sin(a)) for a in np.radians([90.0, 210.0, 330.0])]
    return SyntheticMine(tuple((0.0, 0.0, x, y, width) for x, y in ends))


def corner(width: float = 4.0, turn_deg: float = 90.0) -> SyntheticMine:
    """A roadway along x that turns at (0, 0)."""
    half, a = 0.5 * width, np.radians(180.0 - turn_deg)
    away = (30.0 * np.cos(a), 30.0 * np.sin(a))
    back = (-half * np.cos(a), -half * np.sin(a))
    return SyntheticMine(((30.0, 0.0, -half, 0.0, width), (*back, *away, width)))
