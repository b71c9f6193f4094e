"""The figures of a semantic database for print: plan, clouds, contours, similarities (paper 004, Fig. 7, 14 to 16)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from numpy.typing import NDArray

from descriptors.settings import ContourSettings
from maps.settings import MapSettings
from semmap.geometry import Array
from semmap.intersections import Intersection, SemanticMap
from tools.report.colours import BLUE, LINE, ORANGE, SCALE
from tools.report.figures import Drawing, look
from tools.report.likeness import Likeness
from tools.report.pack import thinned
from tools.report.plan import plan

SHEETS = 120
"""Intersections of a large map that are drawn one by one, those most easily confused first."""
_ON_A_SHEET = 12
_CLOUD_POINTS = 4000
_NUMBERED = 12
"""Matrices of up to so many intersections have their numbers written in."""


def database_drawings(semantic_map: SemanticMap, likeness: Likeness) -> Iterator[Drawing]:
    """All figures of a database."""
    anchors = likeness.levels[1].anchors.intersections
    words = "Roadways and intersections, and where anchors would tell all apart that PWCV and CWC do not."
    yield Drawing("plan", plan(semantic_map, anchors=anchors), words)
    if len(likeness.rows) > 1:
        yield Drawing("similarity", similarity_matrices(semantic_map, likeness), "Paper 004, Fig. 16.")
    rows = _drawn_rows(semantic_map, likeness)
    contour = MapSettings.model_validate(dict(semantic_map.settings)).contour
    for number, start in enumerate(range(0, len(rows), _ON_A_SHEET), 1):
        some = [semantic_map.intersections[row] for row in rows[start : start + _ON_A_SHEET]]
        yield Drawing(f"pwcv_{number}", _sheet(some, _draw_pwcv, contour, polar=True), "Paper 004, Fig. 15a.")
        yield Drawing(
            f"cwc_{number}", _sheet(some, _draw_cwc, contour, scale="to the wall [m]"), "Paper 004, Fig. 15b."
        )
        yield Drawing(f"clouds_{number}", _sheet(some, _draw_cloud, contour, scale="height [m]"), "Paper 004, Fig. 14.")


def _drawn_rows(semantic_map: SemanticMap, likeness: Likeness) -> list[int]:
    alike = [row for pair in likeness.pairs for row in (pair.a, pair.b)]
    order = list(dict.fromkeys([*alike, *range(min(len(semantic_map), SHEETS))]))[:SHEETS]
    return sorted(order)


def similarity_matrices(semantic_map: SemanticMap, likeness: Likeness) -> Figure:
    """PWCV and CWC similarities side by side (paper 004, Fig. 16)."""
    names = [str(id) for id in semantic_map.columns.id[likeness.rows].tolist()]
    with look():
        fig = Figure(figsize=(9.5, 4.6))
        panels = fig.subplots(1, 2)
        for axes, name in zip(panels, ("pwcv", "cwc"), strict=True):
            picture = _draw_matrix(axes, getattr(likeness, name), names)
            axes.set_title(name.upper(), fontsize=9)
        fig.colorbar(picture, ax=panels.tolist(), label="similarity, best turn [1]", shrink=0.8)
        return fig


def _draw_matrix(axes: Axes, values: Array, names: Sequence[str]) -> ScalarMappable:
    axes.grid(False)
    picture = axes.imshow(values, vmin=0.0, vmax=1.0, cmap=SCALE, interpolation="nearest")
    ticks = range(0, len(names), max(1, len(names) // 20))
    axes.set_xticks(ticks, [names[k] for k in ticks], fontsize=7)
    axes.set_yticks(ticks, [names[k] for k in ticks], fontsize=7)
    axes.set_xlabel("intersection")
    axes.set_ylabel("intersection")
    if len(names) <= _NUMBERED:
        for row, column in np.ndindex(values.shape):
            tint = "white" if values[row, column] < 0.5 else "black"
            axes.text(column, row, f"{values[row, column]:.2f}", ha="center", va="center", fontsize=6, color=tint)
    return picture


Draw = Callable[[Axes, Intersection, ContourSettings], ScalarMappable | None]
_HEIGHTS_M = (-0.5, 4.5)
"""Heights above the invariant point that the colours of clouds cover, the same on all sheets."""


def _sheet(
    some: Sequence[Intersection], draw: Draw, contour: ContourSettings, *, polar: bool = False, scale: str = ""
) -> Figure:
    """A dozen small pictures on a sheet, with a common scale called ``scale`` where colours are numbers."""
    with look():
        columns, rows = 4, -(-len(some) // 4)
        fig = Figure(figsize=(9.5, 2.5 * rows))
        panels = fig.subplots(rows, columns, squeeze=False, subplot_kw={"projection": "polar"} if polar else {}).ravel()
        shades = None
        for axes, one in zip(panels, some, strict=False):
            axes.set_title(f"{one.id} ({one.kind})", fontsize=8)
            axes.tick_params(labelsize=6)
            shades = draw(axes, one, contour) or shades
        for axes in panels[len(some) :]:
            axes.set_visible(False)
        if scale and shades is not None:
            fig.colorbar(shades, ax=panels.tolist(), label=scale, shrink=0.6)
        return fig


def _draw_pwcv(axes: Axes, one: Intersection, contour: ContourSettings) -> None:
    pwcv, seen = one.contour.pwcv, one.contour.pwcv_observed
    reach = np.where(pwcv > 0.0, np.minimum(pwcv, contour.radius), contour.radius)
    edges = np.linspace(0.0, 2.0 * np.pi, len(pwcv) + 1)
    width = np.diff(edges)[seen]
    axes.bar(edges[:-1][seen], reach[seen], width=width, align="edge", color=BLUE, alpha=0.35, linewidth=0)
    axes.set_ylim(0.0, contour.radius)
    axes.set_rlabel_position(22.5)  # type: ignore[attr-defined]
    axes.set_yticks([contour.radius / 2, contour.radius], [f"{contour.radius / 2:g} m", f"{contour.radius:g} m"])
    for bearing in one.branch_bearings:
        axes.plot([bearing, bearing], [0.9 * contour.radius, contour.radius], color=ORANGE, linewidth=3)


def _draw_cwc(axes: Axes, one: Intersection, contour: ContourSettings) -> ScalarMappable:
    values: NDArray[np.float64] = np.where(one.contour.cwc > 0.0, one.contour.cwc, np.nan).astype(np.float64)
    top = contour.layer_from + contour.layers * contour.layer_height
    extent = (0.0, 360.0, contour.layer_from, top)
    axes.grid(False)
    unseen = np.where(one.contour.cwc_observed, np.nan, 1.0)
    axes.imshow(unseen, extent=extent, origin="lower", aspect="auto", cmap="Greys", vmin=0.0, vmax=4.0)
    shades = axes.imshow(
        values, extent=extent, origin="lower", aspect="auto", cmap=SCALE, vmin=0.0, vmax=contour.radius
    )  # fmt: skip
    axes.set_xticks([0, 90, 180, 270, 360])
    axes.set_xlabel("direction [°]", fontsize=7)
    axes.set_ylabel("height [m]", fontsize=7)
    return shades


def _draw_cloud(axes: Axes, one: Intersection, contour: ContourSettings) -> ScalarMappable | None:
    """From above and aside, coloured by height."""
    points = thinned(one.cloud.astype(np.float64), _CLOUD_POINTS)
    axes.set_aspect("equal")
    axes.grid(False)
    x, y, z = points[np.argsort(points[:, 2])].T
    low, high = _HEIGHTS_M
    shades = axes.scatter(x, y + 0.6 * z, c=z, s=0.6, linewidths=0, cmap=SCALE, vmin=low, vmax=high, rasterized=True)
    axes.plot([-10.0, -5.0], [-14.0, -14.0], color="black", linewidth=1.5)
    axes.annotate("5 m", (-7.5, -13.5), ha="center", fontsize=6)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_edgecolor(LINE)
    return shades
