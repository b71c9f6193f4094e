"""Settings of the wall contours."""

from __future__ import annotations

from pydantic import Field, FiniteFloat, PositiveFloat

from semmap.settings import Settings


class ContourSettings(Settings):
    """Shape of PWCV and CWC.

    radius : walls farther than this from the invariant point do not count [m].
    sectors : number of sectors of a full turn.
    layer_from, layer_height, layers : the CWC's height layers above the floor [m].
    tolerance : standard deviation σ of the difference of two wall distances that still agree [m].
    wall_depth : a layer's wall is at most this much nearer or farther than the PWCV's [m].
    """

    radius: PositiveFloat = 12.0
    sectors: int = Field(default=120, ge=8)
    layer_from: FiniteFloat = 0.3
    layer_height: PositiveFloat = 0.5
    layers: int = Field(default=5, ge=1)
    tolerance: PositiveFloat = 0.6
    wall_depth: PositiveFloat = 1.0
