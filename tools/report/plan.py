"""The plan of the mine: roadways, the cloud around the intersections, their numbers, and tracks on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from semmap.geometry import Array
from semmap.intersections import Intersection, SemanticMap
from tools.report.figures import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    PINK,
    RED,
    SKY,
    look,
    plain_numbers,
    svg,
)

KIND_MARKS = {"L": ("s", SKY), "T": ("^", BLUE), "Y": ("v", GREEN), "X": ("D", ORANGE), "multi": ("*", PINK)}
OTHER_MARK = ("o", RED)
WALL = "#aab4be"
WALL_POINTS = 40_000
"""Wall points drawn at the most; they are drawn as one picture."""


@dataclass(frozen=True, slots=True)
class Track:
    """A line on the plan: name, positions (n, 3) [m], colour; errors (n,) [m] to colour it by, or None."""

    name: str
    positions: Array
    colour: str
    errors: Array | None = None
    dashed: bool = False


def plan(semantic_map: SemanticMap | None, tracks: Sequence[Track] = (), *, recognised: Sequence[int] = ()) -> str:
    """The plan as an SVG element; intersections numbered in ``recognised`` are ringed."""
    with look():
        fig = Figure(figsize=_figure_size(_extent(semantic_map, tracks)))
        axes = fig.subplots()
        if semantic_map is not None:
            _draw_walls(axes, semantic_map.intersections)
            _draw_roadways(axes, semantic_map)
        for track in tracks:
            _draw_track(fig, axes, track)
        if semantic_map is not None:
            _draw_intersections(axes, semantic_map.intersections, recognised)
        axes.set_aspect("equal")
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        plain_numbers(axes)
        if axes.get_legend_handles_labels()[0]:
            fig.legend(loc="outside lower center", ncols=4)
        return svg(fig)


def _extent(semantic_map: SemanticMap | None, tracks: Sequence[Track]) -> Array:
    """Width and height (2,) [m] of what will be drawn."""
    clouds = [track.positions[:, :2] for track in tracks]
    if semantic_map is not None:
        clouds.append(semantic_map.roadways.node_p_map.reshape(-1, 3)[:, :2])
    points = np.concatenate([cloud for cloud in clouds if len(cloud)] or [np.zeros((1, 2))])
    return np.asarray(np.ptp(points, axis=0)) + 20.0


def _figure_size(extent: Array, width: float = 9.5) -> tuple[float, float]:
    """Inches: as high as the mine asks for, within what a page can take."""
    return width, float(np.clip(width * extent[1] / extent[0], 3.0, 11.0)) + 0.8


def _draw_walls(axes: Axes, intersections: Sequence[Intersection]) -> None:
    clouds = [one.p_map[:2] + one.cloud[:, :2] for one in intersections if len(one.cloud)]
    if not clouds:
        return
    points = np.concatenate(clouds)
    points = points[:: max(1, len(points) // WALL_POINTS)]
    axes.plot(*points.T, ",", color=WALL, rasterized=True, zorder=0.5)


def _draw_roadways(axes: Axes, semantic_map: SemanticMap) -> None:
    label = "roadway axis"
    for axis in semantic_map.roadways.edge_axes:
        axes.plot(axis[:, 0], axis[:, 1], color=FAINT, linewidth=1.0, label=label, zorder=1)
        label = "_"
    ends = semantic_map.roadways.node_p_map[semantic_map.roadways.node_intersection < 0]
    if len(ends):
        axes.plot(ends[:, 0], ends[:, 1], "|", color=FAINT, markersize=6, label="end of a roadway", zorder=1)


def _draw_intersections(axes: Axes, intersections: Sequence[Intersection], recognised: Sequence[int]) -> None:
    for kind in sorted({one.kind for one in intersections}):
        mark, colour = KIND_MARKS.get(kind, OTHER_MARK)
        points = np.array([one.p_map for one in intersections if one.kind == kind])
        axes.plot(
            points[:, 0],
            points[:, 1],
            mark,
            color=colour,
            markersize=6,
            label=f"{kind} intersection",
            zorder=3,
        )
    ringed = np.array([one.p_map for one in intersections if one.id in set(recognised)]).reshape(-1, 3)
    if len(ringed):
        axes.plot(
            ringed[:, 0],
            ringed[:, 1],
            "o",
            markersize=13,
            markerfacecolor="none",
            color=RED,
            label="recognised",
            zorder=4,
        )
    for one in intersections:
        axes.annotate(
            str(one.id),
            (one.p_map[0], one.p_map[1]),
            xytext=(6, 5),
            textcoords="offset points",
            fontsize=8,
            color=INK,
            zorder=5,
        )


def _draw_track(fig: Figure, axes: Axes, track: Track) -> None:
    if not len(track.positions):
        return
    x, y = track.positions[:, 0], track.positions[:, 1]
    if track.errors is None:
        style = "--" if track.dashed else "-"
        axes.plot(x, y, style, color=track.colour, linewidth=1.4, label=track.name, zorder=2)
        return
    points = axes.scatter(
        x, y, c=track.errors, s=5, cmap="viridis", linewidths=0, rasterized=True, label=track.name, zorder=2
    )
    fig.colorbar(points, ax=axes, label="position error [m]", shrink=0.6)
