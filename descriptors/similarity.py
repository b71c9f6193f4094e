"""How alike two wall contours are, over all yaws at once.

Two sectors agree by ``exp(-(a - b)² / 2σ²)`` of their wall distances, an open sector counting as a wall at the radius.
The similarity at one yaw is the mean agreement of the sectors that both contours observed, times a penalty for
sectors that only one observed; it is 1 for equal contours only. A Gaussian of a difference is a sum of cosines, so a
contour becomes a few complex harmonics a sector, and one Fourier transform along the sectors gives every yaw.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from descriptors.settings import ContourSettings
from semmap.geometry import Array
from semmap.intersections import WallContour

Descriptor = Literal["pwcv", "cwc"]


@dataclass(frozen=True, slots=True)
class Similarity:
    """Agreement of two contours a and b at the best yaw.

    score : 0 to 1, 1 only for equal contours.
    yaw : rotation about z [rad], in [-π, π), that takes the directions of a to those of b:
        what a shows at the angle θ, b shows at θ + yaw.
    overlap : sectors observed by both, as a share of those observed by either.
    """

    score: float
    yaw: float
    overlap: float


def similarity(
    a: WallContour, b: WallContour, settings: ContourSettings | None = None, *, by: Descriptor = "pwcv"
) -> Similarity:
    """Similarity of two contours by their PWCV or by their CWC, made with the same settings."""
    settings = settings or ContourSettings()
    scores, overlaps = scores_by_yaw(spectrum(a, settings, by), spectrum(b, settings, by))
    return best_yaw(scores, overlaps)


def completeness(current: WallContour, database: WallContour) -> float:
    """Share ``k_c / k_b`` of the database contour's walls that the current one shows, at most 1 (paper 004, Eq. 32).

    ``k`` counts the sectors of the PWCV with a wall. 0 where the database contour has no wall at all.
    """
    k_c, k_b = np.count_nonzero(current.pwcv), np.count_nonzero(database.pwcv)
    return float(min(k_c / k_b, 1.0)) if k_b else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Fourier transforms along the sectors of one contour, or of several stacked in front.

    harmonics : (..., layers, waves, sectors) complex, of the observed sectors' harmonics.
    observed : (..., layers, sectors) complex, of the mask.
    """

    harmonics: NDArray[np.complex64]
    observed: NDArray[np.complex64]


def spectrum(contour: WallContour, settings: ContourSettings, by: Descriptor = "pwcv") -> Spectrum:
    """Spectrum of one contour, or of stacked ones; the PWCV is taken as a CWC of one layer."""
    if by == "pwcv":
        distance, observed = contour.pwcv[..., None, :], contour.pwcv_observed[..., None, :]
    else:
        distance, observed = contour.cwc, contour.cwc_observed
    amplitude = np.sqrt(kernel_power(settings))
    harmonics = np.empty((*distance.shape[:-1], len(amplitude), distance.shape[-1]), np.complex128)
    turn = np.exp(1j * np.pi * relative_distance(distance, settings))
    harmonics[..., 0, :] = observed
    for wave in range(1, len(amplitude)):
        np.multiply(harmonics[..., wave - 1, :], turn, out=harmonics[..., wave, :])
    harmonics *= amplitude[:, None]
    return Spectrum(
        np.fft.fft(harmonics).astype(np.complex64), np.fft.fft(observed.astype(np.float64)).astype(np.complex64)
    )


def relative_distance(distance: NDArray[np.float32], settings: ContourSettings) -> Array:
    """Wall distances of contours, in radii; an open sector counts as a wall at the radius."""
    relative = np.minimum(distance.astype(np.float64) / settings.radius, 1.0)
    return np.where(distance > 0.0, relative, 1.0)


def kernel_power(settings: ContourSettings) -> Array:
    """Powers (k,) of the waves of which the agreement of two sectors is made, 1 in sum.

    ``Σ power cos(π wave Δ) = exp(-Δ² / 2σ²)`` for distances that differ by Δ <= 1, all in radii, but for the shortest
    waves, which are left out.
    """
    sigma = settings.tolerance / settings.radius
    wave = np.arange(int(np.ceil(3.0 / (np.pi * sigma))) + 1)
    power = np.exp(-0.5 * (np.pi * wave * sigma) ** 2)
    power[1:] *= 2.0
    return np.asarray(power / power.sum())


def scores_by_yaw(a: Spectrum, b: Spectrum) -> tuple[Array, Array]:
    """Scores and overlaps (..., sectors) of a turned by 0, 1, 2 … sectors against b; leading dimensions broadcast.

    The score is the mean agreement of the sectors both observed times the fourth root of the overlap. What comes out
    for two contours is the same to the last bit whatever is stacked beside them.
    """
    agreement = np.fft.ifft(np.einsum("...lks,...lks->...s", np.conj(a.harmonics), b.harmonics)).real
    both = np.fft.ifft(np.einsum("...ls,...ls->...s", np.conj(a.observed), b.observed)).real.round()
    either = (a.observed[..., 0].real.sum(-1) + b.observed[..., 0].real.sum(-1)).round()[..., None] - both
    mean = np.clip(agreement / np.maximum(both, 1.0), 0.0, 1.0)
    overlap = both / np.maximum(either, 1.0)
    return mean * np.sqrt(np.sqrt(overlap)), overlap


def best_yaw(scores: Array, overlaps: Array) -> Similarity:
    """The best of the scores (sectors,), its yaw interpolated between sectors."""
    return yaw_at(scores, overlaps, int(np.argmax(scores)))


def yaw_at(scores: Array, overlaps: Array, best: int) -> Similarity:
    """The peak ``best`` of the scores (sectors,), its yaw interpolated between sectors."""
    sectors = len(scores)
    before, top, after = float(scores[best - 1]), float(scores[best]), float(scores[(best + 1) % sectors])
    bend = before - 2.0 * top + after
    between = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    yaw = (best + between) * 2.0 * np.pi / sectors
    return Similarity(top, float((yaw + np.pi) % (2.0 * np.pi) - np.pi), float(overlaps[best]))
