"""Real UWB ranges with ground truth, through the same models, check and filter as `localize` uses.

`python -m tools.bench.uwb_real DATA --json FILE --figures DIR`, where DATA holds ``walks/`` (a pedestrian with a tag,
four anchors on a vehicle, in line of sight and blocked) and ``plaza1/`` (a mower with odometry, four radio beacons).
Everything is estimated on line: a pose knows only what was measured before it.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localize.filter import ErrorStateFilter
from localize.motion import coast, follow, tracker
from localize.range_check import Verdict
from localize.ranging import Ranging
from localize.settings import RangeSettings
from localize.tag_locator import TagLocator
from localize.tag_position import TagFix
from localize.uwb import TagPosition, tag_in_map
from semmap.geometry import Array, yaw_rotation
from semmap.measurements import UwbRange
from semmap.rig import UwbBlock

SETTINGS = RangeSettings()
"""The defaults, for every recording."""
CASES = ("los/Case_1", "los/Case_2", "nlos/Case_1", "nlos/Case_2")
WALK_ANCHORS = (3, 5, 9, 12)
TAG_HEIGHT_M, TAG_HEIGHT_STD = 1.0, 0.15
"""The walkers carried the tag at this height on a level court, which the authors' own evaluation knows as well."""
WALKER = np.array([0.5, 0.5, 0.05])
"""How people start, stop and turn [m/s²/√Hz]."""
WALKING = np.array([1.0, 1.0, 0.1])
"""How fast they may be going at the start [m/s]."""
_START_STD = 1.0
"""A filter starts at a fix no worse than this [m]."""
_FEET_NS = 1_000_000_000
"""How often the height is said again."""
BEACONS = {"range_std": 0.5, "bias_std": 1.0, "scale_std": 0.1}
"""The mower's radios: uncalibrated."""
_STEP_STD = 0.02
"""Of the mower's odometry, along and across, for a metre [m]."""
_TURN_STD = 0.001
"""Of its gyroscope, for a step [rad]."""


@dataclass(slots=True)
class Track:
    """Positions (n, 3) at ``stamps`` (n,), and what was refused of each anchor on the way, and why."""

    stamps: list[int] = field(default_factory=list)
    p_map: list[Array] = field(default_factory=list)
    refused: list[dict[str, Any]] = field(default_factory=list)
    heard: dict[int, list[int]] = field(default_factory=dict)
    late: int = 0

    def note(self, reading: UwbRange, verdict: Verdict | None) -> None:
        if verdict is None or not verdict.refused:
            self.heard.setdefault(reading.anchor, []).append(reading.stamp_ns)
            return
        self.refused.append(
            {
                "stamp_ns": reading.stamp_ns,
                "anchor": reading.anchor,
                "why": verdict.refused,
                "off_m": verdict.innovation,
            }
        )

    def add(self, stamp_ns: int, p_map: Array) -> None:
        self.stamps.append(stamp_ns)
        self.p_map.append(p_map.copy())

    def counts(self) -> dict[str, int]:
        return dict(sorted(Counter(f"{r['anchor']} {r['why']}" for r in self.refused).items()))

    def unheard(self, longest_s: float) -> list[dict[str, float]]:
        """Stretches longer than this in which an anchor gave nothing that could be used, though others did [s]."""
        if not self.heard:
            return []
        begin, end = self.stamps[0], self.stamps[-1]
        found = []
        for anchor, stamps in sorted(self.heard.items()):
            edges = np.array([begin, *stamps, end], np.int64)
            for k in np.flatnonzero(np.diff(edges) > longest_s * 1e9):
                found.append(
                    {"anchor": anchor, "from_s": (edges[k] - begin) * 1e-9, "to_s": (edges[k + 1] - begin) * 1e-9}
                )
        return found


# --- walks


@dataclass(frozen=True, slots=True)
class Walk:
    """One case: reference (n, 3) at stamps (n,), the radios, readings in time order, and the authors' own tracks."""

    stamps: NDArray[np.int64]
    truth: Array
    block: UwbBlock
    readings: list[UwbRange]
    theirs: dict[str, tuple[NDArray[np.int64], Array]]


