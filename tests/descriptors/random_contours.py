"""Contours for tests: likely ones, unlikely ones, and all of them turned."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from descriptors.settings import ContourSettings
from semmap.geometry import Array
from semmap.intersections import WallContour
from tools.bench.crossings import contours_of, partly_seen, random_crossings


def crossings(n: int, settings: ContourSettings, seed: int, *, hidden: float = 0.0) -> WallContour:
    """Stacked contours of random crossings, each with up to the share ``hidden`` of its sectors not observed."""
    rng = np.random.default_rng(seed)
    seen = partly_seen(n, settings.sectors, rng.uniform(0.0, hidden, n), rng)
    return contours_of(random_crossings(n, settings, rng), seen, settings)


def oddities(n: int, settings: ContourSettings, seed: int) -> WallContour:
    """Stacked contours no mine has: noise, walls at the edges of bins, beyond the radius, next to nothing seen."""
    rng = np.random.default_rng(seed)
    shape = (n, settings.sectors)
    noise = rng.uniform(0.0, 1.3, shape)
    steps = rng.integers(0, 255, shape) / 254.0
    round_rooms = np.broadcast_to(rng.uniform(0.0, 1.1, (n, 1)), shape)
    walls = np.choose(rng.integers(3, size=(n, 1)), [noise, steps, round_rooms])
    walls = walls * (rng.uniform(size=shape) < rng.uniform(size=(n, 1)))
    seen = rng.uniform(size=shape) < rng.choice([0.0, 1.0 / settings.sectors, 0.3, 0.9, 1.0], (n, 1))
    return stacked(walls * settings.radius, seen, settings)


def stacked(walls: Array, seen: NDArray[np.bool_], settings: ContourSettings) -> WallContour:
    """Contours (n) of wall distances (n, sectors), the same in every layer."""
    pwcv = walls.astype(np.float32)
    return WallContour(
        pwcv, seen, np.repeat(pwcv[:, None], settings.layers, axis=1), np.repeat(seen[:, None], settings.layers, axis=1)
    )


def rolled(one: WallContour, sectors: int) -> WallContour:
    """What the same place shows to somebody turned: sector s of the old is sector s + sectors of the new."""
    return WallContour(
        *(np.roll(a, sectors, axis=-1) for a in (one.pwcv, one.pwcv_observed, one.cwc, one.cwc_observed))
    )


def joined(*parts: WallContour) -> WallContour:
    """Stacked contours, one stack after the other."""
    return WallContour(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("pwcv", "pwcv_observed", "cwc", "cwc_observed")
        )
    )
