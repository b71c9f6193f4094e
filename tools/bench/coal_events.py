"""What our runs through the coal tunnel told: where the mode changed, and which directions they held for degenerate."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from semmap.trajectory import Trajectory
from tools import metrics
from tools.bench.coal_runs import outer_alignment

AXIS = np.array([1.0, 0.0, 0.0])
"""The tunnel's, in the map."""


@dataclass(frozen=True, slots=True)
class Boundary:
    """A change of mode: seconds after the first pose, and the true x [m] there."""

    seconds: float
    x: float
    before: str
    after: str


def boundaries(run: Path, truth: Trajectory) -> Iterator[Boundary]:
    """The changes of mode of a run directory."""
    for event in _events(run, "mode"):
        stamp = np.array([event["stamp_ns"]], np.int64)
        x = float(truth.at(np.clip(stamp, truth.stamps_ns[0], truth.stamps_ns[-1]))[0, 0, 3])
        yield Boundary((event["stamp_ns"] - truth.stamps_ns[0]) * 1e-9, x, event["before"], event["after"])


def axis_errors_deg(run: Path, truth: Trajectory) -> Iterator[float]:
    """Angles [deg] between the directions of translation that were told to be degenerate and the tunnel's axis."""
    odometry = Trajectory.load_tum(run / "odometry.tum")
    R_map_odom = outer_alignment(metrics.associate(odometry, truth))[:3, :3]
    for event in _events(run, "degenerate"):
        if "direction_odom" in event:
            cosine = abs(float(AXIS @ R_map_odom @ np.array(event["direction_odom"])))
            yield float(np.degrees(np.arccos(min(1.0, cosine))))


def _events(run: Path, kind: str) -> Iterator[dict[str, Any]]:
    for line in (run / "events.jsonl").read_text(encoding="utf-8").splitlines():
        event = json.loads(line)
        if event["kind"] == kind:
            yield event
