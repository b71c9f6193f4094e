"""Engine vibration out of an IMU's signals by interval thresholds on empirical modes (paper 002 Eq. 1 to 7).

The only file that knows the EMD library, which does the sifting. Which modes go, and by how much, is decided here:

* Modes are counted from the fastest. Those below the boundary M (Eq. 3) go whole, those from M on lose what does not
  rise above their own noise (Eq. 5 to 7): a vibration that goes on all the time stays below, a jolt rises above it.
* Modes slower than motion stay, with the trend; only what is fast in their sum meets the same threshold. Tones that
  beat leave a little of themselves there; the corners of a turn rise above it.
* Envelopes of a tone with harmonics are not symmetric, and modes then have a mean, which is worse than the tone:
  1 mrad/s of 10. What is slow in the removed part is therefore put back: the output is as slow motion as the input.
* A body that shakes about two axes out of phase turns on the whole although its mean rate says otherwise (coning, and
  sculling for the specific force). What the removed tones did that way is added to what stays, see `rectification`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PyEMD import EMD
from scipy.signal import fftconvolve
from scipy.signal.windows import hann

from localize.settings import DenoiseSettings
from semmap.geometry import Array

_GAP_PERIODS = 3.0
"""A hole longer than this many periods ends a stretch: nothing is sifted across it."""


@dataclass(frozen=True, slots=True, eq=False)
class Enhanced:
    """Rates (n, 3) [rad/s] and specific force (n, 3) [m/s²] in the imu frame, without the vibration."""

    gyro: Array
    accel: Array


def modes_of(signal: Array, *, sifts: int, count: int) -> Array:
    """Intrinsic mode functions of a signal (n,), fastest first, the rest as the last row (paper 002 Eq. 1).

    Returns (k, n) with k at most ``count`` + 1; the rows sum up to the signal.
    """
    scale = float(np.std(signal))
    if scale == 0.0 or not np.isfinite(1.0 / scale):
        return signal[None].copy()
    # the library's end conditions are absolute: without the scale a gyroscope in rad/s is all trend
    emd = EMD(FIXE=sifts)
    emd.emd((signal - signal.mean()) / scale, max_imf=count)
    modes, _ = emd.get_imfs_and_residue()
    return np.vstack([scale * modes, signal - scale * modes.sum(axis=0)])


def boundary(modes: Array) -> int:
    """Row M of ``modes`` (k, n) at which the paper's reconstruction begins: the consecutive mean square error rule.

    Paper 002 Eq. 2, 3: two consecutive reconstructions differ by one mode, so the mean square error between them is
    that mode's power. 0 where there are no modes.
    """
    return int(np.argmin(np.mean(modes**2, axis=1))) if len(modes) else 0


def noise_threshold(mode: Array) -> float:
    """Universal threshold T of a mode (n,) (paper 002 Eq. 6, 7; N is the number of its samples)."""
    sigma = float(np.median(np.abs(mode))) / 0.6745
    return sigma * float(np.sqrt(2.0 * np.log(len(mode))))


def soft_threshold(mode: Array, threshold: float) -> Array:
    """A mode (n,) with each stretch between zero crossings shrunk by its own extremum (paper 002 Eq. 5)."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(np.signbit(mode))) + 1])
    extrema = np.maximum.reduceat(np.abs(mode), starts)
    kept = np.where(extrema > threshold, 1.0 - threshold / np.maximum(extrema, threshold + 1e-300), 0.0)
    return np.asarray(mode * np.repeat(kept, np.diff(np.append(starts, len(mode)))))


def slow_part(values: Array, rate_hz: float, motion_hz: float) -> Array:
    """``values`` (n, c) averaged over a Hann window of 1 / ``motion_hz``; the ends are mirrored.

    Passes motion slower than ``motion_hz``, and half of it there; of a tone of f it leaves (motion_hz / f)³ / 3, about.
    """
    half = min(round(0.5 * rate_hz / motion_hz), len(values) - 1)
    window = hann(2 * half + 1)[:, None]
    mirrored = (values[half:0:-1], values, values[-2 : -half - 2 : -1])
    return np.asarray(fftconvolve(np.concatenate(mirrored), window / window.sum(), mode="valid", axes=0))


