"""A uniform quintic B-spline: four continuous derivatives, exact at any argument."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.interpolate import BSpline

from semmap.geometry import Array

_DEGREE = 5
_PAD = 3


class UniformSpline:
    """Quintic B-spline whose control values sit at ``0, step, 2 step, ...``.

    The control values are approached, not interpolated: the curve is a weighted mean of the six nearest, so
    it never overshoots, and monotone control values make a monotone curve.

    Parameters
    ----------
    controls : (n,) or (n, d) control values.
    step : distance of their arguments.
    ends : what lies beyond them: ``rest`` repeats the end values (the derivatives vanish there), ``straight``
        reflects them through the end point, which the curve then meets.
    """

    def __init__(self, controls: Array, step: float, *, ends: Literal["rest", "straight"]) -> None:
        padded = _padded(np.asarray(controls, dtype=np.float64), ends)
        knots = (np.arange(len(padded) + _DEGREE + 1) - _PAD - (_DEGREE + 1) / 2) * step
        self.end = (len(controls) - 1) * step
        spline = BSpline(knots, padded, _DEGREE)
        self._derivatives = tuple(spline.derivative(order) if order else spline for order in range(4))

    def __call__(self, x: Array, order: int = 0) -> Array:
        """Value or derivative (order 0 to 3) at ``x`` (m,), clamped to ``[0, end]``; (m,) or (m, d)."""
        return np.asarray(self._derivatives[order](np.clip(x, 0.0, self.end)))


def _padded(controls: Array, ends: Literal["rest", "straight"]) -> Array:
    """Controls with three more values at each end."""
    width = [(_PAD, _PAD)] + [(0, 0)] * (controls.ndim - 1)
    if ends == "rest":
        return np.pad(controls, width, mode="edge")
    if len(controls) > _PAD:
        return np.pad(controls, width, mode="reflect", reflect_type="odd")
    first, last = controls[1] - controls[0], controls[-1] - controls[-2]
    steps = np.arange(1, _PAD + 1).reshape(-1, *[1] * (controls.ndim - 1))
    return np.concatenate([controls[0] - steps[::-1] * first, controls, controls[-1] + steps * last])
