"""A window on a database, a run or a point cloud: the only file that knows pyvista."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from maps.prior_map import read_prior_map
from semmap import database
from semmap.errors import InputFileError, SettingsError
from semmap.files import written_whole
from semmap.geometry import Array
from semmap.intersections import SemanticMap
from tools.files import writable_file
from tools.progress import progress_bar
from tools.report.colours import FAINT, INK, KINDS, LIVE_CLOUD, PROVEN, RED, SCALE, TRACKS
from tools.report.events import accepted_intersections
from tools.report.pack import thinned
from tools.report.run_files import RunFiles, read_run
from tools.report.run_tracks import TITLES, main_track, placed_trajectories, position_errors

POINTS = 4_000_000
"""Points drawn at the most; more are thinned evenly."""
_SIZE = (1600, 1000)
_NAMES = 400
"""Of more intersections than this none is named."""
_DATABASES = (".h5", ".hdf5")


def view_source(source: Path, *, screenshot: Path | None = None, intersection: int | None = None) -> None:
    """Show a semantic database, a run directory or a point cloud in a window, or take a picture of it.

    screenshot : a PNG file to write instead of opening a window; needs no screen.
    intersection : of a database, only the intersection of this number, with all its points.

    Raises the errors of the files; `SettingsError` where there is no screen or pyvista is not installed.
    """
    if screenshot is not None:
        writable_file(screenshot)
    elif sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise SettingsError("there is no screen to open a window on", field="view", mend="give --screenshot PNG")
    plotter = _plotter(off_screen=screenshot is not None)
    if intersection is not None and (source.is_dir() or source.suffix.lower() not in _DATABASES):
        raise SettingsError("is of a database", field="--intersection", mend="give a DB.h5")
    if source.is_dir():
        origin = _show_run(plotter, read_run(source))
    elif source.suffix.lower() in _DATABASES:
        origin = _show_database(plotter, database.load(source), intersection)
    else:
        with progress_bar("reading") as progress:
            prior_map = read_prior_map([source], progress=progress)
        origin = prior_map.origin
        _add_heights(plotter, prior_map.points, origin)
    _finish(plotter, origin, screenshot)


def _plotter(*, off_screen: bool) -> Any:
    try:
        import pyvista
        from vtkmodules.vtkCommonCore import vtkLogger
    except ImportError as reason:
        mend = "pip install pyvista"
        raise SettingsError(f"pyvista does not load ({reason})", field="view", mend=mend) from None
    if off_screen:
        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)  # says that there is no screen, which is known
    plotter = pyvista.Plotter(off_screen=off_screen, window_size=list(_SIZE), title="semmap")
    plotter.set_background("white")
    return plotter


def _finish(plotter: Any, origin: Array, screenshot: Path | None) -> None:
    """Axes with their units, and then the window or the picture."""
    titles = [f"{axis} [m]" if o == 0.0 else f"{axis} - {o:.0f} [m]" for axis, o in zip("xyz", origin, strict=True)]
    plotter.show_grid(
        xtitle=titles[0], ytitle=titles[1], ztitle=titles[2], color=FAINT, font_size=10, minor_ticks=False, fmt="%.0f"
    )
    plotter.add_axes(color=INK)
    plotter.view_vector((-0.55, -0.75, 1.0), (0.0, 0.0, 1.0))
    plotter.reset_camera(bounds=plotter.bounds)
    plotter.camera.zoom(1.1)
    if screenshot is None:
        plotter.show()
        return
    with written_whole(screenshot) as temporary:
        # pyvista goes by the ending of the name
        picture = temporary.with_suffix(".png")
        plotter.screenshot(picture)
        picture.replace(temporary)


def _show_database(plotter: Any, semantic_map: SemanticMap, intersection: int | None) -> Array:
    if intersection is None:
        _add_map(plotter, semantic_map, semantic_map.origin)
        return semantic_map.origin
    try:
        one = semantic_map.by_id(intersection)
    except KeyError:
        mend = "`semmap info --all` lists them"
        raise SettingsError(f"there is no intersection {intersection}", field="--intersection", mend=mend) from None
    _add_heights(plotter, one.cloud, one.p_map)
    plotter.add_points(np.zeros((1, 3)), color=PROVEN, point_size=16, render_points_as_spheres=True)
    return one.p_map


def _show_run(plotter: Any, run: RunFiles) -> Array:
    placed = placed_trajectories(run)
    name = main_track(placed)
    if run.semantic_map is None and name is None:
        raise InputFileError("has nothing to show: no pose and no database", file=run.name, mend="look at events.jsonl")
    origin = run.semantic_map.origin if run.semantic_map is not None else np.zeros(3)
    if run.semantic_map is not None:
        _add_map(plotter, run.semantic_map, origin)
        ringed = np.isin(run.semantic_map.columns.id, accepted_intersections(run.events))
        _add_marks(plotter, run.semantic_map.p_map[ringed] - origin, PROVEN, 22, "recognised")
    if name is not None and len(placed[name]) > 1:
        one = placed[name]
        errors = position_errors(one, run.truth)
        _add_track(plotter, one.positions - origin, errors if np.isfinite(errors).any() else None, TITLES[name], name)
    if run.overlays is not None and len(run.overlays):
        seen = np.concatenate([run.overlays.in_map(k) for k in range(len(run.overlays))])
        if len(seen):
            points = thinned(seen - origin, POINTS // 4).astype(np.float32)
            plotter.add_points(points, color=LIVE_CLOUD, point_size=3, label="keyframes, by ICP")
    if plotter.actors:
        plotter.add_legend(bcolor="white", border=False, face="circle", size=(0.16, 0.16))
    return origin


def _add_track(plotter: Any, positions: Array, errors: Array | None, title: str, name: str) -> None:
    import pyvista

    line = pyvista.lines_from_points(positions.astype(np.float32))
    if errors is None:
        plotter.add_mesh(line, color=TRACKS[name], line_width=5, label=title)
        return
    line["position error [m]"] = np.nan_to_num(errors)
    plotter.add_mesh(
        line, scalars="position error [m]", cmap=SCALE, line_width=6,
        scalar_bar_args=_bar("position error [m]", 0.58, "%.3f"),
    )  # fmt: skip


def _add_map(plotter: Any, semantic_map: SemanticMap, origin: Array) -> None:
    """Clouds by height, roadway axes, intersections with their numbers."""
    import pyvista

    count = max(1, len(semantic_map))
    clouds = [
        thinned(one.cloud, POINTS // count) + (one.p_map - origin).astype(np.float32)
        for one in semantic_map.intersections
    ]
    if clouds:
        _add_heights(plotter, np.concatenate(clouds), origin)
    axes = [axis - origin for axis in semantic_map.roadways.edge_axes if len(axis) > 1]
    if axes:
        ends = np.cumsum([0, *map(len, axes)])
        cells = [np.concatenate([[b - a], np.arange(a, b)]) for a, b in pairwise(ends)]
        lines = pyvista.PolyData(np.concatenate(axes).astype(np.float32), lines=np.concatenate(cells))
        plotter.add_mesh(lines, color=INK, line_width=2, label="roadway axis")
    c = semantic_map.columns
    for kind in np.unique(c.kind).tolist():
        _add_marks(plotter, c.p_map[c.kind == kind] - origin, KINDS.get(kind, RED), 14, f"{kind} intersection")
    if 0 < len(c) <= _NAMES:
        _add_names(plotter, c.p_map - origin, [str(id) for id in c.id.tolist()])


def _add_names(plotter: Any, points: Array, names: Sequence[str]) -> None:
    above = points + np.array([0.0, 0.0, 4.0])
    look = {"font_size": 14, "text_color": INK, "shape": None, "show_points": False, "always_visible": True}
    plotter.add_point_labels(above, list(names), **look)


def _add_marks(plotter: Any, points: Array, colour: str, size: int, label: str) -> None:
    if len(points):
        plotter.add_points(points, color=colour, point_size=size, render_points_as_spheres=True, label=label)


def _add_heights(plotter: Any, points: Array, origin: Array) -> None:
    """Points (n, 3) relative to ``origin``, coloured by their height in the map."""
    some = thinned(points, POINTS)
    size = 4 if len(some) < 100_000 else 2
    plotter.add_points(
        some, scalars=some[:, 2] + origin[2], cmap=SCALE, point_size=size, scalar_bar_args=_bar("z [m]", 0.12, "%.1f")
    )


def _bar(title: str, left: float, digits: str) -> dict[str, Any]:
    """A scale at the foot of the window, ``left`` in shares of its width."""
    place = {"position_x": left, "position_y": 0.02, "width": 0.3, "height": 0.06, "vertical": False}
    return {"title": title, "color": INK, "fmt": digits, "title_font_size": 16, "label_font_size": 14, **place}
