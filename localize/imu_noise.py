"""Noise of an inertial sensor at rest by its Allan variance (paper 002: re-calibration); the door of allantools."""

from __future__ import annotations

from dataclasses import dataclass

import allantools
import numpy as np
from scipy.optimize import nnls
from scipy.signal.windows import hann

from localize.denoise import slow_part
from semmap.geometry import Array

_SMOOTH_HZ = 2.0
"""Engine tones lie above this; the samples are smoothed to it before anything else."""
_LONGEST = 5.0
"""Averaging times go up to this part of the stretch."""
_FLICKER = 2.0 * np.log(2.0) / np.pi
_SEEN = 0.5
"""A term whose variance is known worse than this, relative, is not told from nothing."""


@dataclass(frozen=True, slots=True)
class Level:
    """A noise level: ``value``, its standard deviation ``std``, and what it is at the most, ``bound`` (2σ)."""

    value: float
    std: float
    bound: float

    @property
    def seen(self) -> bool:
        """Whether it can be told from nothing."""
        return self.value > 0.0 and 2.0 * self.std < _SEEN * self.value


@dataclass(frozen=True, slots=True, eq=False)
class SensorNoise:
    """Noise of one three-axis sensor, root mean square over the axes.

    white : density [unit/√Hz]. walk : of the bias [unit/s/√Hz]. instability : of the bias [unit].
    tau_s, deviation : (k,) the Allan deviation it was fitted to.
    """

    white: Level
    walk: Level
    instability: Level
    tau_s: Array
    deviation: Array


def sensor_noise(samples: Array, rate_hz: float) -> SensorNoise:
    """Noise of a sensor at rest, samples (n, 3) evenly spaced at ``rate_hz``; vibration above 2 Hz does no harm.

    Fits ``Q/τ² + N²/τ + 0.44 B² + K² τ/3`` to the Allan variance, all terms at least zero; Q takes up what is left of
    tones. The smoothing against them changes what white noise looks like at short τ, and the fit knows how.
    """
    smooth = slow_part(samples, rate_hz, _SMOOTH_HZ)
    stride = max(1, int(rate_hz / (4.0 * _SMOOTH_HZ)))
    coarse_hz = rate_hz / stride
    duration_s = len(samples) / rate_hz
    count = int(np.log2(duration_s / _LONGEST * _SMOOTH_HZ))
    wanted = np.unique(np.round(coarse_hz / _SMOOTH_HZ * 2.0 ** np.arange(count + 1))) / coarse_hz
    axes = [allantools.oadev(axis, rate=coarse_hz, data_type="freq", taus=wanted) for axis in smooth[::stride].T]
    tau = np.asarray(axes[0][0], dtype=np.float64)
    variance = np.mean([np.square(axis[1]) for axis in axes], axis=0)
    relative = np.sqrt(2.0 / (3.0 * np.maximum(duration_s / tau - 1.0, 0.5)))
    terms = np.column_stack([tau**-2.0, _white_response(tau, rate_hz), np.full(len(tau), _FLICKER), tau / 3.0])
    squares, stds = _fit(terms, variance, relative)
    if squares[2] < 2.0 * stds[2]:
        # what is none or chance would take from white noise and walk, between which it lies
        squares[[0, 1, 3]], stds[[0, 1, 3]] = _fit(terms[:, [0, 1, 3]], variance, relative)
        squares[2] = 0.0
    white, instability, walk = (_level(squares[k], stds[k]) for k in (1, 2, 3))
    return SensorNoise(white, walk, instability, tau, np.sqrt(variance))


def _white_response(tau: Array, rate_hz: float) -> Array:
    """Allan variance of smoothed white noise of density 1: 1/τ, and less where the smoothing reaches."""
    half = round(0.5 * rate_hz / _SMOOTH_HZ)
    window = hann(2 * half + 1)
    window /= window.sum()
    out = 1.0 / tau
    for k in np.flatnonzero(tau < 20.0 / _SMOOTH_HZ):
        m = round(tau[k] * rate_hz)
        difference = np.concatenate([np.full(m, 1.0 / m), np.full(m, -1.0 / m)])
        out[k] = 0.5 * rate_hz * np.sum(np.convolve(window, difference) ** 2)
    return np.asarray(out)


def _fit(terms: Array, variance: Array, relative: Array) -> tuple[Array, Array]:
    """Coefficients (c,) of the terms (k, c), none negative, and their standard deviations."""
    weighted = terms / (relative * variance)[:, None]
    scale = np.linalg.norm(weighted, axis=0)
    found, _ = nnls(weighted / scale, 1.0 / relative)
    # terms at zero count as known to be nowhere: their own std is that of the term alone
    free = found > 0.0
    stds = np.ones(len(scale))
    stds[free] = np.sqrt(np.diag(np.linalg.inv((weighted / scale)[:, free].T @ (weighted / scale)[:, free])))
    return found / scale, stds / scale


def _level(square: float, std: float) -> Level:
    value = float(np.sqrt(square))
    return Level(value, 0.5 * std / value if value > 0.0 else np.inf, float(np.sqrt(square + 2.0 * std)))
