"""The coal tunnel's recordings with all their sensors, and our runs over them.

LiDAR, IMU and truth are those of `tools.bench.odometry_recordings`, simulated once and cached; wheel and UWB are
simulated when they are read, so that one recording serves every fault of theirs. They are the same as in the built-in
mine's own recording: each sensor has random numbers of its own.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localize import Localizer, LocalizeSettings
from semmap.geometry import Array, se3
from semmap.measurements import ImuSample, Measurement, Scan
from semmap.rig import Rig
from semmap.trajectory import Trajectory
from tools import metrics
from tools.bench.odometry_cache import Recorded
from tools.bench.odometry_recordings import Progress, recorded
from tools.evaluate import MAP_FRAME, load_trajectories
from tools.run import process_facts, stream, timing, write_run
from tools.settings import ToolSettings
from tools.simulator import SensorFaults, fly, scenario
from tools.simulator.check_points import check_stamps
from tools.simulator.coal_tunnel import GATE_X, LONG_M
from tools.simulator.flight import Flight, robot_of
from tools.simulator.measurements import arrival_ns
from tools.simulator.uwb import uwb_ranges
from tools.simulator.wheel import wheel_speeds

OURS: dict[str, tuple[str, ...]] = {
    "semmap": (),
    "semmap without wheel": ("wheel",),
    "semmap without uwb": ("uwb",),
    "semmap without both": ("uwb", "wheel"),
}
"""Our configurations (paper 000, Table II) and what they leave out."""

FAULTS: dict[str, SensorFaults] = {
    "none": SensorFaults(),
    "nlos": SensorFaults(uwb_nlos_rate=0.1),
    "dead": SensorFaults(uwb_dead=(102,)),
    "slip": SensorFaults(wheel_slip_s=(150.0, 160.0), wheel_slip=0.2),
    "silent": SensorFaults(uwb_silent_s=(15.0, 75.0)),
}
"""10 % of the ranges by a detour; one dead anchor; the wheel 20 % too fast for 10 s; no range for a minute."""


@dataclass(frozen=True, slots=True)
class Tunnel:
    """One seed's tunnel: the cached recording, the flight it was made from, and the truth."""

    recording: Recorded
    flight: Flight
    truth: Trajectory

    @property
    def rig(self) -> Rig:
        return self.flight.rig

    def measurements(self, faults: SensorFaults) -> Iterator[Measurement]:
        """All sensors in order of arrival, as the recording of such a robot holds them."""
        faulty = replace(self.flight, faults=faults)
        streams: tuple[Iterator[Measurement], ...] = (
            _imu(self.recording), wheel_speeds(faulty), uwb_ranges(faulty), _scans(self.recording)
        )  # fmt: skip
        yield from heapq.merge(*streams, key=arrival_ns)


@dataclass(frozen=True, slots=True)
class Accuracy:
    """One trajectory against the truth [m].

    avg_err, total_err : mean and sum of the distances at the ``compared`` of the 15 check points (paper 000, section
        VI). realtime_err : that mean for what was known when each scan was done; NaN where nothing was.
    from_truth : ``avg_err`` when the truth over the outer tunnel gives the start, whoever it is.
    rmse, max : over all poses. percent : ``avg_err`` of the ``metres`` driven.
    placed : how it came into the map: by itself, or by the truth over the outer tunnel.
    """

    avg_err: float
    total_err: float
    compared: int
    realtime_err: float
    from_truth: float
    rmse: float
    max: float
    percent: float
    metres: float
    placed: str


def tunnel(length: float, seed: int, cache: Path, progress: Progress) -> Tunnel:
    """The tunnel of 75 m or 1 km for a seed, simulated first where the cache has none."""
    name = "coal-tunnel-1km" if length >= LONG_M else "coal-tunnel"
    recording = recorded(name, cache, seed=seed, progress=progress)
    mine = scenario(name, seed)
    return Tunnel(recording, fly(mine, None, robot_of(mine).rig, seed=seed), Trajectory("map", *recording.truth()))


