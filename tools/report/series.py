"""Figures over time: position, attitude, errors and what they may be, and what the localizer said about itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from semmap.geometry import Array
from tools.report.colours import BLUE, LINE, MODES, PROVEN, STATES, named
from tools.report.figures import logarithmic, look, plain_numbers

SIGMAS = 3.0
POINTS = 1500
"""Of a line, at the most: of each stretch of it the least and the greatest value are drawn."""
_WIDTH = 9.5


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """One trajectory to draw over time: name, times (n,) [s], values (n, 3), colour; sigma (n, 3) for a band or None.

    dots : single points, not a line.
    """

    name: str
    times: Array
    values: Array
    colour: str
    dashed: bool = False
    sigma: Array | None = None
    dots: bool = False


@dataclass(frozen=True, slots=True)
class Band:
    """A stretch of time [s] in one mode."""

    start: float
    end: float
    name: str


Bands = Mapping[str, Sequence[Band]]
"""Rows of bands by what they are of."""


def three_over_time(
    lines: Sequence[Line], labels: Sequence[str], pins: Sequence[float] = (), bands: Bands | None = None
) -> Figure:
    """Three values over time, one below the other; ``pins`` [s] are the accepted intersections, ``bands`` strips
    above the lines."""
    with look():
        fig = Figure(figsize=(_WIDTH, 5.6))
        panels = fig.subplots(3, 1, sharex=True)
        for axis, axes in enumerate(panels):
            axes.margins(y=0.18)
            _draw_strips(axes, bands or {})
            for line in lines:
                _draw_line(axes, line, axis)
            _draw_pins(axes, pins)
            axes.set_ylabel(labels[axis])
            plain_numbers(axes)
        panels[-1].set_xlabel("time [s]")
        _legend(fig, panels[0])
        return fig


def _draw_line(axes: Axes, line: Line, axis: int) -> None:
    values = line.values[:, axis]
    rows = drawn_rows(values)
    times = line.times[rows]
    style = "o" if line.dots else "--" if line.dashed else "-"
    axes.plot(times, values[rows], style, color=line.colour, linewidth=1.2, markersize=3.5, label=line.name)
    if line.sigma is not None:
        reach = SIGMAS * line.sigma[rows, axis]
        label = f"{line.name}, {SIGMAS:g} sigma"
        low, high = values[rows] - reach, values[rows] + reach
        axes.fill_between(times, low, high, color=line.colour, alpha=0.22, linewidth=0, label=label)


def errors_in_sigmas(times: Array, errors: Array, sigma: Array, against: str, pins: Sequence[float] = ()) -> Figure:
    """Errors (n, 6), attitude about the IMU's axes [°] and position in the map's [m], between plus and minus three of
    the standard deviations (n, 6) that were said of them."""
    labels = [f"about {axis} [°]" for axis in "xyz"] + [f"{axis} [m]" for axis in "xyz"]
    with look():
        fig = Figure(figsize=(_WIDTH, 6.0))
        panels = fig.subplots(3, 2, sharex=True).T.ravel()
        for k, axes in enumerate(panels):
            rows = drawn_rows(errors[:, k])
            reach = SIGMAS * sigma[rows, k]
            axes.fill_between(times[rows], -reach, reach, color=LINE, linewidth=0, label=f"{SIGMAS:g} sigma")
            axes.plot(times[rows], errors[rows, k], color=BLUE, linewidth=1.0, label=f"error against {against}")
            _draw_pins(axes, pins)
            axes.set_ylabel(labels[k])
            axes.set_ylim(*_limits(errors[:, k], sigma[:, k]))
        for axes in (panels[2], panels[5]):
            axes.set_xlabel("time [s]")
        _legend(fig, panels[0])
        return fig


def _limits(errors: Array, sigma: Array) -> tuple[float, float]:
    """So that the errors and most of the band are seen, not the band's first moment."""
    known = np.isfinite(errors) & np.isfinite(sigma)
    if not known.any():
        return -1.0, 1.0
    reach = 1.15 * max(float(np.abs(errors[known]).max()), SIGMAS * float(np.percentile(sigma[known], 90)), 1e-6)
    return -reach, reach


def errors_over_time(errors: Sequence[tuple[str, Array, Array, str]], pins: Sequence[float] = ()) -> Figure:
    """Position errors over time: (name, times [s], errors [m], colour) each; the axis is logarithmic."""
    return _errors(errors, "time [s]", pins)


