"""Dust in the air: beams that come back from it, and rock that they no longer reach.

After Bouguer: of a beam ``exp(-2 α r)`` is left there and back, ``α = c s`` with the concentration c and the mass
extinction s of coal dust of some micrometres. A beam that meets enough dust near the sensor, where a grain returns
most, gives that range instead of the rock's. How often is our own figure: at 200 mg/m³, which is what paper 002 fills
its roadway with, 29 beams of 30 end in the dust, and the LiDAR is as good as blind.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_EXTINCTION = 1.5e-4
"""Mass extinction [m²/mg]."""
_BLINDING = 60.0
"""Concentration at which 63 % of the beams end in the dust [mg/m³]."""
_REACH_M = 1.2
"""Mean way of a beam into dust that blinds; in thinner dust it is longer, up to `_FARTHEST` [m]."""
_FARTHEST = 3.0
_PLUMES = 7
"""Neighbouring beams see the same plume: so many columns share one thickness."""


def dusty(
    ranges: NDArray[np.float32], kept: NDArray[np.bool_], concentration: float, columns: int, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Ranges (n,) and which come back (n,), in dust of a concentration [mg/m³]; beams in order, column by column."""
    if concentration <= 0.0:
        return ranges, kept
    beams = len(ranges) // columns
    plume = np.repeat(rng.gamma(4.0, 0.25, size=columns // _PLUMES + 1), _PLUMES)[:columns]
    thick = concentration * np.repeat(plume, beams)
    blinded = rng.random(len(ranges)) < 1.0 - np.exp(-thick / _BLINDING)
    into = 0.6 + rng.exponential(np.minimum(_REACH_M * 200.0 / thick, _FARTHEST))
    rock_first = kept & (into > ranges)
    lost = rng.random(len(ranges)) > np.exp(-2.0 * _EXTINCTION * concentration * ranges)
    from_dust = blinded & ~rock_first
    return np.where(from_dust, into, ranges).astype(np.float32), from_dust | (kept & ~blinded & ~lost)
