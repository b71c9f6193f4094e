"""How far a simulation is: `Progress` is called with steps done and steps in all."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[int, int], None]
PERCENT = 100


def ignored(_done: int, _total: int) -> None:
    """The progress nobody watches."""


def part(progress: Progress, start: int, end: int) -> Progress:
    """A progress for the part of the whole from ``start`` to ``end`` percent."""
    return lambda done, total: progress(start + (end - start) * done // total, PERCENT)