def localized(
    one: Tunnel, out: Path, *, without: tuple[str, ...], faults: SensorFaults, settings: LocalizeSettings
) -> dict[str, Any]:
    """Run one of our configurations into the run directory ``out``; its summary."""
    localizer = Localizer(one.rig.without(*without), None, settings)
    costs = stream(localizer, one.measurements(faults))
    result = localizer.finish()
    summary = {
        "recording": one.recording.directory.name, "rig": "", "map": None, "without": sorted(without),
        **result.summary, **timing(costs), **process_facts(),
    }  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    write_run(out, result, summary, ToolSettings(localize=settings))
    one.truth.save_tum(out / "ground_truth.tum")
    return summary


def accuracy_of_run(out: Path, truth: Trajectory) -> Accuracy:
    """Our final trajectory against the truth, and what was known in real time."""
    found = load_trajectories(out)
    return accuracy(found["trajectory"], truth, found["realtime"])


def accuracy(estimate: Trajectory, truth: Trajectory, realtime: Trajectory | None = None) -> Accuracy:
    """A trajectory against the truth; one in a frame of its own is put onto the truth over the outer tunnel."""
    pairs = metrics.associate(estimate, truth)
    outer = outer_alignment(pairs)
    T = np.eye(4) if estimate.frame == MAP_FRAME else outer
    pairs = pairs.aligned(T)
    stamps = check_stamps(truth)
    points, errors = truth.at(stamps)[:, :3, 3], pairs.position_errors()
    at = _check_errors(estimate, T, stamps, points)
    now = np.zeros(0) if realtime is None else _check_errors(realtime, T, stamps, points)
    metres = truth.length()
    return Accuracy(
        avg_err=float(at.mean()),
        total_err=float(at.sum()),
        compared=len(at),
        realtime_err=float(now.mean()) if len(now) else np.nan,
        from_truth=float(_check_errors(estimate, outer, stamps, points).mean()),
        rmse=float(np.sqrt(np.mean(errors**2))),
        max=float(errors.max()),
        percent=100.0 * float(at.mean()) / metres,
        metres=metres,
        placed="by itself" if estimate.frame == MAP_FRAME else "by the truth",
    )


def placed(estimate: Trajectory, pairs: metrics.Pairs) -> Trajectory:
    """The trajectory in the map: as it is, or, from a frame of its own, by the truth over the outer tunnel."""
    if estimate.frame == MAP_FRAME:
        return estimate
    return Trajectory(MAP_FRAME, estimate.stamps_ns, outer_alignment(pairs) @ estimate.poses)


def outer_alignment(pairs: metrics.Pairs) -> Array:
    """``T_truth_estimate`` (4, 4) over the outer tunnel: mean of the attitudes' differences, then of the positions'.

    The way there is straight: positions alone would leave the roll open.
    """
    outer = pairs.truth[:, 0, 3] < GATE_X
    estimate, truth = pairs.estimate[outer], pairs.truth[outer]
    u, _, vt = np.linalg.svd(np.einsum("nij,nkj->ik", truth[:, :3, :3], estimate[:, :3, :3]))
    R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return se3(R, np.mean(truth[:, :3, 3] - estimate[:, :3, 3] @ R.T, axis=0))


def _check_errors(estimate: Trajectory, T: Array, stamps: NDArray[np.int64], points: Array) -> Array:
    """Errors (m,) at the check points the estimate covers."""
    if not len(estimate):
        return np.zeros(0)
    moved = Trajectory(MAP_FRAME, estimate.stamps_ns, T @ estimate.poses)
    errors = metrics.point_errors(moved, stamps, points)
    return errors[np.isfinite(errors)]


def _imu(recording: Recorded) -> Iterator[Measurement]:
    for stamp, gyro, accel in zip(recording.imu_ns.tolist(), recording.gyro, recording.accel, strict=True):
        yield ImuSample(stamp, gyro, accel)


def _scans(recording: Recorded) -> Iterator[Measurement]:
    for scan in recording.scans():
        points, offsets_ns, ring = scan.returns()
        yield Scan(scan.stamp_ns, points, offsets_ns, ring)
