"""What is in a semantic database, for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from semmap import database
from semmap.geometry import Array
from semmap.intersections import RoadwayGraph, SemanticMap
from tools.tables import text_table

SHORT = 60
"""A table of more intersections than this is only shown when it is asked for."""
POOREST = 10


def print_info(path: Path, *, every: bool = False) -> None:
    """Print an overview of the database at ``path``, and a table of its intersections.

    Of many intersections the table is a summary by kind and the ones seen worst, unless ``every`` one is wanted.
    """
    semantic_map = database.load(path)
    console = Console(highlight=False, markup=False, soft_wrap=True)
    for name, value in overview(semantic_map).items():
        console.print(f"{name:<14} {value}")
    if every or len(semantic_map) <= SHORT:
        Console().print(text_table(INTERSECTION_HEAD, intersection_rows(semantic_map), left=0))
        return
    Console().print(text_table(KIND_HEAD, kind_rows(semantic_map)))
    poorest = np.argsort(semantic_map.columns.quality, kind="stable")[:POOREST]
    title = f"The {POOREST} seen worst (--all lists every one)"
    Console().print(text_table(INTERSECTION_HEAD, intersection_rows(semantic_map, poorest), left=0, title=title))


def overview(semantic_map: SemanticMap) -> dict[str, str]:
    """The figures of a semantic map by name, as text."""
    columns, roadways = semantic_map.columns, semantic_map.roadways
    x, y, z = semantic_map.origin
    return {
        "intersections": f"{len(columns)} ({_counted(columns.kind)})" if len(columns) else "none",
        "quality": _range(columns.quality, "{:.2f}"),
        "points kept": f"{columns.cloud_sizes.sum():,}",
        "roadways": f"{len(roadways.edge_length)}, {roadways.edge_length.sum():.0f} m",
        "nodes": _counted(roadways.node_kind) or "none",
        "widths": _range(roadways.edge_width, "{:.1f}", " m"),
        "heights": _range(roadways.edge_height[roadways.edge_height > 0.0], "{:.1f}", " m"),
        "slopes": _slopes(roadways),
        "frame": f"{semantic_map.frame}, origin {x:.1f} {y:.1f} {z:.1f} m",
        "crs": semantic_map.crs or "not known",
        "sources": _listed(list(semantic_map.sources)) or "not known",
    }


def _counted(kinds: NDArray[np.str_]) -> str:
    """How many there are of each kind."""
    words, counts = np.unique(kinds, return_counts=True)
    return ", ".join(f"{count} {word}" for word, count in zip(words.tolist(), counts.tolist(), strict=True))


def _range(values: Array, form: str, unit: str = "") -> str:
    if not len(values):
        return "not known"
    low, middle, high = (form.format(value) for value in (values.min(), np.median(values), values.max()))
    return f"{low} to {high}{unit}, median {middle}"


def _slopes(roadways: RoadwayGraph) -> str:
    """The roadways' mean slopes, uphill and downhill alike."""
    return _range(100.0 * np.abs(roadways.edge_slope), "{:.1f}", " %")


def _listed(names: Sequence[str], most: int = 8) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


KIND_HEAD = ("kind", "intersections", "branches", "quality: least", "median", "width [m]: median")


def kind_rows(semantic_map: SemanticMap) -> list[list[str]]:
    """One row a kind: how many, how many branches, how well seen, how wide."""
    c = semantic_map.columns
    rows = []
    for kind in np.unique(c.kind).tolist():
        some = c.take(np.flatnonzero(c.kind == kind))
        branches = "–".join(str(count) for count in sorted({some.branch_counts.min(), some.branch_counts.max()}))
        quality = [f"{some.quality.min():.2f}", f"{np.median(some.quality):.2f}"]
        width = f"{np.median(some.branch_widths):.1f}" if len(some.branch_widths) else "–"
        rows.append([kind, str(len(some)), branches, *quality, width])
    return rows


INTERSECTION_HEAD = ("id", "kind", "x [m]", "y [m]", "z [m]", "branches [°]", "widths [m]", "quality", "points")


def intersection_rows(semantic_map: SemanticMap, rows: NDArray[np.int64] | None = None) -> list[list[str]]:
    """One row an intersection, of all or of some: number, kind, place, bearings and widths of its branches, quality,
    size of its cloud."""
    c = semantic_map.columns
    table = []
    for row in range(len(c)) if rows is None else rows.tolist():
        branches = slice(c.branch_offsets[row], c.branch_offsets[row + 1])
        bearings = " ".join(f"{value:.0f}" for value in np.degrees(c.branch_bearings[branches]))
        widths = " ".join(f"{value:.1f}" for value in c.branch_widths[branches])
        place = [f"{value:.2f}" for value in c.p_map[row]]
        quality, points = f"{c.quality[row]:.2f}", str(c.cloud_sizes[row])
        table.append([str(c.id[row]), str(c.kind[row]), *place, bearings, widths, quality, points])
    return table
