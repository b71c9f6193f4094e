"""Wall contours as bytes for the scripts of a page, and what they say in numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from descriptors.settings import ContourSettings
from semmap.geometry import Array
from semmap.intersections import SemanticMap, WallContour
from tools.report.pack import BATCH, Blobs, numbers

UNSEEN = 255
_STEPS = 254.0


def contour_bytes(distance: NDArray[np.float32], observed: NDArray[np.bool_], radius: float) -> NDArray[np.uint8]:
    """Distances [m] as bytes: 0 open, 1 to 254 of the radius, 255 not seen."""
    steps = np.where(distance > 0.0, np.clip(np.round(distance / radius * _STEPS), 1, _STEPS), 0)
    return np.where(observed, steps, UNSEEN).astype(np.uint8)


def add_contours(contours: WallContour, settings: ContourSettings, blobs: Blobs) -> dict[str, Any]:
    """All contours into ``blobs``, a batch an array; returns what the scripts must know of their shape."""
    pwcv = contour_bytes(contours.pwcv, contours.pwcv_observed, settings.radius)
    cwc = contour_bytes(contours.cwc, contours.cwc_observed, settings.radius)
    for k in range(0, len(pwcv), BATCH):
        blobs.add(f"pwcv-{k // BATCH}", pwcv[k : k + BATCH])
        blobs.add(f"cwc-{k // BATCH}", cwc[k : k + BATCH])
    layers, sectors = cwc.shape[1:]
    shape = {"from": settings.layer_from, "height": settings.layer_height}
    return {"radius": settings.radius, "sectors": sectors, "layers": layers, **shape}


def wall_figures(semantic_map: SemanticMap) -> dict[str, list[float | None]]:
    """Nearest, median and farthest wall of each intersection [m], and the height of its roadways."""
    pwcv, seen = semantic_map.contours.pwcv, semantic_map.contours.pwcv_observed
    found = np.full((len(semantic_map), 3), np.nan)
    for row in range(len(semantic_map)):
        walls = pwcv[row][seen[row] & (pwcv[row] > 0.0)]
        if len(walls):
            found[row] = walls.min(), np.median(walls), walls.max()
    nearest, median, farthest = (numbers(column, 2) for column in found.T)
    height = numbers(_heights(semantic_map), 2)
    return {"nearest": nearest, "median": median, "farthest": farthest, "height": height}


def _heights(semantic_map: SemanticMap) -> Array:
    """Median height (n,) of the roadways that meet at each intersection, NaN where none is known."""
    graph = semantic_map.roadways
    row_of_id = {id: row for row, id in enumerate(semantic_map.columns.id.tolist())}
    known: dict[int, list[float]] = {}
    for nodes, height in zip(graph.edge_nodes.tolist(), graph.edge_height.tolist(), strict=True):
        for node in nodes if height > 0.0 else ():
            known.setdefault(int(graph.node_intersection[node]), []).append(height)
    heights = np.full(len(semantic_map), np.nan)
    for id, values in known.items():
        if id in row_of_id:
            heights[row_of_id[id]] = np.median(values)
    return heights
