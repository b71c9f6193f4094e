"""The page about a semantic database: the plan, every intersection, and which of them look alike."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np
import yaml

from localize.settings import LocalizeSettings
from maps.settings import MapSettings
from semmap.geometry import Array
from semmap.intersections import SemanticMap
from tools.info import overview
from tools.progress import Advance
from tools.report.anchors import Proposal
from tools.report.contour_data import add_contours, wall_figures
from tools.report.journeys import NEVER
from tools.report.likeness import WHOLE, Likeness, likeness_of, told_by
from tools.report.pack import Blobs, Clouds, numbers, thinned
from tools.report.page import facts, folded, note, page, place, section, table
from tools.report.plan_data import WALL_POINTS, marks, plan_data, plan_origin

CHARACTERS = 21_500_000
"""Of a page's arrays, at the most: what clouds may take is what the rest leaves of it."""
_CLOUD_POINTS = (100, 6000)
"""Points of a cloud, at least and at the most."""
_CHARACTERS_A_POINT = 5.4
LEVEL_HEAD = ("what is looked at", "pairs left", "anchors needed", "fewest?")
_PAIRS = 2000
"""Pairs in the page; the CSV has all."""


def database_page(
    semantic_map: SemanticMap,
    name: str,
    settings: LocalizeSettings,
    likeness: Likeness | None = None,
    progress: Advance | None = None,
) -> str:
    """The page (HTML) about a semantic map whose file is called ``name``."""
    likeness = likeness or likeness_of(semantic_map, settings, progress)
    blobs = Blobs()
    origin = plan_origin(semantic_map, [])
    contour = MapSettings.model_validate(dict(semantic_map.settings)).contour
    shape = add_contours(semantic_map.contours, contour, blobs)
    _add_matrices(likeness, blobs)
    clouds, walls = add_clouds(semantic_map, origin, blobs)
    data = {
        "plan": plan_data(semantic_map, origin, walls, blobs),
        "intersections": {**marks(semantic_map, origin), **wall_figures(semantic_map)},
        "contour": shape,
        "clouds": clouds,
        "pairs": _pairs(likeness, settings),
        "levels": [
            {"pairs": [k for k in level.pairs if k < _PAIRS], "anchors": level.anchors.intersections}
            for level in likeness.levels
        ],
        "matrix": {"rows": likeness.rows} if len(likeness.rows) > 1 else None,
    }
    return page(
        f"Semantic database {name}",
        "; ".join(f"{name}: {value}" for name, value in overview(semantic_map).items()),
        facts(_figures(semantic_map)),
        section(
            "Plan",
            note("Pick an intersection on the plan, in a table or in a matrix to look at it."),
            f'<div class="main">{place("plan")}{_detail(max((row[1] for row in clouds), default=0))}</div>',
        ),
        section("All intersections", place("table")),
        section("What could be taken for each other", *_confusable(semantic_map, likeness, settings)),
        section("Similarity", _matrices(semantic_map, likeness)),
        section("Settings", folded("what the descriptors depend on", _settings_text(semantic_map))),
        script="database",
        data=data,
        blobs=blobs,
    )  # fmt: skip


def _settings_text(semantic_map: SemanticMap) -> str:
    return yaml.safe_dump(dict(semantic_map.settings), sort_keys=False)


def _figures(semantic_map: SemanticMap) -> dict[str, str]:
    lengths = semantic_map.roadways.edge_length
    ends = int(np.count_nonzero(semantic_map.roadways.node_intersection < 0))
    return {
        "intersections": str(len(semantic_map)),
        "roadways": str(len(lengths)),
        "length of roadways": f"{lengths.sum():.0f} m",
        "ends and bends of roadways": str(ends),
        "points kept": f"{int(semantic_map.columns.cloud_sizes.sum()):,}",
    }


