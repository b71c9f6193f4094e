"""Which sensors hold the pose at the moment, in paper 000's letters: LIO, LIU, LIW and their unions."""

from __future__ import annotations

from collections.abc import Mapping

HOLD_NS = 2_000_000_000
"""A sensor that said nothing for this long no longer counts."""
_LETTERS = {"uwb": "U", "wheel": "W", "prism": "P"}


def mode_of(stamp_ns: int, last_used_ns: Mapping[str, int], *, lidar: bool) -> str:
    """Name of the mode at ``stamp_ns`` given when each of ``uwb``, ``wheel``, ``prism`` was last used.

    ``LI`` (``I`` without a LiDAR) and a letter for each sensor heard lately; ``LIO`` where there is none.
    """
    heard = [
        letter
        for sensor, letter in _LETTERS.items()
        if sensor in last_used_ns and stamp_ns - last_used_ns[sensor] < HOLD_NS
    ]
    return ("LI" if lidar else "I") + ("".join(heard) or "O")