def read_walk(path: Path) -> Walk:
    """Read one case's directory."""
    stamps, truth = _positions(path / "trajectory.csv")
    anchors: dict[int, tuple[float, float, float]] = {}
    readings = []
    for anchor in WALK_ANCHORS:
        rows = np.genfromtxt(path / f"A{anchor}.csv", delimiter=",", skip_header=1, usecols=range(3, 7))
        own = np.genfromtxt(path / f"A{anchor}.csv", delimiter=",", skip_header=1, usecols=1, dtype=np.int64)
        anchors[anchor] = (float(rows[0, 0]), float(rows[0, 1]), float(rows[0, 2]))
        readings += [UwbRange(int(stamp), anchor, float(row[3])) for stamp, row in zip(own, rows, strict=True)]
    block = UwbBlock(topic="", p_imu_tag=(0.0, 0.0, 0.0), anchors=anchors)
    readings.sort(key=lambda reading: reading.stamp_ns)
    return Walk(stamps, truth, block, readings, {name: _positions(path / f"{name}.csv") for name in ("LS", "ESKF")})


def _positions(path: Path) -> tuple[NDArray[np.int64], Array]:
    values = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=range(4))
    # their stamps are written in two ways, one of them as a floating number of nanoseconds
    stamps = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=0).astype(np.int64)
    return stamps, values[:, 1:]


def rmse(walk: Walk, stamps: NDArray[np.int64], p_map: Array) -> tuple[float, float]:
    """Errors in space and in the plane [m], by the authors' rule.

    From the farthest corner (x > 49.3 m) until the walker is back at x <= 12 m on the other side (y > 3.4 m), where the
    reference is within half a metre of level; the tag is a metre above the reference, which is interpolated.
    """
    x, y, z = walk.truth.T
    first = int(np.flatnonzero((x > 49.3) & (y > -5.0))[0])
    last = first + int(np.flatnonzero((x[first:] <= 12.0) & (y[first:] > 3.4))[0])
    begin, end = walk.stamps[first], walk.stamps[last]
    level = (walk.stamps >= begin) & (walk.stamps <= end) & (np.abs(z) < 0.5)
    at = (stamps >= begin) & (stamps <= end)
    off = p_map[at] - [0.0, 0.0, TAG_HEIGHT_M]
    for axis in range(3):
        off[:, axis] -= np.interp(
            (stamps[at] - begin).astype(float), (walk.stamps[level] - begin).astype(float), walk.truth[level, axis]
        )
    squared = np.sum(off**2, axis=1), np.sum(off[:, :2] ** 2, axis=1)
    return float(np.sqrt(squared[0].mean())), float(np.sqrt(squared[1].mean()))


def by_ranges_alone(walk: Walk) -> Track:
    """Fixes of the position solver."""
    anchors = walk.block.anchor_positions()
    level = TagFix(_over(anchors), np.diag([100.0, 100.0, TAG_HEIGHT_STD]) ** 2, np.zeros(0))
    locator, track = TagLocator(walk.block, anchors, SETTINGS, level), Track()
    for reading in walk.readings:
        fix, verdict = locator.add(reading)
        track.note(reading, verdict)
        if fix is not None:
            track.add(reading.stamp_ns, fix.p_map)
    return track


def by_constant_velocity(walk: Walk) -> Track:
    """The filter with constant velocity for its prediction, from the first fix on."""
    anchors = walk.block.anchor_positions()
    level = TagFix(_over(anchors), np.diag([100.0, 100.0, TAG_HEIGHT_STD]) ** 2, np.zeros(0))
    locator, ranging, track = (
        TagLocator(walk.block, anchors, SETTINGS, level),
        Ranging(walk.block, anchors, SETTINGS),
        Track(),
    )
    filter: ErrorStateFilter | None = None
    said_ns = 0
    for reading in walk.readings:
        if filter is None:
            fix, _ = locator.add(reading)
            if fix is not None and fix.mirror is None and _sure(fix):
                filter = tracker(
                    reading.stamp_ns,
                    fix.p_map,
                    fix.covariance,
                    velocity_std=WALKING,
                    range_scale_std=walk.block.scale_std,
                )
            continue
        coast(filter, reading.stamp_ns, WALKER)
        if reading.stamp_ns - said_ns > _FEET_NS:
            said_ns = reading.stamp_ns
            p = np.array([*tag_in_map(filter.state)[:2], TAG_HEIGHT_M])
            filter.update(TagPosition(p, np.diag([100.0, 100.0, TAG_HEIGHT_STD]) ** 2))
        track.note(reading, ranging.take(reading, filter))
        track.add(reading.stamp_ns, tag_in_map(filter.state))
    return track


