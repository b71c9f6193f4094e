"""A roadheader with its oil pumps on: what vibration does to the alignment at rest, and what the enhancement leaves.

Run it as ``python -m tools.bench.roadheader --alignment``; it takes a minute or two. ``--online``: what the online
filter costs. ``--mechanization``: what coning and sculling are worth. ``--drives``: see
`tools.bench.roadheader_drives`. Paper 002, Tables 1 and 2: heading 177.67 degrees without vibration, 177.29 with,
177.60 enhanced, 81.57 % of the error removed.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from localize.denoise import Enhanced, enhance, rectification, slow_part
from localize.denoise_online import OnlineDenoiser
from localize.earth import Earth
from localize.mechanization import Increments, Navigator
from localize.settings import DenoiseSettings
from localize.static_alignment import align_static
from semmap.geometry import Array, so3_exp, so3_log, yaw_of
from semmap.measurements import ImuSample
from semmap.rig import ImuBlock
from tools.bench.roadheader_drives import run
from tools.bench.roadheader_mechanization import mechanization
from tools.simulator.imu import imu_errors
from tools.simulator.roadheader import CONSUMER, TACTICAL
from tools.simulator.roadheader import EARTH as MINE
from tools.simulator.vibration import oil_pumps, standing_imu

EARTH = Earth.of(MINE)
PAPER_PERCENT = 81.57
HELD_S = 60.0
"""How long the consumer IMU, which cannot find north, must hold the heading it was given [s]."""
TAIL_S = 1.0
"""The recording goes on after that: nothing is special about its end [s]."""
METHODS = ("mean", "faded mean", "low pass", "enhanced")


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Samples at rest: stamps (n,), rates and specific force (n, 3), and the true attitude (3, 3)."""

    stamps_ns: NDArray[np.int64]
    gyro: Array
    accel: Array
    R_map_imu: Array

    def part(self, begin: int, end: int) -> Stretch:
        return Stretch(self.stamps_ns[begin:end], self.gyro[begin:end], self.accel[begin:end], self.R_map_imu)


def stretch(block: ImuBlock, seed: int, seconds: float, *, pumps: bool) -> Stretch:
    """A machine at rest with its pumps on or off; seed for seed, attitude and sensor noise are the same in both."""
    rate_hz = block.rate_hz or 200.0
    t = np.arange(_samples(block, seconds)) / rate_hz
    rng = np.random.default_rng([seed, 29])
    R = so3_exp([0.0, 0.0, rng.uniform(-np.pi, np.pi)]) @ so3_exp([*rng.normal(0.0, 0.01, 2), 0.0])
    vibration = oil_pumps(seed) if pumps else None
    gyro, accel = standing_imu(t, R, earth_rate=EARTH.rate, gravity=EARTH.gravity, vibration=vibration)
    errors = imu_errors(block, len(t), rate_hz, 1.0, rng)
    return Stretch(np.round(t * 1e9).astype(np.int64), gyro + errors[0], accel + errors[1], R)


def _samples(block: ImuBlock, seconds: float) -> int:
    return round(seconds * (block.rate_hz or 200.0))


def low_passed(samples: Stretch) -> Enhanced:
    """The simplest rival: all that is fast is vibration; coning and sculling are given back all the same."""
    hz, rate_hz = DenoiseSettings().motion_hz, 1e9 / float(np.median(np.diff(samples.stamps_ns)))
    signals = np.hstack([samples.gyro, samples.accel])
    slow = slow_part(signals, rate_hz, hz)
    slow += rectification(signals - slow, rate_hz, hz)
    return Enhanced(slow[:, :3], slow[:, 3:])


def cleaned(samples: Stretch, method: str) -> Stretch:
    """The samples as a method hands them on."""
    if method not in ("low pass", "enhanced"):
        return samples
    at, settings = samples.stamps_ns, DenoiseSettings()
    clean = low_passed(samples) if method == "low pass" else enhance(at, samples.gyro, samples.accel, settings)
    return Stretch(at, clean.gyro, clean.accel, samples.R_map_imu)


def compassed(samples: Stretch, method: str) -> Array:
    """Attitude (3, 3) by level and earth rate, from the plain mean or the cleaned samples."""
    samples = cleaned(samples, method)
    gyro, accel = samples.gyro, samples.accel
    if method == "mean":
        gyro, accel = (np.tile(signal.mean(axis=0), (len(signal), 1)) for signal in (gyro, accel))
    return align_static(samples.stamps_ns, gyro, accel, TACTICAL, EARTH).R_map_imu


