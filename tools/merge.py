"""Two database files into one, with a record of what came of it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from maps.merge import Conflict, MergeResult, directions, merge_maps
from semmap import database
from semmap.errors import DatabaseError
from tools.files import writable_file, write_text
from tools.settings import ToolSettings
from tools.tables import text_table

CONFLICT_HEAD = ("the surveys differ in", "kept", "id", "id in B", "x [m]", "y [m]", "z [m]")
CONFLICTS_SHOWN = 40
"""The terminal shows no more of them; the record has all."""


def merge_databases(
    file_a: Path, file_b: Path, out: Path, settings: ToolSettings, *, align: bool, record: Path | None
) -> tuple[MergeResult, Path]:
    """Merge ``file_b`` into ``file_a``, save the map to ``out`` and what came of it to ``record`` (or beside ``out``).

    Returns the result and where its record is.
    """
    record = record or out.with_suffix(".merge.json")
    writable_file(out)
    writable_file(record)
    a, b = database.load(file_a), database.load(file_b)
    try:
        result = merge_maps(a, b, settings.merge, align=align)
    except DatabaseError as error:
        file = error.file or f"{file_b} (B) and {file_a} (A)"
        raise DatabaseError(error.what, file=file, field=error.field, mend=error.mend) from None
    database.save(result.map, out)
    write_text(record, json.dumps(_plain(result, file_a, file_b), indent=1, ensure_ascii=False) + "\n")
    return result, record


def _plain(result: MergeResult, file_a: Path, file_b: Path) -> Mapping[str, Any]:
    """All that a merge found, as plain data."""
    shift = result.shift
    return {
        "a": str(file_a),
        "b": str(file_b),
        "shift_b_to_a_m": None if shift is None else shift.offset.round(4).tolist(),
        "shift_std_m": None if shift is None else shift.std.round(4).tolist(),
        "aligned": result.aligned,
        "pairs": [
            {
                "id": pair.id,
                "id_b": pair.id_b,
                "similarity": round(pair.similarity, 4),
                "distance_m": round(pair.distance, 4),
                "differences": pair.differences,
                "kept": pair.kept,
                "why": pair.why,
            }
            for pair in result.pairs
        ],
        "added": [{"id": id, "id_b": id_b} for id_b, id in result.added],
        "added_roadways_m": round(result.added_roadways, 2),
        "conflicts": [_conflict(one) for one in result.conflicts],
    }


def _conflict(one: Conflict) -> dict[str, Any]:
    return {"id": one.id, "id_b": one.id_b, "p_map": one.p_map.round(3).tolist(), "what": one.what, "kept": one.kept}


def print_merge(result: MergeResult, record: Path) -> None:
    """Print how the surveys lie to each other, and where they do not agree."""
    console = Console(highlight=False, markup=False, soft_wrap=True)
    console.print(shift_line(result))
    if result.conflicts:
        shown = result.conflicts[:CONFLICTS_SHOWN]
        Console().print(text_table(CONFLICT_HEAD, [_row(one) for one in shown], left=2))
        if len(result.conflicts) > len(shown):
            console.print(f"and {len(result.conflicts) - len(shown)} more, see {record}")


def _row(one: Conflict) -> list[str]:
    ids = [str(id) if id >= 0 else "–" for id in (one.id, one.id_b)]
    return [one.what, one.kept, *ids, *(f"{value:.1f}" for value in one.p_map)]


def shift_line(result: MergeResult) -> str:
    """One sentence on how B lies to A."""
    shift = result.shift
    if shift is None:
        return "too few intersections agree to tell whether B is shifted"
    sure = f"(± {max(shift.std):.2f} m, {shift.pairs} intersections)"
    if not shift.significant:
        return f"B lies on A {sure}"
    if result.aligned:
        return f"B was moved by {directions(shift.offset)} onto A {sure}"
    return f"B is shifted by {directions(-shift.offset)} {sure}; it was left there, --align moves it onto A"


def outcome(result: MergeResult) -> str:
    """One sentence on what came of a merge."""
    return (
        f"{len(result.map)} intersections: {len(result.pairs)} in both, {len(result.added)} new, "
        f"{result.added_roadways:.0f} m of new roadways, {len(result.conflicts)} conflicts"
    )
