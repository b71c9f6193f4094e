"""One colour for one thing, in every figure, page and window; told apart by colour-blind eyes (Okabe and Ito)."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import cycle

INK, FAINT, LINE, WALL = "#1b1f24", "#5f6b76", "#d9dee3", "#aab4be"
ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PINK = (
    "#e69f00", "#56b4e9", "#009e73", "#f0e442", "#0072b2", "#d55e00", "#cc79a7",
)  # fmt: skip

SCALE = "cividis"
"""For everything that is a number: errors, heights, distances, similarities. Even to all kinds of eyes, and in grey."""

KINDS = {"L": SKY, "T": BLUE, "Y": GREEN, "X": ORANGE, "multi": PINK}
MARKS = {"L": "s", "T": "^", "Y": "v", "X": "D", "multi": "*"}
TRACKS = {"truth": INK, "trajectory": BLUE, "realtime": GREEN, "odometry": ORANGE}
STATES = {"unknown": LINE, "tracking": "#332288", "suspect": YELLOW, "lost": "#882255"}
"""Of no colour that a mode has: both are in the same figures (indigo and wine are of the scheme of Tol)."""
MODES = {"LIU": GREEN, "LIW": SKY, "LIO": ORANGE, "LIP": PINK}
MAP_CLOUD, LIVE_CLOUD = BLUE, ORANGE
"""A cloud of the database, and one of a robot laid onto it."""
PROVEN, ANCHOR = RED, PINK
"""What marks an accepted intersection, and where an anchor is proposed."""
RUNS = (BLUE, ORANGE, GREEN, PINK, SKY, RED, YELLOW)
"""Runs that are compared, in their order; in turn where there are more."""


def named(names: Iterable[str], known: dict[str, str]) -> dict[str, str]:
    """A colour for each name: its own where it has one, else one that is left."""
    names = list(dict.fromkeys(names))
    left = cycle([colour for colour in (YELLOW, BLUE, RED, SKY, PINK) if colour not in known.values()] or [FAINT])
    colours = {**dict(zip((name for name in names if name not in known), left, strict=False)), **known}
    return {name: colours[name] for name in names}
