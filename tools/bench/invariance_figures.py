"""Pictures of `tools.bench.invariance`: similarity matrices (paper 004, Fig. 16), ROC, and the points' errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from semmap.geometry import Array
from tools.bench.measured import Measured, best_variant, own_and_other
from tools.report.colours import BLUE, GREEN, ORANGE, PINK, RED
from tools.report.figures import look

_DPI = 130


def save_figures(folder: Path, measured: Measured) -> None:
    """Write `matrices.png`, `roc.png` and `errors.png`."""
    with look():
        for name, figure in (
            ("matrices", _matrices(measured)), ("roc", _roc(measured)), ("errors", _errors(measured)),
        ):  # fmt: skip
            figure.savefig(folder / f"{name}.png", dpi=_DPI)


def _matrices(m: Measured) -> Figure:
    """Above map against map, below the mean of the near views that show an intersection against the map."""
    figure = Figure(figsize=(9.0, 8.4))
    tables = (
        (m.map_pwcv, "PWCV, map to map"),
        (m.map_cwc, "CWC, map to map"),
        (_means(m, m.pwcv), "PWCV, views to map"),
        (_means(m, m.cwc), "CWC, views to map"),
    )
    for place, (table, title) in enumerate(tables):
        axes = figure.add_subplot(2, 2, place + 1)
        image = axes.imshow(table, vmin=0.0, vmax=1.0, cmap="viridis")
        axes.set(title=title, xlabel="intersection of the map", ylabel="intersection")
        axes.grid(False)
        figure.colorbar(image, ax=axes, shrink=0.85, label="similarity")
    return figure


def _means(m: Measured, similarities: Array) -> Array:
    """Mean similarity (n, n) of the near views that show an intersection to all; NaN for one without a view."""
    out = np.full(m.map_pwcv.shape, np.nan)
    shown = m.near & np.isfinite(m.error)
    for row in np.unique(m.row[shown]):
        out[row] = similarities[shown & (m.row == row)].mean(axis=0)
    return out


def _roc(m: Measured) -> Figure:
    figure = Figure(figsize=(5.0, 4.2))
    axes = figure.add_subplot()
    around_point, around_sensor = (m.contexts[:, best_variant(m, at_point=at_point)] for at_point in (True, False))
    tables = (
        (m.pwcv, "PWCV", BLUE),
        (m.cwc, "CWC", ORANGE),
        (around_point, "Scan Context around the point", GREEN),
        (around_sensor, "Scan Context around the sensor", PINK),
    )
    for similarities, label, colour in tables:
        own, other = own_and_other(similarities[m.near], m.row[m.near])
        at = np.sort(np.concatenate([other, [0.0, 1.0]]))
        false = 1.0 - np.searchsorted(np.sort(other), at, side="right") / len(other)
        true = 1.0 - np.searchsorted(np.sort(own), at, side="right") / len(own)
        axes.step(false, true, color=colour, label=label, where="post")
    axes.set(xlabel="different intersections taken for the same", ylabel="same taken for the same", xscale="log")
    axes.set(xlim=(3e-4, 1.0), ylim=(0.0, 1.02), title="near views")
    axes.legend(loc="lower right")
    return figure


def _errors(m: Measured) -> Figure:
    figure = Figure(figsize=(8.4, 3.4))
    left, right = figure.subplots(1, 2)
    for error, label, colour in ((m.error[m.near], "near", BLUE), (m.error, "all", ORANGE)):
        left.step(np.sort(error), np.arange(1, len(error) + 1) / len(error), color=colour, label=label, where="post")
    left.axvline(0.5, color=RED, linewidth=0.8)
    left.axhline(0.9, color=RED, linewidth=0.8)
    left.set(xlim=(0.0, 2.0), ylim=(0.0, 1.02), xlabel="horizontal error of the point [m]", ylabel="share of the views")
    left.legend(loc="lower right")
    _errors_along(right, m)
    return figure


def _errors_along(axes: Axes, m: Measured) -> None:
    shown = np.isfinite(m.error)
    axes.plot(m.along[shown], np.minimum(m.error[shown], 2.0), ".", color=BLUE, markersize=3.0, label="seen")
    axes.plot(m.along[~shown], np.full((~shown).sum(), 2.1), "x", color=RED, markersize=4.0, label="not seen")
    axes.axhline(0.5, color=RED, linewidth=0.8)
    axes.set(xlabel="last keyframe past the point [m]", ylabel="horizontal error [m]", ylim=(0.0, 2.2))
    axes.legend(loc="upper center")
