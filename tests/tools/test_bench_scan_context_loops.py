"""Scan Context's loops on an odometry that drifts: found where it comes by again, and taken back."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from semmap.geometry import Array, inverse, se3, se3_exp, transform, yaw_rotation
from semmap.trajectory import Trajectory
from tools.bench.scan_context_loops import corrected, keyframes_of, loops_of

SECOND = 1_000_000_000


def rounds(metres: float = 60.0) -> Array:
    """True poses (n, 4, 4) half a metre apart, twice round a circle."""
    radius, n = metres / (2.0 * np.pi), int(4 * metres)
    turns = np.arange(n) * 0.5 / radius
    return np.array([se3(yaw_rotation(a + np.pi / 2), [radius * np.cos(a), radius * np.sin(a), 1.0]) for a in turns])


def test_loops_are_found_and_take_the_drift_back() -> None:
    rng = np.random.default_rng(0)
    rock = rng.uniform([-25.0, -25.0, 0.0], [25.0, 25.0, 4.0], size=(9000, 3))
    rock = rock[np.abs(np.hypot(rock[:, 0], rock[:, 1]) - 60.0 / (2.0 * np.pi)) > 2.0]
    true = rounds()
    drifted = [true[0]]
    for before, T in pairwise(true):
        drifted.append(drifted[-1] @ inverse(before) @ T @ se3_exp([0.0, 0.0, 0.0006, 0.002, 0.001, 0.0]))
    odometry = Trajectory("odom", np.arange(len(true)) * SECOND, np.array(drifted))
    rows = keyframes_of(odometry)
    clouds = []
    for T in true[rows]:
        near = transform(inverse(T), rock)
        clouds.append(near[np.linalg.norm(near, axis=1) < 15.0])
    loops = loops_of(odometry.poses[rows], clouds)
    assert len(loops) > 20
    for loop in loops:
        right = inverse(true[rows[loop.earlier]]) @ true[rows[loop.later]]
        assert np.linalg.norm((inverse(right) @ loop.T_earlier_later)[:3, 3]) < 0.2
    closed = corrected(odometry, rows, loops)
    off = np.linalg.norm(closed.positions - true[:, :3, 3], axis=1)
    off_alone = np.linalg.norm(odometry.positions - true[:, :3, 3], axis=1)
    assert off.max() < 0.5 * off_alone.max()