def _sure(fix: TagFix) -> bool:
    return bool(np.linalg.eigvalsh(fix.covariance)[-1] < _START_STD**2)


def _over(anchors: dict[int, Array]) -> Array:
    return np.array([*np.mean(list(anchors.values()), axis=0)[:2], TAG_HEIGHT_M])


# --- the mower


@dataclass(frozen=True, slots=True)
class Mow:
    """The mower: reference ``x, y, heading`` (n, 3), odometry steps (stamp, distance, turn), ranges, the radios.

    ``begin_ns`` is the time of the reference's first pose, from which odometry counts on.
    """

    stamps: NDArray[np.int64]
    truth: Array
    steps: list[tuple[int, float, float]]
    readings: list[UwbRange]
    block: UwbBlock


def read_mow(path: Path) -> Mow:
    """Read the mower's directory."""
    beacons, odometry, ranges, truth = (
        np.genfromtxt(path / f"{name}.csv", delimiter=",", skip_header=1)
        for name in ("beacons", "odometry", "ranges", "ground_truth")
    )
    anchors = {int(beacon): (float(x), float(y), 0.0) for beacon, x, y in beacons}
    return Mow(
        _ns(truth[:, 0]),
        truth[:, 1:],
        [(int(stamp), float(row[1]), float(row[2])) for stamp, row in zip(_ns(odometry[:, 0]), odometry, strict=True)],
        [
            UwbRange(int(stamp), int(row[2]), float(row[3]))
            for stamp, row in zip(_ns(ranges[:, 0]), ranges, strict=True)
        ],
        UwbBlock(topic="", p_imu_tag=(0.0, 0.0, 0.0), anchors=anchors, **BEACONS),
    )


def _ns(seconds: Array) -> NDArray[np.int64]:
    return np.round(seconds * 1e9).astype(np.int64)


def by_odometry(mow: Mow, *, ranges: bool = True) -> tuple[Track, ErrorStateFilter]:
    """The filter with odometry for its prediction, from about the right pose on; without ranges, for comparison."""
    x, y, heading = mow.truth[0]
    about = np.diag([0.5, 0.5, 0.0]) ** 2
    filter = tracker(
        int(mow.stamps[0]), np.array([x, y, 0.0]), about, R_map_imu=yaw_rotation(heading), yaw_std=0.1,
        range_scale_std=mow.block.scale_std,
    )  # fmt: skip
    ranging, track = Ranging(mow.block, mow.block.anchor_positions(), SETTINGS), Track()
    readings = iter(mow.readings if ranges else [])
    reading = next(readings, None)
    for stamp, distance, turn in mow.steps:
        begin_ns, whole = filter.stamp_ns, stamp - filter.stamp_ns
        while reading is not None and reading.stamp_ns <= stamp:
            # two stretches of the file go back by seconds: late readings are left out, as `Odometry` does
            if reading.stamp_ns >= filter.stamp_ns:
                _step(filter, reading.stamp_ns, distance, turn, whole)
                track.note(reading, ranging.take(reading, filter))
            else:
                track.late += 1
            reading = next(readings, None)
        if stamp > begin_ns:
            _step(filter, stamp, distance, turn, whole)
            track.add(stamp, tag_in_map(filter.state))
    return track, filter


def _step(filter: ErrorStateFilter, stamp_ns: int, distance: float, turn: float, whole_ns: int) -> None:
    """The part until ``stamp_ns`` of a step of odometry that takes ``whole_ns``."""
    if stamp_ns <= filter.stamp_ns:
        return
    share = (stamp_ns - filter.stamp_ns) / whole_ns
    slip = _STEP_STD * np.sqrt(share * abs(distance))
    std = np.array([0.0, 0.0, _TURN_STD * np.sqrt(share), slip, slip, 0.0])
    follow(filter, stamp_ns, np.array([share * distance, 0.0, 0.0]), np.array([0.0, 0.0, share * turn]), std)


def mow_errors(mow: Mow, track: Track) -> Array:
    """Distances (n,) in the plane from the reference [m]."""
    t, s = np.array(track.stamps) - mow.stamps[0], mow.stamps - mow.stamps[0]
    at = np.stack([np.interp(t.astype(float), s.astype(float), mow.truth[:, k]) for k in (0, 1)], axis=1)
    return np.asarray(np.linalg.norm(np.array(track.p_map)[:, :2] - at, axis=1))


