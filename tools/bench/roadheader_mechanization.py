"""What coning and sculling (paper 002 Eq. 8 to 12) are worth beside the filter's own propagation, with the pumps on.

The filter of `localize` turns by the mean of two samples and takes the force at the interval's middle; its kernel
carries the covariance of 49 states on as well. The INS/total-station filter navigates by two intervals.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from localize._numba_propagation import propagate
from localize.earth import Earth
from localize.mechanization import Increments, Navigator
from localize.state import ERROR_DIM
from semmap.geometry import Array, so3_log
from semmap.rig import STANDARD_GRAVITY
from tools.simulator.vibration import oil_pumps, standing_imu

_AT_REST = Earth(np.zeros(3), STANDARD_GRAVITY, np.zeros((3, 3)))
RATES_HZ = (475.0, 200.0, 100.0)


def by_filter(t: Array, gyro: Array, accel: Array) -> tuple[Array, Array]:
    """Attitude (3, 3) and velocity (3,) at the end, by the odometry's kernel."""
    R, p, v, n = np.eye(3), np.zeros(3), np.zeros(3), len(t)
    track = [np.empty((n, 3)) for _ in range(4)]
    g, P = np.array([0.0, 0.0, -STANDARD_GRAVITY]), np.zeros((ERROR_DIM, ERROR_DIM))
    propagate(R, p, v, np.zeros(3), np.zeros(3), g, P, t, gyro, accel, np.zeros(4), np.empty((n, 3, 3)), *track)
    return R, v


def by_mechanization(t: Array, gyro: Array, accel: Array) -> tuple[Array, Array]:
    """The same by coning and sculling."""
    navigator = Navigator(np.eye(3), np.zeros(3), np.zeros(3), _AT_REST)
    navigator.run(Increments.of_samples(np.round(t * 1e9).astype(np.int64), gyro, accel))
    return navigator.R, navigator.v


def mechanization(seeds: int, seconds: float) -> None:
    """A line a rate and method: attitude and horizontal velocity off after so long at rest with perfect sensors, and
    how far the two methods are apart."""
    methods: dict[str, Callable[[Array, Array, Array], tuple[Array, Array]]] = {
        "filter": by_filter, "coning and sculling": by_mechanization,
    }  # fmt: skip
    for rate_hz in RATES_HZ:
        t = np.arange(round(rate_hz * seconds)) / rate_hz
        found = {name: [_ended(method, t, seed) for seed in range(seeds)] for name, method in methods.items()}
        for name, ends in found.items():
            turn = np.degrees([np.linalg.norm(so3_log(R)) for R, _, _ in ends])
            speed = [np.linalg.norm(v[:2]) for _, v, _ in ends]
            cost = 1e6 * np.mean([s for _, _, s in ends]) / len(t)
            print(f"{rate_hz:g} Hz, {name}: {_rms(turn):.4f} deg, {_rms(speed):.4f} m/s, {cost:.1f} µs a sample")
        pairs = list(zip(*found.values(), strict=True))
        apart = [np.degrees(np.linalg.norm(so3_log(a[0].T @ b[0]))) for a, b in pairs]
        faster = [np.linalg.norm((a[1] - b[1])[:2]) for a, b in pairs]
        print(f"{rate_hz:g} Hz, apart: {_rms(apart):.5f} deg, {_rms(faster):.5f} m/s", flush=True)


def _ended(
    method: Callable[[Array, Array, Array], tuple[Array, Array]], t: Array, seed: int
) -> tuple[Array, Array, float]:
    gyro, accel = standing_imu(
        t, np.eye(3), earth_rate=np.zeros(3), gravity=STANDARD_GRAVITY, vibration=oil_pumps(seed)
    )
    method(t[:9], gyro[:9].copy(), accel[:9].copy())
    begin = time.process_time()
    R, v = method(t, gyro, accel)
    return R, v, time.process_time() - begin


def _rms(values: object) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
