"""The events of a run as tables and bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from tools.report.series import Band

Event = Mapping[str, Any]

MAX_ROWS = 3000
"""Rows in a page of one kind of event; `events.jsonl` has all."""

FIRST = ("id", "accepted", "reason", "before", "after", "why")
"""Columns that stand before the others."""

HIDDEN = ("stamp_ns", "kind", "overlay")


@dataclass(frozen=True, slots=True)
class EventTable:
    """Events of one kind: column names, which of them hold words, rows of cells; ``count`` of all there are."""

    kind: str
    columns: tuple[str, ...]
    words: tuple[bool, ...]
    rows: tuple[tuple[float | str, ...], ...]
    count: int


def event_tables(events: Sequence[Event], start_ns: int, most: int = MAX_ROWS) -> list[EventTable]:
    """One table a kind of event, in order of their first appearance."""
    kinds: dict[str, list[Event]] = {}
    for event in events:
        kinds.setdefault(str(event["kind"]), []).append(event)
    return [_event_table(kind, rows, start_ns, most) for kind, rows in kinds.items()]


def _event_table(kind: str, events: Sequence[Event], start_ns: int, most: int) -> EventTable:
    shown = events[:most]
    keys = dict.fromkeys(key for event in shown for key in event if key not in HIDDEN)
    columns = sorted(keys, key=lambda key: FIRST.index(key) if key in FIRST else len(FIRST))
    words = [any(isinstance(event.get(column), str | list | dict) for event in shown) for column in columns]
    rows = [
        (round((event["stamp_ns"] - start_ns) * 1e-9, 3), *(_number_or_cell(event.get(column)) for column in columns))
        for event in shown
    ]
    return EventTable(kind, ("time [s]", *columns), (False, *words), tuple(rows), len(events))


def _number_or_cell(value: object) -> float | str:
    """Numbers stay numbers, so that a table can be sorted by them."""
    if isinstance(value, float) and isfinite(value):
        return float(f"{value:.4g}")
    return value if type(value) is int else cell(value)


def cell(value: object) -> str:
    """A value of an event as text: numbers short, yes and no, lists with spaces, nothing for None."""
    match value:
        case None:
            return ""
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.1f}"
        case list():
            return ("; " if any(isinstance(one, dict) for one in value) else "  ").join(map(cell, value))
        case dict():
            return ", ".join(f"{key} {cell(one)}" for key, one in value.items())
        case _:
            return str(value)


def accepted_intersections(events: Sequence[Event]) -> list[int]:
    """Numbers of the intersections that a match was accepted for."""
    ids = {event["id"] for event in events if event.get("accepted") is True and isinstance(event.get("id"), int)}
    return sorted(ids)


def state_bands(events: Sequence[Event], start_ns: int, end_ns: int) -> dict[str, Sequence[Band]]:
    """Stretches of time in each state, from the events that say ``before`` and ``after``; one row a kind."""
    changes: dict[str, list[Event]] = {}
    for event in events:
        if "before" in event and "after" in event:
            changes.setdefault(str(event["kind"]), []).append(event)
    return {kind: _bands(rows, start_ns, end_ns) for kind, rows in changes.items()}


def _bands(changes: Sequence[Event], start_ns: int, end_ns: int) -> list[Band]:
    stamps = [start_ns, *(event["stamp_ns"] for event in changes), end_ns]
    names = [str(changes[0]["before"]), *(str(event["after"]) for event in changes)]
    times = [(stamp - start_ns) * 1e-9 for stamp in stamps]
    return [Band(start, end, name) for start, end, name in zip(times[:-1], times[1:], names, strict=True) if name]
