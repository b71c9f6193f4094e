"""The mine from above, as the scripts of a page draw it."""

from __future__ import annotations

from typing import Any

import numpy as np

from semmap.geometry import Array
from semmap.intersections import SemanticMap
from tools.report.pack import Blobs, numbers, simplified

WALL_POINTS = 60_000
"""Wall points on a plan, at the most."""
_AXIS_TOLERANCE_M = 0.15
_CM = 100.0


def plan_data(semantic_map: SemanticMap | None, origin: Array, walls: Array, blobs: Blobs) -> dict[str, Any]:
    """Roadways and ends relative to ``origin`` (2,) [m]; ``walls`` (n, 2) likewise. Arrays go into ``blobs``."""
    axes = [] if semantic_map is None else [_drawn(axis, origin) for axis in semantic_map.roadways.edge_axes]
    widths = np.zeros(0) if semantic_map is None else semantic_map.roadways.edge_width
    blobs.add("road-offsets", np.cumsum([0, *map(len, axes)]).astype(np.uint32))
    blobs.add("road-points", _centimetres(np.concatenate([np.zeros((0, 2)), *axes])))
    blobs.add("road-widths", widths.astype(np.float32))
    blobs.add("walls", _centimetres(walls))
    ends = np.zeros((0, 2))
    if semantic_map is not None:
        graph = semantic_map.roadways
        ends = graph.node_p_map[graph.node_intersection < 0][:, :2] - origin
    return {"origin": origin.tolist(), "ends": ends.round(2).tolist()}


def _drawn(axis: Array, origin: Array) -> Array:
    line: Array = axis[:, :2] - origin
    return line[simplified(line, _AXIS_TOLERANCE_M)] if len(line) else line


def _centimetres(points: Array) -> Array:
    return np.asarray(np.round(_CM * points), np.int32)


def plan_origin(semantic_map: SemanticMap | None, tracks: list[Array]) -> Array:
    """A round point (2,) in the middle of what is drawn [m]."""
    clouds = [track[:, :2] for track in tracks if len(track)]
    if semantic_map is not None and len(semantic_map.roadways.node_p_map):
        clouds.append(semantic_map.roadways.node_p_map[:, :2])
    points = np.concatenate(clouds or [np.zeros((1, 2))])
    middle: Array = np.round(0.5 * (points.min(axis=0) + points.max(axis=0)), -1)
    return middle


def marks(semantic_map: SemanticMap | None, origin: Array) -> dict[str, Any]:
    """The intersections, column by column; x and y relative to ``origin``."""
    if semantic_map is None:
        return {
            "id": [],
            "x": [],
            "y": [],
            "z": [],
            "kind": [],
            "quality": [],
            "branches": [],
            "widths": [],
            "points": [],
        }
    c = semantic_map.columns
    spans = [slice(a, b) for a, b in zip(c.branch_offsets[:-1].tolist(), c.branch_offsets[1:].tolist(), strict=True)]
    degrees = np.degrees(c.branch_bearings)
    return {
        "id": c.id.tolist(),
        "x": numbers(c.p_map[:, 0] - origin[0], 2),
        "y": numbers(c.p_map[:, 1] - origin[1], 2),
        "z": numbers(c.p_map[:, 2], 2),
        "kind": c.kind.tolist(),
        "quality": numbers(c.quality, 3),
        "branches": [numbers(degrees[span], 1) for span in spans],
        "widths": [numbers(c.branch_widths[span], 1) for span in spans],
        "points": c.cloud_sizes.tolist(),
    }
