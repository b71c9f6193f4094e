"""Figures over time: position, error, and what the localizer said about itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from semmap.geometry import Array
from tools.report.figures import BLUE, GREEN, LINE, ORANGE, PINK, RED, SKY, YELLOW, look, plain_numbers, svg

BAND_COLOURS = {"unknown": LINE, "tracking": GREEN, "suspect": ORANGE, "lost": RED}
MORE_COLOURS = (SKY, PINK, BLUE, YELLOW)


@dataclass(frozen=True, slots=True)
class Line:
    """One trajectory to draw over time: name, times (n,) [s], positions (n, 3) [m], colour."""

    name: str
    times: Array
    positions: Array
    colour: str
    dashed: bool = False
    dots: bool = False


@dataclass(frozen=True, slots=True)
class Band:
    """A stretch of time [s] in one mode."""

    start: float
    end: float
    name: str


def position_over_time(lines: Sequence[Line], pins: Sequence[float] = ()) -> str:
    """X, Y and Z over time, one below the other; ``pins`` [s] are the accepted intersections."""
    with look():
        fig = Figure(figsize=(9.5, 5.6))
        panels = fig.subplots(3, 1, sharex=True)
        for axis, axes in enumerate(panels):
            for line in lines:
                style = "." if line.dots else "--" if line.dashed else "-"
                axes.plot(
                    line.times,
                    line.positions[:, axis],
                    style,
                    color=line.colour,
                    linewidth=1.2,
                    markersize=2,
                    label=line.name,
                )
            _draw_pins(axes, pins)
            axes.set_ylabel(f"{'xyz'[axis]} [m]")
            plain_numbers(axes)
        panels[-1].set_xlabel("time [s]")
        fig.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
        return svg(fig)


def errors_over_time(errors: Sequence[tuple[str, Array, Array, str]], pins: Sequence[float] = ()) -> str:
    """Position errors over time: (name, times [s], errors [m], colour) each; the axis is logarithmic."""
    with look():
        fig = Figure(figsize=(9.5, 2.6))
        axes = fig.subplots()
        for name, times, values, colour in errors:
            axes.plot(times, np.maximum(values, 1e-3), color=colour, linewidth=1.2, label=name)
        _draw_pins(axes, pins)
        axes.set_yscale("log")
        axes.set_xlabel("time [s]")
        axes.set_ylabel("position error [m]")
        fig.legend(loc="outside upper center", ncols=4)
        return svg(fig)


def _draw_pins(axes: Axes, pins: Sequence[float]) -> None:
    """Short red marks at the foot of a panel."""
    axes.plot(pins, np.full(len(pins), 0.02), "|", color=RED, markersize=7, transform=axes.get_xaxis_transform())


def mode_bands(rows: dict[str, Sequence[Band]]) -> str:
    """One row of coloured bands for each named state, over time."""
    names = sorted({band.name for bands in rows.values() for band in bands})
    others = [name for name in names if name not in BAND_COLOURS]
    colours = {**BAND_COLOURS, **dict(zip(others, cycle(MORE_COLOURS), strict=False))}
    with look():
        fig = Figure(figsize=(9.5, 0.9 + 0.4 * len(rows)))
        axes = fig.subplots()
        axes.grid(False)
        for y, bands in enumerate(rows.values()):
            for band in bands:
                axes.barh(y, band.end - band.start, left=band.start, height=0.6, color=colours[band.name])
        for name in names:
            axes.barh(0, 0, color=colours[name], label=name)
        axes.set_yticks(range(len(rows)), list(rows))
        axes.set_xlabel("time [s]")
        fig.legend(loc="outside upper center", ncols=min(6, len(names)))
        return svg(fig)


def seconds(stamps_ns: NDArray[np.int64], start_ns: int) -> Array:
    """Seconds (n,) since ``start_ns``."""
    return np.asarray((np.asarray(stamps_ns, dtype=np.int64) - start_ns) * 1e-9)
