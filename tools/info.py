"""What is in a semantic database, for the terminal."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from rich.console import Console

from semmap import database
from semmap.intersections import SemanticMap
from tools.tables import text_table


def print_info(path: Path) -> None:
    """Print an overview of the database at ``path`` and a table of its intersections."""
    semantic_map = database.load(path)
    console = Console(highlight=False, markup=False, soft_wrap=True)
    for name, value in overview(semantic_map).items():
        console.print(f"{name:<14} {value}")
    Console().print(text_table(INTERSECTION_HEAD, intersection_rows(semantic_map), left=0))


def overview(semantic_map: SemanticMap) -> dict[str, str]:
    """The figures of a semantic map by name, as text."""
    kinds = Counter(intersection.kind for intersection in semantic_map.intersections)
    listed = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
    lengths = semantic_map.roadways.edge_length
    x, y, z = semantic_map.origin
    return {
        "intersections": f"{len(semantic_map)} ({listed})" if listed else "none",
        "roadways": f"{len(lengths)}, {lengths.sum():.0f} m",
        "frame": f"{semantic_map.frame}, origin {x:.1f} {y:.1f} {z:.1f} m",
        "crs": semantic_map.crs or "not known",
        "sources": ", ".join(semantic_map.sources) or "not known",
    }


INTERSECTION_HEAD = ("id", "kind", "x [m]", "y [m]", "z [m]", "branches [°]", "widths [m]", "points")


def intersection_rows(semantic_map: SemanticMap) -> list[list[str]]:
    """One row an intersection: number, kind, position, bearings and widths of its branches, size of its cloud."""
    rows = []
    for one in semantic_map.intersections:
        bearings = " ".join(f"{value:.0f}" for value in np.degrees(one.branch_bearings))
        widths = " ".join(f"{value:.1f}" for value in one.branch_widths)
        position = [f"{value:.2f}" for value in one.p_map]
        rows.append([str(one.id), one.kind, *position, bearings, widths, str(len(one.cloud))])
    return rows
