"""The page about a semantic database: the plan, every intersection, and how alike they look."""

from __future__ import annotations

import numpy as np
import yaml

from descriptors.index import ContourIndex
from descriptors.settings import ContourSettings
from maps.settings import MapSettings
from semmap.intersections import SemanticMap
from tools.info import INTERSECTION_HEAD, intersection_rows, overview
from tools.report.contours import contour_picture, similarity_picture
from tools.report.page import facts, figure, folded, note, page, section, table
from tools.report.plan import plan


def database_page(semantic_map: SemanticMap, name: str) -> str:
    """The page (HTML) about a semantic map whose file is called ``name``."""
    return page(
        f"Semantic database {name}",
        "; ".join(f"{name}: {value}" for name, value in overview(semantic_map).items()),
        facts(_figures(semantic_map)),
        section(
            "Plan",
            figure(plan(semantic_map), "Roadway axes, the map around the intersections, and their numbers."),
        ),
        section("Intersections", table(INTERSECTION_HEAD, intersection_rows(semantic_map))),
        section("Wall contours (PWCV)", _contours(semantic_map)),
        section("Similarity", _similarity(semantic_map)),
        section("Settings", folded("what the descriptors depend on", _settings_text(semantic_map))),
    )


def _figures(semantic_map: SemanticMap) -> dict[str, str]:
    lengths = semantic_map.roadways.edge_length
    ends = int(np.count_nonzero(semantic_map.roadways.node_intersection < 0))
    points = int(semantic_map.columns.cloud_sizes.sum())
    return {
        "intersections": str(len(semantic_map)),
        "roadways": str(len(lengths)),
        "length of roadways": f"{lengths.sum():.0f} m",
        "ends of roadways": str(ends),
        "points kept": f"{points:,}",
    }


def _contours(semantic_map: SemanticMap) -> str:
    radius = _contour_settings(semantic_map).radius
    pictures = "".join(figure(contour_picture(one, radius)) for one in semantic_map.intersections)
    words = f"From above, x to the right, rim at {radius:g} m; orange: roadways that leave; open: not observed."
    return f'<div class="grid">{pictures}</div>{note(words)}' if pictures else ""


def _similarity(semantic_map: SemanticMap) -> str:
    if len(semantic_map) < 2:
        return ""
    contours = semantic_map.contours
    matrix = ContourIndex(contours, _contour_settings(semantic_map)).similarities(contours)
    picture = similarity_picture(matrix, semantic_map.columns.id.tolist())
    words = "1 means alike at the best rotation. Bright places off the diagonal are easy to confuse."
    return figure(picture, words, narrow=True)


def _contour_settings(semantic_map: SemanticMap) -> ContourSettings:
    return MapSettings.model_validate(dict(semantic_map.settings)).contour


def _settings_text(semantic_map: SemanticMap) -> str:
    return yaml.safe_dump(dict(semantic_map.settings), sort_keys=False)
