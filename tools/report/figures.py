"""Matplotlib as the reports use it: one look, units on the axes, the same bytes every time."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure

from semmap.files import written_whole
from tools.report.colours import FAINT, INK, LINE

matplotlib.use("Agg")

PRINT_DPI = 300

LOOK: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "semmap",
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": LINE,
    "grid.linewidth": 0.6,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    # names of runs, sensors and files may hold a dollar sign: they are words, not formulas
    "text.parse_math": False,
}


@dataclass(frozen=True, slots=True)
class Drawing:
    """A figure with the name of its files and its caption; ``over_time``: its x axis is the time of the run."""

    name: str
    figure: Figure
    caption: str = ""
    over_time: bool = False


@contextmanager
def look() -> Iterator[None]:
    """Matplotlib set to the report's look for as long as the block runs."""
    with matplotlib.rc_context(LOOK):
        yield


def svg(fig: Figure) -> str:
    """A figure as an SVG element for an HTML page."""
    with look():
        buffer = io.StringIO()
        fig.savefig(buffer, format="svg", dpi=130, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def write_drawing(drawing: Drawing, directory: Path) -> None:
    """Write a figure as ``NAME.png`` and ``NAME.svg`` for print."""
    with look():
        for ending, facts in (("png", {"Software": None}), ("svg", {"Date": None, "Creator": None})):
            with written_whole(directory / f"{drawing.name}.{ending}") as temporary:
                drawing.figure.savefig(temporary, format=ending, dpi=PRINT_DPI, metadata=facts)


def time_axis(fig: Figure) -> tuple[float, float, float, float]:
    """Where the x axis of a figure is: shares of its width at both ends, and the numbers there; after `svg`."""
    axes = fig.axes[0]
    box = axes.get_position()
    return (float(box.x0), float(box.x1), *(float(value) for value in axes.get_xlim()))


def logarithmic(axis: Axis) -> None:
    """A logarithmic axis with its numbers written out: powers would be formulas, which `LOOK` turns off."""
    getattr(axis.axes, f"set_{axis.axis_name}scale")("log")
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("")


def plain_numbers(axes: Axes) -> None:
    """Mine-grid coordinates in full, without an offset that has to be added in the head."""
    axes.ticklabel_format(useOffset=False, style="plain")
