"""How well the position was known: over the way, and as ellipses along the track (paper 000, Fig. 7, 8)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from semmap.geometry import Array
from tools.report.colours import FAINT, INK, LINE, MODES, RED, named
from tools.report.figures import logarithmic, look, plain_numbers
from tools.report.series import drawn_rows
from tools.report.uncertainty import Uncertainties

THRESHOLD = 0.05
"""[m²] the line of the paper's Fig. 8, ``D_p``."""
ELLIPSES = 60
"""Along a track, at the most."""
_SIGMAS = 3.0
_SMALLEST = 1e-6
"""[m²] the figures' lower end."""


def covariance_over_distance(known: Uncertainties, distance: Array) -> Figure:
    """Variances of x, y and z [m²] over the way (n,) [m], the modes as bands behind them (paper 000, Fig. 8)."""
    colours = mode_colours(known)
    with look():
        fig = Figure(figsize=(9.5, 3.6))
        axes = fig.subplots()
        _draw_modes(axes, known, distance, colours)
        for axis, colour in enumerate((INK, FAINT, RED)):
            variance = known.position[:, axis, axis]
            rows = drawn_rows(variance)
            shown = np.maximum(variance[rows], _SMALLEST)
            axes.plot(distance[rows], shown, color=colour, linewidth=1.3, label="xyz"[axis])
        axes.axhline(THRESHOLD, color=INK, linewidth=0.8, linestyle=":", label=f"{THRESHOLD:g} m²")
        logarithmic(axes.yaxis)
        axes.set_xlabel("distance travelled [m]")
        axes.set_ylabel(f"variance of the position in {known.frame} [m²]")
        fig.legend(loc="outside upper center", ncols=8)
        return fig


def ellipses_along_track(known: Uncertainties, positions: Array) -> Figure:
    """The position's covariance as ellipses along the track, from above and from the side (paper 000, Fig. 7).

    positions : (n, 3) [m] of the rows of ``known``. Three sigmas, made larger by one factor for the figure, which says
    by how much.
    """
    use = _some(known, positions)
    colours = mode_colours(known)
    with look():
        fig = Figure(figsize=(9.5, 4.2))
        factor = _magnified(known.position[use], positions)
        for axes, (a, b) in zip(fig.subplots(2, 1), ((0, 1), (0, 2)), strict=True):
            axes.plot(positions[:, a], positions[:, b], color=LINE, linewidth=1.0)
            for mode, colour in colours.items():
                _draw_ellipses(axes, known, positions, use[known.modes[use] == mode], (a, b), factor, colour, mode)
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_xlabel(f"{'xyz'[a]} [m]")
            axes.set_ylabel(f"{'xyz'[b]} [m]")
            plain_numbers(axes)
        fig.legend(
            *fig.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=6,
            title=f"{_SIGMAS:g} sigma" + (f", {factor:g} times as large" if factor > 1.0 else ""),
        )  # fmt: skip
        return fig


def mode_colours(known: Uncertainties) -> dict[str, str]:
    """A colour for each mode that occurs, in order of appearance."""
    return named((name for _, _, name in known.stretches()), MODES)


def _draw_modes(axes: Axes, known: Uncertainties, distance: Array, colours: dict[str, str]) -> None:
    told: set[str] = set()
    for begin, end, mode in known.stretches():
        label = "_" if mode in told else mode
        told.add(mode)
        last = distance[min(end, len(distance) - 1)]
        axes.axvspan(distance[begin], last, color=colours[mode], alpha=0.25, linewidth=0, label=label)


def _some(known: Uncertainties, positions: Array) -> NDArray[np.int64]:
    """Rows at equal distances whose covariance is known."""
    rows = np.flatnonzero(np.isfinite(known.position).all(axis=(1, 2)))
    if not len(rows):
        return rows
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions[rows], axis=0), axis=1))])
    return np.unique(rows[np.searchsorted(way, np.linspace(0.0, way[-1], ELLIPSES))])


def _magnified(covariances: Array, positions: Array) -> float:
    """A round factor by which the median ellipse is as long as the ellipses are apart."""
    if not len(covariances):
        return 1.0
    apart = float(np.linalg.norm(np.ptp(positions, axis=0))) / ELLIPSES
    length = 2.0 * _SIGMAS * float(np.sqrt(np.median(np.linalg.eigvalsh(covariances)[:, -1])))
    return float(10.0 ** max(0, np.floor(np.log10(3.0 * apart / max(length, 1e-9)))))


def _draw_ellipses(
    axes: Axes,
    known: Uncertainties,
    positions: Array,
    rows: NDArray[np.int64],
    plane: tuple[int, int],
    factor: float,
    colour: str,
    mode: str,
) -> None:
    if not len(rows):
        return
    pair = list(plane)
    values, vectors = np.linalg.eigh(known.position[rows][:, pair][:, :, pair])
    sizes = 2.0 * _SIGMAS * factor * np.sqrt(np.maximum(values, 0.0))
    angles = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    axes.add_collection(
        EllipseCollection(
            sizes[:, 1],
            sizes[:, 0],
            angles,
            units="xy",
            offsets=positions[rows][:, pair],
            offset_transform=axes.transData,
            facecolors="none",
            edgecolors=colour,
            linewidths=1.0,
        )
    )
    axes.plot([], [], "o", markerfacecolor="none", color=colour, label=mode)
