"""A small picture of each place where found intersections and labels disagree, to judge who is right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from semmap.geometry import Array
from semmap.intersections import SemanticMap
from tools.bench.agreement import Agreement, Label

_REACH, _CELL = 20.0, 0.15
"""[m] half the side of a picture, and of its cells."""
_LEVEL = 4.0
"""[m] above and below in which axes belong to the same level."""
_FLOOR, _WALL = (-0.35, 0.35), (0.4, 1.8)
"""Heights [m] above the axis that are drawn light and dark."""
_ARM = 7.0


def draw_disagreements(agreed: Agreement, there: SemanticMap, points: Array, out: Path) -> list[Path]:
    """Pictures of missed, extra and unequal intersections in ``out``; points (n, 3) of the map, map frame."""
    out.mkdir(parents=True, exist_ok=True)
    axes = np.concatenate([np.zeros((0, 3)), *there.roadways.edge_axes])
    places = [(f"missed_{label.id}", _with_height(label, axes)) for label in agreed.missed]
    places += [(f"extra_{one.id}", one.p_map) for one in agreed.extra]
    places += [(f"branches_{label.id}", one.p_map) for label, one in agreed.unequal]
    return [_picture(out / f"{name}.png", p, agreed, there, points, axes) for name, p in places]


def _with_height(label: Label, axes: Array) -> Array:
    """The label's position, on the nearest axis where it has no height of its own."""
    if np.isfinite(label.p_map[2]) or not len(axes):
        return np.nan_to_num(label.p_map)
    nearest = np.argmin(np.linalg.norm(axes[:, :2] - label.p_map[:2], axis=1))
    return np.append(label.p_map[:2], axes[nearest, 2])


def _picture(path: Path, p: Array, agreed: Agreement, there: SemanticMap, points: Array, axes: Array) -> Path:
    figure = Figure(figsize=(6.4, 6.4), layout="constrained")
    ax = figure.add_subplot()
    _draw_rock(ax, p, points, axes)
    _draw_roadways(ax, p, there)
    for one in agreed.found:
        if abs(one.p_map[2] - p[2]) < _LEVEL:
            _draw_star(ax, one.p_map, one.branch_bearings, "tab:blue", f"{one.id} {one.kind} {one.quality:.2f}")
    for label in agreed.labels:
        if not abs(label.p_map[2] - p[2]) > _LEVEL:
            _draw_star(ax, label.p_map, label.bearings, "tab:red", f"label {label.id}")
    ax.set(xlim=(p[0] - _REACH, p[0] + _REACH), ylim=(p[1] - _REACH, p[1] + _REACH), aspect="equal", title=path.stem)
    figure.savefig(path, dpi=80)
    return path


def _draw_rock(ax: Axes, p: Array, points: Array, axes: Array) -> None:
    """Floor light and walls dark, by the height above the nearest axis of this level."""
    near = points[(np.abs(points - p) < [_REACH, _REACH, 2.0 * _LEVEL]).all(axis=1)]
    level = axes[(np.abs(axes - p) < [1.5 * _REACH, 1.5 * _REACH, 2.0 * _LEVEL]).all(axis=1)]
    if not len(near):
        return
    reference = level[cKDTree(level[:, :2]).query(near[:, :2])[1], 2] if len(level) else p[2]
    height = near[:, 2] - reference
    edges = [np.arange(c - _REACH, c + _REACH + _CELL, _CELL) for c in p[:2]]
    shade = np.ones((len(edges[0]) - 1, len(edges[1]) - 1))
    for (low, high), value in ((_FLOOR, 0.85), (_WALL, 0.3)):
        inside = near[(height > low) & (height < high)]
        shade[np.histogram2d(inside[:, 0], inside[:, 1], bins=edges)[0] > 0] = value
    extent = (edges[0][0], edges[0][-1], edges[1][0], edges[1][-1])
    ax.imshow(shade.T, origin="lower", extent=extent, cmap="gray", vmin=0.0, vmax=1.0)


def _draw_roadways(ax: Axes, p: Array, there: SemanticMap) -> None:
    for axis in there.roadways.edge_axes:
        if (np.abs(axis - p) < [_REACH, _REACH, _LEVEL]).all(axis=1).any():
            ax.plot(axis[:, 0], axis[:, 1], color="tab:green", lw=1.2)
    nodes = there.roadways.node_p_map
    nodes = nodes[np.abs(nodes[:, 2] - p[2]) < _LEVEL]
    ax.plot(nodes[:, 0], nodes[:, 1], ".", color="tab:green", ms=6)


def _draw_star(ax: Axes, p: Array, bearings: Array, color: str, text: str) -> None:
    """A point with its branches and what it is called."""
    for bearing in bearings:
        end = p[:2] + _ARM * np.array([np.cos(bearing), np.sin(bearing)])
        ax.plot(*np.stack([p[:2], end]).T, color=color, lw=1.0, alpha=0.8)
    ax.plot(*p[:2], "o", color=color, ms=5)
    ax.annotate(
        text,
        p[:2],
        xytext=(5, 5 if color == "tab:blue" else -11),
        textcoords="offset points",
        color=color,
        fontsize=8,
        clip_on=True,
        annotation_clip=True,
    )