def vibration(signal: Array, rate_hz: float, settings: DenoiseSettings) -> Array:
    """What of one window (n,) is vibration by the paper's rules (Eq. 1 to 7); the rest is motion."""
    # siftings halve the frequency, about, with every mode
    count = max(1, int(np.ceil(np.log2(0.5 * rate_hz / settings.motion_hz))))
    modes = modes_of(signal, sifts=settings.sifts, count=count)
    crossings = np.count_nonzero(np.diff(np.signbit(modes), axis=1), axis=1)
    is_fast = 0.5 * crossings * rate_hz / len(signal) > settings.motion_hz
    fast, slow = modes[is_fast], modes[~is_fast].sum(axis=0)
    M = boundary(fast)
    corners = slow - slow_part(slow[:, None], rate_hz, settings.motion_hz)[:, 0]
    kept = sum((soft_threshold(mode, noise_threshold(mode)) for mode in (*fast[M:], corners)), slow - corners)
    return np.asarray(signal - kept)


def enhance_window(gyro: Array, accel: Array, rate_hz: float, settings: DenoiseSettings) -> Enhanced:
    """One window of evenly spaced samples, gyro (n, 3), accel (n, 3)."""
    signals = np.hstack([gyro, accel])
    removed = np.column_stack([vibration(signal, rate_hz, settings) for signal in signals.T])
    return _without(gyro, accel, removed, rate_hz, settings)


def enhance(stamps_ns: NDArray[np.int64], gyro: Array, accel: Array, settings: DenoiseSettings) -> Enhanced:
    """A whole recording, stamps (n,) increasing, gyro (n, 3), accel (n, 3): paper 002 Eq. 1 to 7, offline.

    Within ``settings.margin_s`` of the ends of a stretch, and of holes in the stamps, part of the vibration stays.
    """
    out = Enhanced(gyro.copy(), accel.copy())
    period_ns = float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 1.0
    ends = np.flatnonzero(np.diff(stamps_ns) > _GAP_PERIODS * period_ns) + 1
    for piece in np.split(np.arange(len(stamps_ns)), ends):
        rate_hz = 1e9 / period_ns
        if len(piece) <= 2.0 * settings.margin_s * rate_hz:
            continue
        part = slice(piece[0], piece[-1] + 1)
        removed = _in_windows(np.hstack([gyro[part], accel[part]]), rate_hz, settings)
        enhanced = _without(gyro[part], accel[part], removed, rate_hz, settings)
        out.gyro[part], out.accel[part] = enhanced.gyro, enhanced.accel
    return out


def rectification(removed: Array, rate_hz: float, motion_hz: float) -> Array:
    """What removed vibration (n, 6), rates and specific force without a slow part, adds to the slow motion, (n, 6).

    With the attitude ``R Exp(θ)``, θ the integral of the removed rate ω and small: the mean rate of the slow attitude R
    is that of the gyroscope plus the mean of ``½ θ x ω``, and its mean specific force the accelerometer's plus that of
    ``θ x f``. These are the coning and sculling terms of paper 002 Eq. 8 and 11, over periods instead of samples.
    """
    rate, force = removed[:, :3], removed[:, 3:]
    theta = np.vstack([np.zeros(3), np.cumsum(0.5 * (rate[1:] + rate[:-1]), axis=0)]) / rate_hz
    theta -= slow_part(theta, rate_hz, motion_hz)
    products = np.hstack([0.5 * np.cross(theta, rate), np.cross(theta, force)])
    return slow_part(products, rate_hz, motion_hz)


def _in_windows(signals: Array, rate_hz: float, settings: DenoiseSettings) -> Array:
    """The vibration (n, c) of signals (n, c), window by window, faded into one another."""
    n = len(signals)
    size = min(n, max(2, round(settings.window_s * rate_hz)))
    starts = np.unique(np.append(np.arange(0, n - size + 1, max(1, size // 2)), n - size))
    fade = hann(size + 2)[1:-1, None]
    removed, weights = np.zeros_like(signals), np.zeros((n, 1))
    for start in starts:
        part = slice(start, start + size)
        window = np.column_stack([vibration(signal, rate_hz, settings) for signal in signals[part].T])
        removed[part] += fade * window
        weights[part] += fade
    return np.asarray(removed / weights)


def _without(gyro: Array, accel: Array, removed: Array, rate_hz: float, settings: DenoiseSettings) -> Enhanced:
    """The signals less the fast part of what is to be removed, plus its rectification."""
    fast = removed - slow_part(removed, rate_hz, settings.motion_hz)
    added = rectification(fast, rate_hz, settings.motion_hz)
    return Enhanced(gyro - fast[:, :3] + added[:, :3], accel - fast[:, 3:] + added[:, 3:])