# --- the report


def walk_results(path: Path, figures: Path | None) -> Iterator[tuple[str, dict[str, Any]]]:
    """Name and figures of every case."""
    for case in CASES:
        walk = read_walk(path / case)
        tracks = {"ranges alone": by_ranges_alone(walk), "constant velocity": by_constant_velocity(walk)}
        result: dict[str, Any] = {}
        for name, (stamps, p) in walk.theirs.items():
            result[f"authors' {name}"] = dict(zip(("rmse_m", "rmse_2d_m"), rmse(walk, stamps, p), strict=True))
        for name, track in tracks.items():
            errors = rmse(walk, np.array(track.stamps, np.int64), np.array(track.p_map))
            result[name] = {
                "rmse_m": errors[0], "rmse_2d_m": errors[1], "refused": track.counts(),
                "unheard": track.unheard(SETTINGS.together_s), "refused_readings": track.refused,
            }  # fmt: skip
        if figures is not None:
            _draw_walk(walk, tracks, figures / f"uwb_{case.replace('/', '_').lower()}.png")
        yield case, result


def mow_result(path: Path, figures: Path | None) -> dict[str, Any]:
    """Figures of the mower."""
    mow = read_mow(path)
    track, filter = by_odometry(mow)
    alone, _ = by_odometry(mow, ranges=False)
    errors, drifted = mow_errors(mow, track), mow_errors(mow, alone)
    later = np.array(track.stamps) - mow.stamps[0] > 60e9
    if figures is not None:
        _draw_mow(mow, {"odometry and ranges": track, "odometry": alone}, figures / "uwb_plaza1.png")
    biases = zip(filter.state.anchors, filter.state.range_biases.tolist(), strict=True)
    return {
        "rmse_m": float(np.sqrt(np.mean(errors[later] ** 2))), "max_m": float(errors[later].max()),
        "odometry_rmse_m": float(np.sqrt(np.mean(drifted[later] ** 2))),
        "range_scale": filter.state.range_scale, "range_biases_m": {str(k): v for k, v in sorted(biases)},
        "late": track.late, "refused": track.counts(), "refused_readings": track.refused,
    }  # fmt: skip


def _draw_walk(walk: Walk, tracks: dict[str, Track], path: Path) -> None:
    from tools.bench.uwb_figures import draw_walk

    draw_walk(walk.stamps, walk.truth, walk.block, walk.theirs, tracks, path)


def _draw_mow(mow: Mow, tracks: dict[str, Track], path: Path) -> None:
    from tools.bench.uwb_figures import draw_mow

    draw_mow(mow.truth, mow.block, tracks, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--figures", type=Path)
    options = parser.parse_args()
    if options.figures:
        options.figures.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {"settings": SETTINGS.model_dump(), "walks": {}}
    print(f"{'case':14}{'':20}{'RMSE':>8}{'in 2D':>8}   refused (anchor, why); stretches without")
    for case, result in walk_results(options.data / "walks", options.figures):
        results["walks"][case] = result
        for name, figures in result.items():
            print(f"{case:14}{name:20}{figures['rmse_m']:8.3f}{figures['rmse_2d_m']:8.3f}   {_words(figures)}")
    results["plaza1"] = mow = mow_result(options.data / "plaza1", options.figures)
    print(f"plaza1: RMSE {mow['rmse_m']:.3f} m after the first minute, at most {mow['max_m']:.2f} m "
          f"(odometry alone {mow['odometry_rmse_m']:.2f} m); scale {mow['range_scale']:.4f}, biases "
          f"{ {k: round(v, 2) for k, v in mow['range_biases_m'].items()} }; refused {mow['refused']}")  # fmt: skip
    if options.json:
        options.json.write_text(json.dumps(results, indent=1), encoding="utf-8")


def _words(figures: dict[str, Any]) -> str:
    if "refused" not in figures:
        return ""
    stretches = [f"{s['anchor']}: {s['from_s']:.0f}-{s['to_s']:.0f} s" for s in figures["unheard"]]
    return f"{figures['refused']}; {', '.join(stretches) or 'none'}"


if __name__ == "__main__":
    main()