def held(samples: Stretch, method: str, aligned: int) -> Array:
    """Attitude (3, 3) a second before the end, from the true heading and the bias of the first ``aligned`` samples."""
    samples = cleaned(samples, method)
    first, rest = samples.part(0, aligned), samples.part(aligned - 1, len(samples.gyro) - _samples(CONSUMER, TAIL_S))
    gyro, accel = first.gyro, first.accel
    if method == "mean":
        gyro, accel = (np.tile(signal.mean(axis=0), (len(signal), 1)) for signal in (gyro, accel))
    start = align_static(first.stamps_ns, gyro, accel, CONSUMER, EARTH, heading=yaw_of(samples.R_map_imu))
    navigator = Navigator(start.R_map_imu, np.zeros(3), np.zeros(3), EARTH)
    navigator.run(Increments.of_samples(rest.stamps_ns, rest.gyro - start.gyro_bias, rest.accel))
    return navigator.R


def alignment(seeds: int, seconds: float) -> None:
    """One line a seed and IMU: how far vibration turns heading and attitude off the quiet machine's, in degrees."""
    print(f"{'IMU':10s} {'seed':>4s}" + "".join(f" {name + ': heading, attitude':>30s}" for name in METHODS))
    for name, block in (("tactical", TACTICAL), ("consumer", CONSUMER)):
        table = []
        for seed in range(seeds):
            off = np.degrees([_off(block, seed, seconds, method) for method in METHODS])
            table.append(off)
            print(f"{name:10s} {seed:4d}" + "".join(f" {row[0]:20.4f} {row[1]:9.4f}" for row in off), flush=True)
        _summary(name, np.array(table))


def _summary(name: str, off: Array) -> None:
    """What each method leaves of the plain mean's heading error; ``off`` (seeds, methods, 2), heading and attitude."""
    rms, worst = np.sqrt(np.mean(off[:, :, 0] ** 2, axis=0)), off[:, :, 1].max(axis=0)
    for k, method in enumerate(METHODS):
        removed = f", {100.0 * (1.0 - rms[k] / rms[0]):.1f} % removed (paper: {PAPER_PERCENT})" if k else ""
        print(f"{name}, {method}: heading {rms[k]:.4f} RMS{removed}; attitude {worst[k]:.4f} at most")


def online(seconds: float) -> None:
    """What the online filter costs, and how old its samples are when it gives them back."""
    for name, block in (("tactical", TACTICAL), ("consumer", CONSUMER)):
        loud, denoiser = stretch(block, 0, seconds, pumps=True), OnlineDenoiser(DenoiseSettings())
        samples = [
            ImuSample(stamp, w, f) for stamp, w, f in zip(loud.stamps_ns.tolist(), loud.gyro, loud.accel, strict=True)
        ]
        begin, oldest_ns, spent = time.process_time(), 0, []
        for sample in samples:
            before = time.perf_counter()
            done = denoiser.add(sample)
            spent.append(time.perf_counter() - before)
            oldest_ns = max([oldest_ns, *(sample.stamp_ns - one.stamp_ns for one in done[:1])])
        cost = 1e3 * (time.process_time() - begin) / len(samples)
        every, latency = denoiser.settings.online_step_s, denoiser.latency_s
        print(
            f"{name}, {block.rate_hz:g} Hz: {cost:.3f} ms a sample, at once {1e3 * max(spent):.0f} ms per {every:g} s;"
            f" latency {latency:g} s stated, {oldest_ns * 1e-9:.3f} s seen"
        )


def _off(block: ImuBlock, seed: int, seconds: float, method: str) -> tuple[float, float]:
    """Heading and whole angle [rad] between the loud and the quiet machine, by one method."""
    if block is TACTICAL:
        loud, quiet = (compassed(stretch(block, seed, seconds, pumps=pumps), method) for pumps in (True, False))
    else:
        both = (stretch(block, seed, seconds + HELD_S + TAIL_S, pumps=pumps) for pumps in (True, False))
        loud, quiet = (held(samples, method, _samples(block, seconds)) for samples in both)
    turn = so3_log(loud @ quiet.T)
    return float(turn[2]), float(np.linalg.norm(turn))


def main() -> None:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--alignment", action="store_true", help="static alignment under vibration")
    parser.add_argument("--online", action="store_true", help="cost and latency of the online vibration filter")
    parser.add_argument(
        "--mechanization", action="store_true", help="the filter's propagation beside coning and sculling"
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=60.0, help="length of the stretch at rest")
    parser.add_argument("--drives", action="store_true", help="through the roadway, clear and dusty")
    parser.add_argument("--cases", default="", help="of the drives, by name, separated by semicolons; all by default")
    parser.add_argument("--first", type=int, default=1, help="seed of the drives")
    parser.add_argument("--peers-python", type=Path, default=Path(sys.executable), help="of the environment with peers")
    parser.add_argument("--out", type=Path, default=Path("bench_roadheader"))
    args = parser.parse_args()
    if not (args.alignment or args.online or args.drives or args.mechanization):
        parser.error("say what to run: --alignment, --online, --mechanization, --drives")
    if args.alignment:
        alignment(args.seeds, args.seconds)
    if args.online:
        online(args.seconds)
    if args.mechanization:
        mechanization(args.seeds, args.seconds)
    if args.drives:
        run(range(args.first, args.first + args.seeds), args.out, args.cases, args.peers_python)


if __name__ == "__main__":
    main()
