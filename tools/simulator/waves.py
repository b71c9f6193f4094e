"""Band-limited noise with known statistics: a sum of plane waves in random directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semmap.geometry import Array

_REDNESS = 0.8
"""Amplitudes grow as wavelength to this power: rock has large humps and small grains, with bounded slopes."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneWaves:
    """``Σ amplitude cos(k·x + phase)``, unit RMS.

    wave_vectors : (n, d) [rad/m]; amplitudes, phases : (n,).
    """

    wave_vectors: Array
    amplitudes: Array
    phases: Array

    @classmethod
    def draw(cls, rng: np.random.Generator, band: tuple[float, float], *, count: int, dimensions: int) -> PlaneWaves:
        """Random waves, one wavelength in each of ``count`` equal parts of the logarithm of ``band`` [m]."""
        part = (np.arange(count) + rng.uniform(size=count)) / count
        wavelengths = band[0] * (band[1] / band[0]) ** part
        directions = rng.normal(size=(count, dimensions))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        amplitudes = wavelengths**_REDNESS
        amplitudes *= np.sqrt(2.0 / np.sum(amplitudes**2))
        return cls(2.0 * np.pi / wavelengths[:, None] * directions, amplitudes, rng.uniform(0.0, 2.0 * np.pi, count))

    def __call__(self, points: Array) -> Array:
        """Values (n,) at points (n, d)."""
        return np.asarray(np.cos(points @ self.wave_vectors.T + self.phases) @ self.amplitudes)

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        """Values (nx, ny, nz) on a rectangular grid of three dimensions.

        A plane wave is a product of one factor an axis, so the sum over waves is one small matrix product.
        """
        k = self.wave_vectors
        ex = self.amplitudes * np.exp(1j * (np.outer(x, k[:, 0]) + self.phases))
        ey, ez = np.exp(1j * np.outer(y, k[:, 1])), np.exp(1j * np.outer(z, k[:, 2]))
        exy = (ex[:, None, :] * ey[None, :, :]).reshape(len(x) * len(y), -1)
        values = exy.real @ ez.real.T - exy.imag @ ez.imag.T
        return np.asarray(values).reshape(len(x), len(y), len(z))
