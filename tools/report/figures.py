"""Matplotlib as the report uses it: one look, units on the axes, inline SVG, the same bytes every time."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

matplotlib.use("Agg")

INK, FAINT, LINE = "#1b1f24", "#5f6b76", "#d9dee3"
ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PINK = (
    "#e69f00", "#56b4e9", "#009e73", "#f0e442", "#0072b2", "#d55e00", "#cc79a7",
)  # fmt: skip
"""The palette of Okabe and Ito, told apart by colour-blind eyes."""

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
}


@contextmanager
def look() -> Iterator[None]:
    """Matplotlib set to the report's look for as long as the block runs."""
    with matplotlib.rc_context(LOOK):
        yield


def svg(fig: Figure) -> str:
    """A figure as an SVG element for an HTML page."""
    buffer = io.StringIO()
    fig.savefig(buffer, format="svg", dpi=130, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def plain_numbers(axes: Axes) -> None:
    """Mine-grid coordinates in full, without an offset that has to be added in the head."""
    axes.ticklabel_format(useOffset=False, style="plain")
