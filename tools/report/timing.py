"""How long scans took, as a histogram."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from semmap.geometry import Array
from tools.report.colours import BLUE, RED
from tools.report.figures import logarithmic, look

_WORDS = {"ms": "processing of a scan [ms]", "latency_ms": "from a scan's arrival to its pose [ms]"}


def timing_histogram(milliseconds: Array, timed: str) -> Figure:
    """Histogram of the times (n,) [ms] of the scans; both axes logarithmic, for the rare long ones are of interest."""
    values = np.maximum(milliseconds, 1e-2)
    with look():
        fig = Figure(figsize=(9.5, 2.8))
        axes = fig.subplots()
        edges = np.geomspace(values.min() * 0.95, values.max() * 1.05, 60)
        axes.hist(values, bins=edges.tolist(), color=BLUE, alpha=0.8)
        for percent, style in ((50, "-"), (95, "--")):
            at = float(np.percentile(values, percent))
            axes.axvline(at, color=RED, linestyle=style, linewidth=1.2, label=f"{percent} %: {at:.1f} ms")
        logarithmic(axes.xaxis)
        logarithmic(axes.yaxis)
        axes.set_xlabel(_WORDS.get(timed, f"{timed} [ms]"))
        axes.set_ylabel("scans")
        fig.legend(loc="outside upper center", ncols=2)
        return fig
