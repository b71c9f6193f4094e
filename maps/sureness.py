"""How clear-cut a decision is: whether another survey, or a robot's view, might take it the other way."""

from __future__ import annotations

import math

CLOSE_CALL = 1.5
"""A figure less than this many times beyond its limit, or short of it, might be called the other way."""


def clear_cut(ratio: float) -> float:
    """How clear-cut it is that a figure is ``ratio`` times its limit: 0 just at it, 1 from `CLOSE_CALL` either way."""
    if ratio <= 0.0:
        return 1.0
    return min(abs(math.log(ratio)) / math.log(CLOSE_CALL), 1.0)
