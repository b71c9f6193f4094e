"""What recognition and the graph cost, and whether they hold up a scan.

    python -m tools.bench.localize_times --map MINE.h5 --mesh MINE.ply --route WAYPOINTS.csv --cache DIR --out DIR

The recording is that of `tools.bench.odometry --recording mesh`. First the whole of it as fast as it goes: milliseconds
of a keyframe's recognition (detect, describe, match, ICP) and of a step of the graph, by the clock and of the thread's
own processor, the graph also by how many keyframes it has. Then ``--seconds`` of it at its own pace, as a robot would
have it, with the map and by the odometry alone, by turns: milliseconds inside the call that completes a scan.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from localize import Localizer, LocalizeSettings
from localize.matcher import IntersectionMatcher
from localize.settings import LoopSettings
from localize.track import Track
from semmap import database
from semmap.intersections import SemanticMap
from semmap.measurements import ImuSample, Measurement, Scan
from semmap.rig import Rig
from tools.bench.edgar import measurements, recording_arguments, recording_of
from tools.bench.odometry_cache import Recorded
from tools.files import write_text
from tools.tables import text_table

BY_KEYFRAMES = 1000
HEAD = ("", "n", "median ms", "p95", "most", "processor ms, median")


class Stopwatch:
    """Times every call of a method while it is entered: ``rows`` of (clock ms, processor ms, what ``told`` says)."""

    def __init__(self, owner: type, name: str, told: Callable[[Any], int] = lambda _: 0) -> None:
        self._owner, self._name, self._told, self._method = owner, name, told, getattr(owner, name)
        self.rows: list[tuple[float, float, int]] = []

    def __enter__(self) -> Stopwatch:
        setattr(self._owner, self._name, lambda that, *given, **named: self._timed(that, *given, **named))
        return self

    def __exit__(self, *_: object) -> None:
        setattr(self._owner, self._name, self._method)

    def _timed(self, that: Any, *given: Any, **named: Any) -> Any:
        clock, processor = time.perf_counter(), time.thread_time()
        found = self._method(that, *given, **named)
        spent = (1e3 * (time.perf_counter() - clock), 1e3 * (time.thread_time() - processor))
        self.rows.append((*spent, self._told(that)))
        return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--map", type=Path, required=True, help="the database")
    recording_arguments(parser)
    parser.add_argument("--seconds", type=float, default=60.0, help="at its own pace, twice each")
    parser.add_argument("--out", type=Path, default=Path("bench_times"))
    options = parser.parse_args()
    flight = recording_of(options)
    there = database.load(options.map)
    rows = [*replayed(flight, there), *at_its_pace(flight, there, options.seconds)]
    Console().print(text_table(HEAD, [[str(cell) for cell in row.values()] for row in rows]))
    options.out.mkdir(parents=True, exist_ok=True)
    write_text(options.out / "times.json", json.dumps(rows, indent=1) + "\n")


def replayed(flight: Recorded, there: SemanticMap) -> list[dict[str, Any]]:
    """Recognition of the keyframes, and steps of the graph: all, and by its thousands of keyframes."""
    localizer = Localizer(Rig.model_validate(flight.about["rig"]), there)
    with (
        Stopwatch(IntersectionMatcher, "recognise") as recognition,
        Stopwatch(Track, "solve", lambda track: len(track.graph)) as steps,
    ):
        for measurement in measurements(flight):
            localizer.add(measurement)
        localizer.finish()
    rows = [_row("recognition of a keyframe", recognition.rows), _row("step of the graph", steps.rows)]
    most = max((keyframes for *_, keyframes in steps.rows), default=0)
    for first in range(0, most, BY_KEYFRAMES):
        part = [row for row in steps.rows if first <= row[2] < first + BY_KEYFRAMES]
        if part:
            rows.append(_row(f"  of {first} to {first + BY_KEYFRAMES} keyframes", part))
    return rows


def at_its_pace(flight: Recorded, there: SemanticMap, seconds: float) -> list[dict[str, Any]]:
    """The call that completes a scan, with recognition beside it and without, by turns."""
    alone = LocalizeSettings(loops=LoopSettings(close=False))
    costs: dict[str, list[tuple[float, float, int]]] = {"scan with the map": [], "scan by odometry alone": []}
    for _ in range(2):
        costs["scan with the map"] += _paced(Localizer(Rig.model_validate(flight.about["rig"]), there), flight, seconds)
        odometry = Localizer(Rig.model_validate(flight.about["rig"]), None, alone)
        costs["scan by odometry alone"] += _paced(odometry, flight, seconds)
    return [_row(name, spent) for name, spent in costs.items()]


def _paced(localizer: Localizer, flight: Recorded, seconds: float) -> list[tuple[float, float, int]]:
    """What each scan cost, by the clock and of this thread's processor [ms], played as it was recorded."""
    spent, began, first_ns = [], time.monotonic(), int(flight.imu_ns[0])
    for measurement in takewhile(lambda one: _due_ns(one) - first_ns < seconds * 1e9, measurements(flight)):
        time.sleep(max(0.0, (_due_ns(measurement) - first_ns) * 1e-9 - (time.monotonic() - began)))
        clock, processor = time.perf_counter(), time.thread_time()
        if localizer.add(measurement) is not None:
            spent.append((1e3 * (time.perf_counter() - clock), 1e3 * (time.thread_time() - processor), 0))
    localizer.finish()
    return spent


def _due_ns(measurement: Measurement) -> int:
    """When a driver hands it over."""
    assert isinstance(measurement, Scan | ImuSample)
    return measurement.end_ns if isinstance(measurement, Scan) else measurement.stamp_ns


def _row(name: str, rows: list[tuple[float, float, int]]) -> dict[str, Any]:
    clock, processor = np.array([row[:2] for row in rows]).reshape(-1, 2).T
    quantiles = np.percentile(clock, [50, 95, 100]).round(2).tolist()
    return {"what": name, "n": len(rows), "median": quantiles[0], "p95": quantiles[1], "most": quantiles[2],
            "processor": round(float(np.median(processor)), 2)}  # fmt: skip


if __name__ == "__main__":
    main()
