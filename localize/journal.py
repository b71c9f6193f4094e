"""What happened in a run: events, counts, and the state of the place in the map."""

from __future__ import annotations

from typing import Any

from localize.results import Event, Overlay, State


class Journal:
    """Written by whoever decides something.

    Attributes
    ----------
    events : in order of time. counts : by name. recognised : ids of the intersections that were proven.
    state : of the place in the map, see `Update`. overlays : what the ICP checks compared.
    """

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.overlays: list[Overlay] = []
        self.counts: dict[str, int] = {
            "scans": 0,
            "keyframes": 0,
            "intersections_seen": 0,
            "intersections_found": 0,
            "pins": 0,
            "range_doubts": 0,
        }
        self.recognised: set[int] = set()
        self.state: State = "unknown"

    def event(self, stamp_ns: int, kind: str, **data: Any) -> None:
        """Something happened."""
        self.events.append({"stamp_ns": int(stamp_ns), "kind": kind, **data})

    def enter(self, state: State, stamp_ns: int, why: str) -> None:
        """The place in the map is now in this state."""
        if state != self.state:
            self.event(stamp_ns, "state", before=self.state, after=state, why=why)
            self.state = state
