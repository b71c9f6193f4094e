"""The mode is a pure function of what was heard lately."""

import pytest

from localize.modes import HOLD_NS, mode_of


@pytest.mark.parametrize(
    ("last", "mode"),
    [
        ({}, "LIO"),
        ({"uwb": 9 * HOLD_NS + 1}, "LIU"),
        ({"wheel": 9 * HOLD_NS + 1, "uwb": 8 * HOLD_NS}, "LIW"),
        ({"wheel": 10 * HOLD_NS - 1, "uwb": 10 * HOLD_NS}, "LIUW"),
        ({"prism": 10 * HOLD_NS}, "LIP"),
    ],
)
def test_modes(last, mode):
    assert mode_of(10 * HOLD_NS, last, lidar=True) == mode


def test_without_lidar():
    assert mode_of(0, {}, lidar=False) == "IO"
