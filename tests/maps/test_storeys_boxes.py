"""Floors do not climb: what stands on them is no way up to the walls and the roof."""

from __future__ import annotations

import numpy as np
import pytest

from maps.columns import columns_of
from maps.settings import FreeSpaceSettings
from maps.storeys import storeys_of


def sheet(low: tuple[float, float, float], high: tuple[float, float, float], rng: np.random.Generator) -> np.ndarray:
    """Points on a rectangle along the axes, one for each square decimetre."""
    size = np.subtract(high, low)
    count = round(np.prod(size[size > 0.0]) / 0.01)
    return np.asarray(low) + size * rng.uniform(size=(count, 3))


def box(
    low: tuple[float, float, float], high: tuple[float, float, float], rng: np.random.Generator
) -> list[np.ndarray]:
    """The sides and the top of a box."""
    (a, b, c), (d, e, f) = low, high
    sides = (((a, b, c), (d, b, f)), ((a, e, c), (d, e, f)), ((a, b, c), (a, e, f)), ((d, b, c), (d, e, f)))
    return [sheet(p, q, rng) for p, q in (*sides, ((a, b, f), (d, e, f)))]


@pytest.mark.parametrize("height", [0.7, 0.9, 1.3])
@pytest.mark.parametrize("seed", range(3))
def test_the_top_of_a_box_is_no_floor_that_one_could_walk_up_to(height: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    room = [sheet((0, 0, 0), (14, 6, 0), rng), *box((0, 0, 0), (14, 6, 3), rng)]
    on_floor = (room[0][:, 0] < 6.1) | (room[0][:, 0] > 8.5) | (room[0][:, 1] < 3.1) | (room[0][:, 1] > 5.1)
    cloud = np.concatenate([room[0][on_floor], *room[1:], *box((6.1, 3.1, 0), (8.5, 5.1, height), rng)])
    cloud += 0.01 * rng.normal(size=cloud.shape)
    settings = FreeSpaceSettings()
    columns = columns_of(cloud.astype(np.float32), settings).coarser(2)
    storeys = storeys_of(columns, settings)
    assert len(storeys.ij) > 0.7 * 14 * 6 / columns.cell**2
    assert storeys.height.max() < 0.3
