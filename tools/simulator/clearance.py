"""Is there room for the path: keep it off the walls where they are near, and refuse it where it leaves the mine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from semmap.errors import InputFileError
from semmap.geometry import Array
from tools.simulator.mine import Mine
from tools.simulator.motion import Motion
from tools.simulator.progress import Progress, ignored

NEEDED, _WANTED = 0.25, 0.5
"""[m] from the rock: what the path must have, and what it is moved to get."""
_ROUNDS, _STEP = 60, 0.1
_SPREAD = 2.0
"""How many control points, 1σ, give way together."""
_HORIZON, _CLOSED = 24, 0.6
"""Of so many horizontal looks from a place in a mine this share at least meets rock."""
_BELOW = 3.0
_CHECK_S = 0.1


def kept_clear(controls: Array, mine: Mine, progress: Progress = ignored) -> Array:
    """Control points (n, 3) moved sideways from walls nearer than half a metre, as far as there is room.

    Smoothing cuts corners and turning back swings out, and a narrow roadway may have no room for either.
    ``progress(done, total)`` counts rounds.
    """
    line = controls.copy()
    for done, gain in enumerate(np.linspace(1.0, 0.1, _ROUNDS)):
        progress(done, _ROUNDS)
        away = mine.raycaster.from_rock(line)
        distance = np.linalg.norm(away, axis=1)
        lacking = np.maximum(_WANTED - distance, 0.0)
        if not lacking.any():
            break
        push = (lacking / np.maximum(distance, 1e-6))[:, None] * away[:, :2]
        move = gain * gaussian_filter1d(push, _SPREAD, axis=0, mode="nearest")
        # short steps, so that none goes through the opposite wall, which is no nearer than this one
        longest = np.maximum(0.5 * distance, _STEP)
        line[:, :2] += move * np.minimum(1.0, longest / np.maximum(np.linalg.norm(move, axis=1), 1e-9))[:, None]
    return line


def check_inside(mine: Mine, motion: Motion, height: float) -> None:
    """Raise `InputFileError` at the first place where the path is not in a roadway with a floor below."""
    p = motion(np.arange(0.0, motion.duration_s, _CHECK_S)).position
    p = p[np.concatenate([[True], np.linalg.norm(np.diff(p, axis=0), axis=1) > 1e-6])]
    down = np.broadcast_to([0.0, 0.0, -1.0], p.shape)
    blocked = np.append(np.isfinite(mine.raycaster.free_way(p[:-1], p[1:])), False)
    reasons = (
        (blocked, "passes through rock"),
        (mine.raycaster.cast(p, down).distances > height + _BELOW, "has no floor below"),
        (~is_enclosed(mine, p), "is outside the mine"),
        (mine.raycaster.clearance(p) < NEEDED, f"comes nearer than {NEEDED} m to the rock"),
    )
    for bad, what in reasons:
        if bad.any():
            x, y, z = p[int(np.argmax(bad))]
            raise InputFileError(
                f"{what} near ({x:.1f}, {y:.1f}, {z:.1f})",
                file=mine.name,
                field="route",
                mend="check the route's coordinates, the height above the floor and the smoothing of corners",
            )


def is_enclosed(mine: Mine, p: Array) -> NDArray[np.bool_]:
    """Is most of the horizon rock (n,), seen from points (n, 3)?"""
    angle = np.linspace(0.0, 2.0 * np.pi, _HORIZON, endpoint=False)
    horizon = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_HORIZON)])
    hits = mine.raycaster.cast(np.repeat(p, _HORIZON, axis=0), np.tile(horizon, (len(p), 1)))
    return np.asarray(np.isfinite(hits.distances).reshape(-1, _HORIZON).mean(axis=1) >= _CLOSED)
