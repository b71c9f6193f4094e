"""The plan of the mine for print: roadways, the cloud around the intersections, their numbers, and tracks on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from semmap.geometry import Array
from semmap.intersections import IntersectionTable, SemanticMap
from tools.report.colours import ANCHOR, FAINT, INK, KINDS, LINE, MARKS, PROVEN, RED, SCALE, WALL
from tools.report.figures import look, plain_numbers
from tools.report.pack import thinned

WALL_POINTS = 60_000
"""Wall points drawn at the most; they are drawn as one picture."""
_NAMES = 120
"""Of more intersections than this none is named: the names would hide them."""
_TRACK_POINTS = 6000


@dataclass(frozen=True, slots=True)
class Track:
    """A line on the plan: name, positions (n, 3) [m], colour; values (n,) to colour it by, called ``label``, or None;
    or names (n,) with a colour each."""

    name: str
    positions: Array
    colour: str
    values: Array | None = None
    label: str = "position error [m]"
    dashed: bool = False
    names: NDArray[np.str_] | None = None
    colours: Mapping[str, str] = field(default_factory=dict)


def plan(
    semantic_map: SemanticMap | None,
    tracks: Sequence[Track] = (),
    *,
    recognised: Sequence[int] = (),
    anchors: Sequence[int] = (),
) -> Figure:
    """The plan; intersections numbered in ``recognised`` are ringed, those in ``anchors`` likewise."""
    with look():
        fig = Figure(figsize=_figure_size(_extent(semantic_map, tracks)))
        axes = fig.subplots()
        if semantic_map is not None:
            _draw_walls(axes, semantic_map)
            _draw_roadways(axes, semantic_map)
        for track in tracks:
            draw_track(fig, axes, track)
        if semantic_map is not None:
            _draw_intersections(axes, semantic_map)
            _ring(axes, semantic_map, recognised, "recognised", PROVEN, 13)
            _ring(axes, semantic_map, anchors, "anchor proposed", ANCHOR, 16)
        _finish(fig, axes)
        return fig


def _finish(fig: Figure, axes: Axes) -> None:
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    plain_numbers(axes)
    if axes.get_legend_handles_labels()[0]:
        fig.legend(loc="outside lower center", ncols=4)


def error_maps(semantic_map: SemanticMap | None, tracks: Sequence[Track]) -> Figure:
    """One plan a run, coloured alike by the values of its track (paper 004, Fig. 10)."""
    with look():
        extent = _extent(None, tracks)
        everything = np.concatenate([track.positions[:, :2] for track in tracks])
        bounds = np.stack([everything.min(axis=0) - 10.0, everything.max(axis=0) + 10.0], axis=1).tolist()
        columns = min(2, len(tracks))
        rows = -(-len(tracks) // columns)
        width, height = _figure_size(extent, 9.5 / columns)
        fig = Figure(figsize=(columns * width, rows * height))
        panels = fig.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
        known = [track.values[np.isfinite(track.values)] for track in tracks if track.values is not None]
        highest = max((float(values.max()) for values in known if len(values)), default=1.0)
        for axes, track in zip(panels, tracks, strict=False):
            if semantic_map is not None:
                _draw_roadways(axes, semantic_map)
            axes.set_title(track.name, fontsize=9)
            _draw_values(axes, track, highest)
            axes.set(xlim=bounds[0], ylim=bounds[1], aspect="equal")
            plain_numbers(axes)
        for axes in panels[len(tracks) :]:
            axes.set_visible(False)
        fig.supxlabel("x [m]", fontsize=9)
        fig.supylabel("y [m]", fontsize=9)
        drawn = next((one for axes in panels for one in axes.collections if one.get_array() is not None), None)
        if drawn is not None:
            fig.colorbar(drawn, ax=panels.tolist(), label=tracks[0].label, shrink=0.7)
        return fig


def _extent(semantic_map: SemanticMap | None, tracks: Sequence[Track]) -> Array:
    """Width and height (2,) [m] of what will be drawn."""
    clouds = [track.positions[:, :2] for track in tracks]
    if semantic_map is not None:
        clouds.append(semantic_map.roadways.node_p_map.reshape(-1, 3)[:, :2])
    points = np.concatenate([cloud for cloud in clouds if len(cloud)] or [np.zeros((1, 2))])
    return np.asarray(np.ptp(points, axis=0)) + 20.0


def _figure_size(extent: Array, width: float = 9.5) -> tuple[float, float]:
    """Inches: as high as the mine asks for, within what a page can take."""
    return width, float(np.clip(width * extent[1] / extent[0], 0.32 * width, 1.16 * width)) + 0.8


def _draw_walls(axes: Axes, semantic_map: SemanticMap) -> None:
    table = IntersectionTable.of(semantic_map.intersections)
    if len(table) > WALL_POINTS // 20:
        return  # a handful of points of each would be mist
    most = WALL_POINTS // max(1, len(table))
    clouds = [p[:2] + thinned(table.read_cloud(k), most)[:, :2] for k, p in enumerate(table.columns.p_map)]
    if clouds:
        axes.plot(*np.concatenate(clouds).T, ",", color=WALL, rasterized=True, zorder=0.5)


def _draw_roadways(axes: Axes, semantic_map: SemanticMap) -> None:
    lines = [axis[:, :2] for axis in semantic_map.roadways.edge_axes]
    axes.add_collection(LineCollection(lines, colors=FAINT, linewidths=1.0, label="roadway axis", zorder=1))
    ends = semantic_map.roadways.node_p_map[semantic_map.roadways.node_intersection < 0]
    if len(ends):
        axes.plot(ends[:, 0], ends[:, 1], "|", color=FAINT, markersize=6, label="end or bend of a roadway", zorder=1)
    axes.autoscale_view()


def _draw_intersections(axes: Axes, semantic_map: SemanticMap) -> None:
    c = semantic_map.columns
    for kind in np.unique(c.kind).tolist():
        points, size = c.p_map[c.kind == kind], 6.0 if len(c) <= 300 else 2.5
        axes.plot(
            points[:, 0], points[:, 1], MARKS.get(kind, "o"), color=KINDS.get(kind, RED), markersize=size,
            markeredgewidth=0.0, linestyle="", label=f"{kind} intersection", zorder=3,
        )  # fmt: skip
    if len(c) > _NAMES:
        return
    for id, p in zip(c.id.tolist(), c.p_map, strict=True):
        axes.annotate(str(id), (p[0], p[1]), xytext=(6, 5), textcoords="offset points", fontsize=8, color=INK, zorder=5)


def _ring(axes: Axes, semantic_map: SemanticMap, ids: Sequence[int], label: str, colour: str, size: float) -> None:
    points = semantic_map.p_map[np.isin(semantic_map.columns.id, np.array(ids, np.int64))]
    if len(points):
        axes.plot(
            points[:, 0],
            points[:, 1],
            "o",
            markersize=size,
            markerfacecolor="none",
            color=colour,
            label=label,
            zorder=4,
        )


def draw_track(fig: Figure, axes: Axes, track: Track) -> None:
    """A track on a plan, with its legend or its scale."""
    if not len(track.positions):
        return
    if track.values is not None:
        points = _draw_values(axes, track, None)
        fig.colorbar(points, ax=axes, label=track.label, shrink=0.6)
        return
    if track.names is not None:
        _draw_names(axes, track)
        return
    some = _some(len(track.positions))
    x, y = track.positions[some, 0], track.positions[some, 1]
    style = "--" if track.dashed else "-"
    axes.plot(x, y, style, color=track.colour, linewidth=1.4, label=track.name, zorder=2)


def _draw_values(axes: Axes, track: Track, highest: float | None) -> LineCollection:
    """A thick line coloured by the track's values, grey where they are not known."""
    some = _some(len(track.positions))
    xy = track.positions[some, :2]
    assert track.values is not None
    values = track.values[some]
    pieces = np.stack([xy[:-1], xy[1:]], axis=1) if len(xy) > 1 else np.zeros((0, 2, 2))
    shades = colormaps[SCALE].with_extremes(bad=LINE)
    lines = LineCollection(pieces, cmap=shades, linewidths=3.0, zorder=2, capstyle="round", rasterized=True)
    lines.set_array(np.ma.masked_invalid(values[1:]))
    lines.set_clim(0.0, highest if highest is not None else max(float(np.nanmax(np.append(values, 1e-3))), 1e-3))
    axes.add_collection(lines)
    axes.autoscale_view()
    return lines


def _draw_names(axes: Axes, track: Track) -> None:
    assert track.names is not None
    some = _some(len(track.positions))
    xy, names = track.positions[some, :2], track.names[some]
    pieces = np.stack([xy[:-1], xy[1:]], axis=1) if len(xy) > 1 else np.zeros((0, 2, 2))
    tints = [track.colours.get(str(name), FAINT) for name in names[1:]]
    axes.add_collection(LineCollection(pieces, colors=tints, linewidths=3.0, zorder=2, capstyle="round"))
    axes.autoscale_view()
    for name in dict.fromkeys(names.tolist()):
        axes.add_line(Line2D([], [], color=track.colours.get(name, FAINT), linewidth=3.0, label=name))


def _some(count: int) -> NDArray[np.int64]:
    return np.unique(np.linspace(0, count - 1, min(count, _TRACK_POINTS)).astype(np.int64))
