"""The mode is a pure function of state and evidence, and does not chatter."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from localize.modes import Evidence, Latch, ModeState, next_mode
from localize.settings import ModeSettings

SETTINGS = ModeSettings()
STEP_NS = 100_000_000
DEGENERATE = Evidence(0, wheel=True, degree=3.0)


def run(evidence, *, state=None, lidar=True):
    """States after each piece of evidence, a tenth of a second apart."""
    states = []
    state = state or ModeState()
    for k, one in enumerate(evidence):
        state = next_mode(state, replace(one, stamp_ns=k * STEP_NS), SETTINGS, lidar=lidar)
        states.append(state)
    return states


@pytest.mark.parametrize(
    ("evidence", "mode"),
    [
        (Evidence(0), "LIO"),
        (Evidence(0, wheel=True), "LIO"),
        (Evidence(0, degree=1.0), "LIO"),
        (Evidence(0, wheel=True, degree=1.0), "LIW"),
        (Evidence(0, anchors=4, wheel=True, degree=9.0), "LIU"),
        (Evidence(0, anchors=4, outside=0.9), "LIU"),
        (Evidence(0, anchors=4, outside=1.01, wheel=True, degree=2.0), "LIW"),
        (Evidence(0, anchors=1), "LIO"),
        (Evidence(0, prism=True, anchors=4), "LIP"),
    ],
)
def test_the_first_evidence_counts_at_once(evidence, mode):
    assert run([evidence])[-1].mode == mode


@pytest.mark.parametrize(
    ("evidence", "mode"), [(Evidence(0), "IO"), (Evidence(0, wheel=True), "IW"), (Evidence(0, anchors=3), "IU")]
)
def test_without_lidar(evidence, mode):
    assert run([evidence], lidar=False)[-1].mode == mode


def test_out_of_the_anchors_sphere_into_a_tunnel_is_one_change():
    inside = [replace(DEGENERATE, anchors=4, outside=o) for o in np.linspace(0.5, 1.0, 40)]
    beyond = [replace(DEGENERATE, anchors=2, outside=o) for o in np.linspace(1.0, 1.5, 60)]
    silent = [replace(DEGENERATE, outside=1.5)] * 60
    modes = [state.mode for state in run([*inside, *beyond, *silent])]
    assert [a for a, b in pairwise(modes) if a != b] == ["LIU"] and modes[-1] == "LIW"


def test_a_wobble_about_every_limit_changes_nothing():
    rng = np.random.default_rng(1)
    low = 1.0 / (1.0 + SETTINGS.slack)
    evidence = [
        Evidence(0, 2 - int(rng.integers(2)), rng.uniform(0.99, 1.0 + SETTINGS.slack), False, True, degree)
        for degree in rng.uniform(low, 1.5, size=500)
    ]
    start = run([Evidence(0, anchors=3, wheel=True, degree=2.0)])[0]
    assert {state.mode for state in run(evidence, state=start)} == {"LIU"}


@pytest.mark.parametrize("seed", range(20))
def test_no_chatter_whatever_the_evidence(seed):
    """A conclusion, once changed, stays for the dwell time; so there are few changes of mode in any stretch."""
    rng = np.random.default_rng(seed)
    stay = rng.uniform(0.5, 0.99)
    evidence, now = [], Evidence(0)
    for _ in range(600):
        if rng.uniform() > stay:
            now = Evidence(
                0, int(rng.integers(0, 5)), rng.choice([None, rng.uniform(0.5, 1.5)]), bool(rng.integers(2)),
                bool(rng.integers(2)), rng.uniform(0.0, 2.0),
            )  # fmt: skip
        evidence.append(now)
    states = run(evidence)
    dwell = round(SETTINGS.dwell_s * 1e9 / STEP_NS)
    for name in ("prism", "uwb", "wheel", "degenerate"):
        latches = [getattr(state, name).on for state in states]
        changes = [k for k, (a, b) in enumerate(pairwise(latches)) if a != b]
        assert all(b - a >= dwell for a, b in pairwise(changes))
    assert states == run(evidence)
    assert {state.mode for state in states} <= {"LIP", "LIU", "LIW", "LIO"}


def test_a_latch_waits_for_evidence_without_a_break():
    latch = Latch()
    for k, on in enumerate([True] * 9 + [False] + [True] * 10):
        latch = latch.seen(on, k * STEP_NS, 1.0)
    assert not latch.on and latch.seen(True, 20 * STEP_NS, 1.0).on
