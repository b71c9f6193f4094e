"""Wall contours as small polar pictures, and how alike they are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from semmap.geometry import Array
from semmap.intersections import Intersection
from tools.report.figures import BLUE, FAINT, INK, LINE, ORANGE, look, svg

SIZE = 120.0
"""Edge of one polar picture, in its own units."""


def contour_picture(one: Intersection, radius: float) -> str:
    """The PWCV of one intersection from above, x to the right: free as far as the wall, branches marked.

    Sectors without a wall within the radius reach the rim; unobserved ones are left open.
    """
    scale, centre = 0.46 * SIZE / radius, SIZE / 2
    rim = f'<circle cx="{centre}" cy="{centre}" r="{radius * scale:.1f}" fill="none" stroke="{LINE}"/>'
    half = f'<circle cx="{centre}" cy="{centre}" r="{radius * scale / 2:.1f}" fill="none" stroke="{LINE}"/>'
    wall = f'<path d="{_contour_path(one, radius, scale)}" fill="{BLUE}" fill-opacity="0.18" stroke="{BLUE}"/>'
    branches = "".join(_branch(bearing, radius * scale) for bearing in one.branch_bearings)
    title = f'<text x="4" y="12" font-size="11" fill="{INK}">{one.id}</text>'
    kind = f'<text x="{SIZE - 4}" y="12" font-size="10" fill="{FAINT}" text-anchor="end">{one.kind}</text>'
    return f'<svg viewBox="0 0 {SIZE:.0f} {SIZE:.0f}" role="img">{half}{rim}{wall}{branches}{title}{kind}</svg>'


def _contour_path(one: Intersection, radius: float, scale: float) -> str:
    """One closed path a sector that was observed: the slice from the centre to the wall, or to the rim."""
    pwcv, seen = one.contour.pwcv, one.contour.pwcv_observed
    bearings = np.arange(len(pwcv) + 1) * 2.0 * np.pi / len(pwcv)
    reach = np.where(pwcv > 0.0, np.minimum(pwcv, radius), radius) * scale
    path = []
    for run in _runs(seen):
        edge = [_at(bearings[s + side], reach[s]) for s in run for side in (0, 1)]
        start = "M" if len(run) == len(seen) else f"M{SIZE / 2:.1f} {SIZE / 2:.1f}L"
        path.append(start + "L".join(edge) + "Z")
    return "".join(path)


def _runs(seen: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """Indices of the stretches of neighbouring sectors that were observed."""
    indices = np.flatnonzero(seen)
    return np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1) if len(indices) else []


def _at(bearing: float, reach: float) -> str:
    """A point of the picture; y points down there."""
    return f"{SIZE / 2 + reach * np.cos(bearing):.1f} {SIZE / 2 - reach * np.sin(bearing):.1f}"


def _branch(bearing: float, rim: float) -> str:
    inner, outer = _at(bearing, 0.86 * rim).split(), _at(bearing, 1.06 * rim).split()
    return (
        f'<line x1="{inner[0]}" y1="{inner[1]}" x2="{outer[0]}" y2="{outer[1]}" '
        f'stroke="{ORANGE}" stroke-width="3" stroke-linecap="round"/>'
    )


def similarity_picture(similarities: Array, ids: Sequence[int]) -> str:
    """The matrix (n, n) of PWCV similarities as an SVG element."""
    with look():
        fig = Figure(figsize=(7.0, 5.8))
        axes = fig.subplots()
        axes.grid(False)
        picture = axes.imshow(similarities, vmin=0.0, vmax=1.0, cmap="viridis", interpolation="nearest")
        step = max(1, len(ids) // 25)
        ticks = range(0, len(ids), step)
        axes.set_xticks(ticks, [str(ids[i]) for i in ticks], fontsize=7)
        axes.set_yticks(ticks, [str(ids[i]) for i in ticks], fontsize=7)
        axes.set_xlabel("intersection")
        axes.set_ylabel("intersection")
        fig.colorbar(picture, ax=axes, label="PWCV similarity, best rotation [1]")
        return svg(fig)