def add_clouds(semantic_map: SemanticMap, origin: Array, blobs: Blobs) -> tuple[list[list[float]], Array]:
    """The clouds of all intersections, each about its point, as thin as the page's size asks for; and wall points
    (n, 2) of them relative to ``origin`` for the plan."""
    count = max(1, len(semantic_map))
    low, high = _CLOUD_POINTS
    most = int(np.clip((CHARACTERS - blobs.size()) / (_CHARACTERS_A_POINT * count), low, high))
    clouds, walls = Clouds(blobs, "cloud"), [np.zeros((0, 2))]
    for place_ in semantic_map.intersections:
        points = thinned(place_.cloud.astype(np.float64), most)
        clouds.add(points)
        walls.append(thinned(points, WALL_POINTS // count)[:, :2] + place_.p_map[:2] - origin)
    return clouds.done(), np.concatenate(walls)


def _add_matrices(likeness: Likeness, blobs: Blobs) -> None:
    for name in ("pwcv", "cwc"):
        values = np.clip(np.round(255.0 * getattr(likeness, name)), 0, 255)
        blobs.add(f"matrix-{name}", values.astype(np.uint8))


def _pairs(likeness: Likeness, settings: LocalizeSettings) -> list[dict[str, Any]]:
    return [
        {
            "a": pair.a, "b": pair.b, "yaw": round(pair.yaw, 4), "pwcv": round(pair.pwcv, 3),
            "cwc": round(pair.cwc, 3), "rock": numbers([pair.rock], 3)[0],
            "passed": pair.passed if pair.passed < NEVER else None, "told": told_by(pair, settings),
        }
        for pair in likeness.pairs[:_PAIRS]
    ]  # fmt: skip


def _detail(points: float) -> str:
    return (
        '<div id="detail" class="panel"><div class="bar">'
        '<h3 id="which" aria-live="polite"></h3><button type="button" id="before">‹ before</button>'
        '<button type="button" id="after">next ›</button>'
        '<label>number <input id="chosen" inputmode="numeric" size="6"></label></div>'
        '<div id="cloud"></div><dl class="small" id="figures"></dl>'
        '<h3>CWC, unrolled</h3><div id="unrolled"></div><div id="second"></div>'
        '<h3>PWCV</h3><div id="polar"></div>'
        + note(
            "PWCV: from above, x to the right, free as far as the wall, open roadways to the rim, unseen directions "
            f"left out; orange: where roadways leave. Clouds are thinned to {points:.0f} points at the most."
        )
        + "</div>"
    )


def _confusable(semantic_map: SemanticMap, likeness: Likeness, settings: LocalizeSettings) -> list[str]:
    if not likeness.pairs:
        return [note(f"No two intersections have a PWCV similarity of {settings.matcher.min_pwcv:g} or more.")]
    rows = [
        [level.name, str(len(level.pairs)), str(len(level.anchors.intersections)), _sureness(level.anchors)]
        for level in likeness.levels
    ]
    options = "".join(
        f'<option value="{k}"{" selected" if k == 1 else ""}>{escape(level.name)}</option>'
        for k, level in enumerate(likeness.levels)
    )
    words = (
        f"Alike: PWCV similarity {settings.matcher.min_pwcv:g} or more, and CWC {settings.matcher.min_cwc:g}; by their "
        "order: driving on from both by the same turn, the same intersections come after the same distances; by the "
        f"rock: likeness {settings.proof.no_likeness:g} or more after ICP. A UWB anchor at one of two that look alike "
        "tells them apart; the numbers are those of the fewest anchors after which no pair is left."
    )
    left_out = []
    if len(likeness.pairs) > _PAIRS:
        left_out.append(f"The first {_PAIRS} of {len(likeness.pairs)} pairs are shown; --csv writes all.")
    if likeness.capped:
        left_out.append("Some have more look-alikes than were sought: pairs are missing, and anchors may be.")
    return [
        table(LEVEL_HEAD, rows, text=(LEVEL_HEAD[0], LEVEL_HEAD[3])),
        note(words),
        f'<p><label>Show what is still alike by <select id="level">{options}</select></label></p>'
        '<p>Anchors at: <span id="anchors" aria-live="polite"></span></p>',
        note(" ".join(left_out)) if left_out else "",
        place("pairs"),
    ]


def _sureness(anchors: Proposal) -> str:
    return "yes" if anchors.exact else f"found by search, not proven; at least {anchors.least} are needed"


def _matrices(semantic_map: SemanticMap, likeness: Likeness) -> str:
    if len(likeness.rows) < 2:
        return ""
    words = "1: alike at the best turn. Bright cells off the diagonal are easy to confuse; pick one to compare its two."
    if len(semantic_map) > WHOLE:
        words += f" Of {len(semantic_map)} intersections those {len(likeness.rows)} that are the easiest to confuse."
    return f'<div class="two">{place("matrix-pwcv")}{place("matrix-cwc")}</div>{note(words)}'