def errors_over_way(errors: Sequence[tuple[str, Array, Array, str]]) -> Figure:
    """Position errors over the distance travelled: (name, distances [m], errors [m], colour) each."""
    return _errors(errors, "distance travelled [m]", ())


def _errors(errors: Sequence[tuple[str, Array, Array, str]], label: str, pins: Sequence[float]) -> Figure:
    with look():
        fig = Figure(figsize=(_WIDTH, 2.8))
        axes = fig.subplots()
        for name, across, values, colour in errors:
            rows = drawn_rows(values)
            axes.plot(across[rows], np.maximum(values[rows], 1e-3), color=colour, linewidth=1.2, label=name)
        _draw_pins(axes, pins)
        logarithmic(axes.yaxis)
        axes.set_xlabel(label)
        axes.set_ylabel("position error [m]")
        _legend(fig, axes)
        return fig


def _draw_pins(axes: Axes, pins: Sequence[float]) -> None:
    """Short marks at the foot of a panel."""
    if len(pins):
        foot = np.full(len(pins), 0.02)
        label = "intersection accepted"
        transform = axes.get_xaxis_transform()
        axes.plot(pins, foot, "|", color=PROVEN, markersize=7, transform=transform, label=label)


def _draw_strips(axes: Axes, bands: Bands) -> None:
    """A thin strip at the top of a panel for each row of bands."""
    told: set[str] = set()
    for number, rows in enumerate(bands.values()):
        tints = named((band.name for band in rows), {**STATES, **MODES})
        top = 1.0 - 0.06 * number
        for band in rows:
            label = "_" if band.name in told else band.name
            told.add(band.name)
            axes.axvspan(band.start, band.end, top - 0.05, top, color=tints[band.name], linewidth=0, label=label)


def mode_bands(rows: Bands) -> Figure:
    """One row of coloured bands for each named state, over time."""
    names = sorted({band.name for bands in rows.values() for band in bands})
    tints = named(names, {**STATES, **MODES})
    with look():
        fig = Figure(figsize=(_WIDTH, 0.9 + 0.4 * len(rows)))
        axes = fig.subplots()
        axes.grid(False)
        for y, bands in enumerate(rows.values()):
            for band in bands:
                axes.barh(y, band.end - band.start, left=band.start, height=0.6, color=tints[band.name])
        for name in names:
            axes.barh(0, 0, color=tints[name], label=name)
        axes.set_yticks(range(len(rows)), list(rows))
        axes.set_xlabel("time [s]")
        fig.legend(loc="outside upper center", ncols=max(1, min(6, len(names))))
        return fig


def _legend(fig: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        fig.legend(handles, labels, loc="outside upper center", ncols=4)


def drawn_rows(values: Array) -> NDArray[np.int64]:
    """Rows of a series (n,) that are enough to draw it: of each of many stretches those of its least and its greatest
    value, and all ends of what is not known."""
    if len(values) <= POINTS:
        return np.arange(len(values))
    gaps = np.flatnonzero(np.diff(np.isnan(values).astype(np.int8)))
    kept = [0, len(values) - 1, *gaps.tolist(), *(gaps + 1).tolist()]
    edges = np.linspace(0, len(values), POINTS // 2 + 1).astype(np.int64)
    low, high = np.where(np.isnan(values), np.inf, values), np.where(np.isnan(values), -np.inf, values)
    for start, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        kept += [start + int(np.argmin(low[start:end])), start + int(np.argmax(high[start:end]))]
    return np.unique(np.array(kept, np.int64))


def seconds(stamps_ns: NDArray[np.int64], start_ns: int) -> Array:
    """Seconds (n,) since ``start_ns``."""
    return np.asarray((np.asarray(stamps_ns, dtype=np.int64) - start_ns) * 1e-9)


def roll_pitch_yaw(R: Array) -> Array:
    """Roll, pitch and yaw (n, 3) [°] of rotations (n, 3, 3), yaw without leaps."""
    roll = np.arctan2(R[:, 2, 1], R[:, 2, 2])
    pitch = -np.arcsin(np.clip(R[:, 2, 0], -1.0, 1.0))
    yaw = np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0])) if len(R) else np.zeros(0)
    return np.degrees(np.stack([roll, pitch, yaw], axis=-1))
