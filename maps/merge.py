"""Two surveys of one mine as one semantic map.

A is the database that is kept up, B the newer survey. Intersections of both that lie at one place are one, and keep A's
id; of each pair the better description is kept. What B alone shows is added. What the two do not agree on is listed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from textwrap import shorten
from typing import Literal

import numpy as np
from pydantic import Field, PositiveFloat

from maps.merge_roadways import MergedRoadways, merge_roadways
from maps.same_places import Candidates, Shift, candidates, one_to_one, shift_between
from maps.settings import MapSettings
from semmap.crs import same_crs
from semmap.errors import DatabaseError, SettingsError
from semmap.geometry import Array
from semmap.intersections import IntersectionColumns, IntersectionTable, SemanticMap
from semmap.settings import Settings, validate

Survey = Literal["A", "B"]

_COMPARED = ("contour", "free_space", "topology")
"""Blocks of the map settings that decide what is found and how it is described."""


class MergeSettings(Settings):
    """When intersections of two surveys are one, and in what they may differ.

    near, max_rise : intersections nearer than this in plan and in height, the shift taken out, are one [m].
    max_shift : how far the surveys may lie apart as a whole [m].
    min_similarity : least similarity of contours that agree.
    max_bearing_deg : greatest difference of the bearings of one branch.
    max_move : greatest distance of two that agree, the shift of the surveys taken out [m].
    min_gain : where the surveys agree, B's description replaces A's if its quality is better by this.
    max_loss : where they do not, the one that shows more branches is kept, or B's, being newer, unless its quality is
        worse by this.
    """

    near: PositiveFloat = 5.0
    max_rise: PositiveFloat = 2.0
    max_shift: PositiveFloat = 3.0
    min_similarity: PositiveFloat = Field(default=0.6, le=1.0)
    max_bearing_deg: PositiveFloat = 25.0
    max_move: PositiveFloat = 1.0
    min_gain: PositiveFloat = 0.05
    max_loss: PositiveFloat = 0.15


@dataclass(frozen=True, slots=True)
class Pair:
    """One intersection that both surveys show.

    id : in A and in the merged map; id_b : in B.
    similarity : of the contours (CWC), with north kept north.
    distance : between the invariant points, the shift of the surveys taken out [m].
    differences : what they do not agree on, in words; empty where they agree.
    kept, why : whose description the merged map has.
    """

    id: int
    id_b: int
    similarity: float
    distance: float
    differences: str
    kept: Survey
    why: str


@dataclass(frozen=True, slots=True, eq=False)
class Conflict:
    """Something on which the surveys do not agree.

    id : in the merged map, id_b : in B; -1 where there is no intersection. p_map : (3,) where [m].
    what : it is; kept : what the merged map has, and why.
    """

    id: int
    id_b: int
    p_map: Array
    what: str
    kept: str


@dataclass(frozen=True, slots=True, eq=False)
class MergeResult:
    """The merged map and how it came about.

    pairs : intersections that both surveys show.
    added : (id in B, id in the merged map) of intersections that only B shows.
    added_roadways : length of the roadways that only B shows [m].
    shift : of the surveys, None where too few intersections agree to tell. aligned : whether B was moved by it.
    """

    map: SemanticMap
    pairs: tuple[Pair, ...]
    added: tuple[tuple[int, int], ...]
    added_roadways: float
    conflicts: tuple[Conflict, ...]
    shift: Shift | None
    aligned: bool


def merge_maps(
    a: SemanticMap, b: SemanticMap, settings: MergeSettings | None = None, *, align: bool = False
) -> MergeResult:
    """Merge survey B into survey A, both in one map frame.

    align : move all of B by the shift between the surveys; otherwise it is found and reported, and B stays.

    Raises
    ------
    DatabaseError
        Where the maps are in other frames or coordinate systems, or made with other settings.
    SettingsError
        Where B shall be aligned and too few intersections agree to say how.
    """
    settings = settings or MergeSettings()
    map_settings = _common_settings(a, b)
    tables = IntersectionTable.of(a.intersections), IntersectionTable.of(b.intersections)
    reach = float(np.hypot(settings.near, settings.max_rise)) + settings.max_shift
    near = candidates(*tables, reach, map_settings.contour)
    shift = shift_between(near, settings.max_shift)
    if align and shift is None:
        raise SettingsError("too few intersections agree to tell the shift", field="align", mend="merge without it")
    offset = shift.offset if shift is not None and shift.significant else np.zeros(3)
    applied = offset if align else np.zeros(3)
    matched = _matched(near, offset, settings)
    pairs = _pairs(*tables, matched, settings)
    table, id_of_b = _merged_table(*tables, matched, pairs, applied)
    roadways = merge_roadways(
        a.roadways,
        b.roadways,
        id_of_b,
        dict(zip(table.columns.id.tolist(), table.columns.p_map, strict=True)),
        shift=offset,
        applied=applied,
        min_branch=map_settings.topology.min_branch,
    )
    return MergeResult(
        map=replace(
            a,
            intersections=table,
            roadways=roadways.graph,
            sources=_joined_sources(a.sources, b.sources),
            crs=a.crs or b.crs,
        ),
        pairs=pairs,
        added=tuple(list(id_of_b.items())[len(pairs) :]),
        added_roadways=roadways.added,
        conflicts=_conflicts(pairs, table.columns, roadways),
        shift=shift,
        aligned=align,
    )


def _common_settings(a: SemanticMap, b: SemanticMap) -> MapSettings:
    """The settings both maps were made with; raises `DatabaseError` that names what differs."""
    if a.frame != b.frame:
        raise DatabaseError(f"is {b.frame!r} in B and {a.frame!r} in A", field="frame", mend="use one map frame")
    if a.crs and b.crs and not same_crs(a.crs, b.crs):
        raise DatabaseError(
            f"is {shorten(b.crs, 60)} in B and {shorten(a.crs, 60)} in A", field="crs", mend="build both in one system"
        )
    made_a, made_b = (validate(MapSettings, dict(m.settings), file=None, error=DatabaseError) for m in (a, b))
    for block in _COMPARED:
        values_a, values_b = getattr(made_a, block).model_dump(), getattr(made_b, block).model_dump()
        for name in values_a:
            if values_a[name] != values_b[name]:
                what = f"is {values_b[name]} in B and {values_a[name]} in A"
                raise DatabaseError(what, field=f"settings.{block}.{name}", mend="build both with the same settings")
    return made_a


def _matched(near: Candidates, offset: Array, settings: MergeSettings) -> Candidates:
    """The pairs that are one intersection, once B lies on A."""
    moved = replace(near, offset=near.offset - offset)
    aside, rise = np.hypot(*moved.offset[:, :2].T), np.abs(moved.offset[:, 2])
    return one_to_one(moved.where((aside < settings.near) & (rise < settings.max_rise)), settings.near)


def _pairs(a: IntersectionTable, b: IntersectionTable, matched: Candidates, s: MergeSettings) -> tuple[Pair, ...]:
    pairs = []
    rows = zip(matched.row_a.tolist(), matched.row_b.tolist(), matched.offset, matched.similarity.tolist(), strict=True)
    for i, j, offset, similarity in rows:
        differences = "; ".join(_differences(a.columns, i, b.columns, j, offset, similarity, s))
        qualities = float(a.columns.quality[i]), float(b.columns.quality[j])
        more = int(b.columns.branch_counts[j] - a.columns.branch_counts[i])
        kept, why = _chosen(*qualities, more, s) if differences else _better(*qualities, s)
        ids = int(a.columns.id[i]), int(b.columns.id[j])
        pairs.append(Pair(*ids, similarity, float(np.linalg.norm(offset)), differences, kept, why))
    return tuple(pairs)


def _differences(
    a: IntersectionColumns,
    i: int,
    b: IntersectionColumns,
    j: int,
    offset: Array,
    similarity: float,
    settings: MergeSettings,
) -> list[str]:
    """What an intersection is in one survey and not in the other; with other branches it looks and lies elsewhere."""
    bearings_a, bearings_b = a.bearings(i), b.bearings(j)
    if len(bearings_a) != len(bearings_b):
        return [f"{a.kind[i]} with {len(bearings_a)} branches in A, {b.kind[j]} with {len(bearings_b)} in B"]
    differences = []
    if _turn(bearings_a, bearings_b) > np.radians(settings.max_bearing_deg):
        differences.append(f"branches at {_degrees(bearings_a)} in A, at {_degrees(bearings_b)} in B")
    elif a.kind[i] != b.kind[j]:
        differences.append(f"{a.kind[i]} in A, {b.kind[j]} in B")
    if similarity < settings.min_similarity:
        differences.append(f"walls differ (similarity {similarity:.2f})")
    if np.linalg.norm(offset) > settings.max_move:
        differences.append(f"{float(np.linalg.norm(offset)):.1f} m from A's place in B ({directions(-offset)})")
    return differences


def _turn(a: Array, b: Array) -> float:
    """Greatest difference [rad] of bearings (n,) and (n,), matched in the order around that makes it least."""
    if not len(a):
        return 0.0
    turned = np.stack([np.roll(b, k) for k in range(len(b))]) - a
    return float(np.abs(np.angle(np.exp(1j * turned))).max(axis=1).min())


def _degrees(bearings: Array) -> str:
    return " ".join(f"{value:.0f}°" for value in np.degrees(bearings))


def directions(move: Array) -> str:
    """A displacement (3,) [m] in words, x being east and y north."""
    names = (("east", "west"), ("north", "south"), ("up", "down"))
    parts = [f"{abs(m):.2f} m {pair[m < 0]}" for m, pair in zip(move.tolist(), names, strict=True) if abs(m) >= 0.005]
    return ", ".join(parts) or "nowhere"


def _better(quality_a: float, quality_b: float, settings: MergeSettings) -> tuple[Survey, str]:
    """Which of two descriptions that agree is kept, and why."""
    if quality_b > quality_a + settings.min_gain:
        return "B", f"seen better, quality {quality_b:.2f} against {quality_a:.2f}"
    return "A", "the surveys agree"


def _chosen(quality_a: float, quality_b: float, more: int, settings: MergeSettings) -> tuple[Survey, str]:
    """Which of two that contradict each other, B with so many branches ``more``: surveys often do not show all
    roadways, and roadways are rarely filled in."""
    preferred: Survey = "A" if more < 0 else "B"
    why = "shows more branches" if more else "newer"
    quality, other = (quality_b, quality_a) if preferred == "B" else (quality_a, quality_b)
    if quality < other - settings.max_loss:
        return ("A" if preferred == "B" else "B"), f"seen much better, quality {other:.2f} against {quality:.2f}"
    return preferred, f"{why}, quality {quality:.2f} against {other:.2f}"


def _merged_table(
    a: IntersectionTable, b: IntersectionTable, matched: Candidates, pairs: tuple[Pair, ...], applied: Array
) -> tuple[IntersectionTable, dict[int, int]]:
    """A's intersections in their order, then those that only B shows, under new ids; and the id of each of B's."""
    rows = np.arange(len(a))
    from_b = np.array([pair.kept == "B" for pair in pairs], np.bool_)
    rows[matched.row_a[from_b]] = len(a) + matched.row_b[from_b]
    new = np.setdiff1d(np.arange(len(b)), matched.row_b)
    fresh = int(a.columns.id.max(initial=-1)) + 1 + np.arange(len(new))
    ids = np.concatenate([a.columns.id, fresh])
    table = a.joined(b).take(np.concatenate([rows, len(a) + new]))
    moved = np.concatenate([rows >= len(a), np.ones(len(new), np.bool_)])
    columns = replace(table.columns, id=ids, p_map=table.columns.p_map + moved[:, None] * applied)
    known = {pair.id_b: pair.id for pair in pairs}
    return table.with_columns(columns), known | dict(zip(b.columns.id[new].tolist(), fresh.tolist(), strict=True))


def _joined_sources(a: Mapping[str, str], b: Mapping[str, str]) -> dict[str, str]:
    """The source files of both; one of B's with the name but not the content of one of A's is numbered."""
    joined = dict(a)
    for name, digest in b.items():
        names = [name, *(f"{name} ({k})" for k in range(2, len(a) + len(b) + 2))]
        free = next(one for one in names if joined.get(one, digest) == digest)
        joined[free] = digest
    return joined


def _conflicts(pairs: tuple[Pair, ...], columns: IntersectionColumns, roadways: MergedRoadways) -> tuple[Conflict, ...]:
    place = dict(zip(columns.id.tolist(), columns.p_map, strict=True))
    found = [
        Conflict(pair.id, pair.id_b, place[pair.id], pair.differences, f"{pair.kept}'s: {pair.why}")
        for pair in pairs
        if pair.differences
    ]
    found += [
        Conflict(
            id, -1, place[id], "a roadway of B passes and shows no intersection", "A's: B may not show its branches"
        )
        for id in roadways.passed
    ]
    what = "roadways of A and B meet and neither shows an intersection"
    return (
        *found,
        *(
            Conflict(-1, -1, p, what, "the roadways, joined; build the map from both surveys")
            for p in roadways.meetings
        ),
    )
