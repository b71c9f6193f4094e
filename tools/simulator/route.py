"""Routes: from a CSV file, and from a polyline on the floor to a smooth line at flying height."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from semmap.errors import InputFileError
from semmap.geometry import Array
from tools.simulator.settings import MotionSettings

CONTROL_STEP = 0.5
"""[m] between the control points of the path."""
_REVERSAL_DEG, _REVERSAL_REACH = 115.0, 3.0
_TURN_RADIUS, _PULL_OVER = 0.6, 6.0
_SHORTEST_LEG = 2.5
_STEEPEST = 2.0
_NUMBERS = {2: "two", 3: "three"}


def load_route(path: str | Path) -> Array:
    """Floor points of a route file, comments and a header allowed.

    A line is ``x_m,y_m,z_floor_m``, which gives (n, 3), or in all lines ``x_m,y_m`` only, which gives (n, 2).
    Raises `InputFileError` with the line at fault.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as reason:
        raise InputFileError(f"cannot be read ({reason})", file=path, mend="check the path") from None
    rows: list[list[float]] = []
    header_seen = False
    for number, line in enumerate(lines, 1):
        words = line.split("#")[0].replace(";", ",").replace("\t", ",").strip().split(",")
        if words == [""]:
            continue
        if not rows and not header_seen and not any(_is_number(word) for word in words):
            header_seen = True
            continue
        wanted = len(rows[0]) if rows else 2 if len(words) == 2 else 3
        if len(words) < wanted or not all(_is_number(word) for word in words[:wanted]):
            raise InputFileError(
                f"is not {_NUMBERS[wanted]} numbers",
                file=path,
                field=f"line {number}",
                mend="write x_m,y_m,z_floor_m, or x_m,y_m in all lines",
            )
        rows.append([float(word) for word in words[:wanted]])
    return checked_route(np.array(rows or np.empty((0, 3)), dtype=np.float64), file=path)


def checked_route(floor: Array, *, file: str | Path | None = None) -> Array:
    """Route points (n, 3), or (n, 2) without heights, less repeats. Raises `InputFileError` if they make no route."""
    floor = np.asarray(floor, dtype=np.float64)
    if floor.ndim != 2 or floor.shape[1] not in _NUMBERS:
        mend = "give (n, 3) floor points, or (n, 2) without heights"
        raise InputFileError(f"has shape {floor.shape}", file=file, field="route", mend=mend)
    if not np.isfinite(floor).all():
        bad = int(np.nonzero(~np.isfinite(floor).all(axis=1))[0][0])
        raise InputFileError(f"point {bad} is not finite", file=file, field="route", mend="remove it")
    moved = np.linalg.norm(np.diff(floor, axis=0), axis=1) > 1e-3 if len(floor) else np.zeros(0, bool)
    floor = floor[np.concatenate([[True], moved])] if len(floor) else floor
    if len(floor) < 2 or _along(floor)[-1] < 2.0 * CONTROL_STEP:
        raise InputFileError(
            "has fewer than two points, or no length", file=file, field="route", mend="give points to go to"
        )
    return floor


def control_points(floor: Array, motion: MotionSettings) -> Array:
    """Control points (n, 3), half a metre apart, of the smooth path over a route's floor points.

    Where the route turns back, the way swings out before and after and makes a small half circle between,
    so that its direction is defined everywhere.
    """
    legs = [smoothed(leg, motion.corner) for leg in _legs(evenly(floor, CONTROL_STEP / 2))]
    sides = [0, *(_turning_side(before, after) for before, after in pairwise(legs)), 0]
    swung = [_swung_out(leg, *ends) for leg, ends in zip(legs, pairwise(sides), strict=True)]
    parts = [swung[0]]
    for side, before, after in zip(sides[1:-1], swung[:-1], swung[1:], strict=True):
        parts += [_half_circle(before, after), after] if side else [after]
    line = np.concatenate(parts)
    if len(legs) > 1:
        line = smoothed(evenly(line, CONTROL_STEP / 2), CONTROL_STEP)
    line = evenly(line, CONTROL_STEP)
    _check_slope(line)
    line[:, 2] += motion.height
    return line


def _check_slope(line: Array) -> None:
    step = np.diff(line, axis=0)
    steep = np.abs(step[:, 2]) > _STEEPEST * np.linalg.norm(step[:, :2], axis=1)
    if steep.any():
        x, y, z = line[int(np.argmax(steep))]
        raise InputFileError(
            f"is steeper than {_STEEPEST:g} to 1 near ({x:.1f}, {y:.1f}, {z:.1f})",
            field="route",
            mend="go round",
        )


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _along(points: Array) -> Array:
    """Distance (n,) along a polyline (n, d)."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def evenly(points: Array, step: float) -> Array:
    """The polyline (n, d) at equal distances of about ``step``, ends kept."""
    along = _along(points)
    at = np.linspace(0.0, along[-1], max(2, round(along[-1] / step) + 1))
    return np.column_stack([np.interp(at, along, axis) for axis in points.T])


def smoothed(points: Array, sigma: float) -> Array:
    """Gaussian smoothing, 1σ ``sigma`` [m], of an evenly spaced polyline; the ends stay."""
    spacing = _along(points)[-1] / (len(points) - 1)
    pad = min(len(points) - 1, int(4.0 * sigma / spacing))
    padded = np.pad(points, ((pad, pad), (0, 0)), mode="reflect", reflect_type="odd")
    smooth = gaussian_filter1d(padded, sigma / spacing, axis=0, mode="nearest", truncate=4.0)[pad : pad + len(points)]
    smooth[0], smooth[-1] = points[0], points[-1]
    return np.asarray(smooth)


def _legs(points: Array) -> list[Array]:
    """The route cut where it turns back; pieces too short to drive are dropped."""
    reach = max(1, round(_REVERSAL_REACH / (CONTROL_STEP / 2)))
    if len(points) <= 2 * reach:
        return [points]
    ahead = points[2 * reach :, :2] - points[reach:-reach, :2]
    behind = points[reach:-reach, :2] - points[: -2 * reach, :2]
    product = np.sum(ahead * behind, axis=1)
    lengths = np.linalg.norm(ahead, axis=1) * np.linalg.norm(behind, axis=1)
    sharp = product < np.cos(np.radians(_REVERSAL_DEG)) * lengths
    # the product of the chords, unlike their angle, is least at the tip itself
    cuts = [0, *(start + int(np.argmin(product[start:end])) + reach for start, end in _runs(sharp))]
    cuts.append(len(points) - 1)
    legs = [points[a : b + 1] for a, b in pairwise(cuts)]
    return [leg for leg in legs if _along(leg)[-1] > _SHORTEST_LEG] or [points]


def _runs(flags: Array) -> list[tuple[int, int]]:
    """Half-open ranges in which ``flags`` (n,) hold."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _turning_side(before: Array, after: Array) -> int:
    """1 where the way turns back to the left between two legs, -1 to the right, 0 where it goes on."""
    back, ahead = before[-1, :2] - before[-5, :2], after[4, :2] - after[0, :2]
    if back @ ahead > 0.0:
        return 0
    return 1 if back[0] * ahead[1] - back[1] * ahead[0] >= 0.0 else -1


def _swung_out(leg: Array, start_side: int, end_side: int) -> Array:
    """A leg moved a turning radius to the outer side of the turns at its ends, and shorter by as much."""
    along = _along(leg)
    heading = np.gradient(leg[:, :2], axis=0)
    heading /= np.maximum(np.linalg.norm(heading, axis=1, keepdims=True), 1e-9)
    right = np.column_stack([heading[:, 1], -heading[:, 0], np.zeros(len(leg))])
    kept, moved = np.ones(len(leg), bool), leg.copy()
    for side, to_turn in ((start_side, along), (end_side, along[-1] - along)):
        near = np.clip(1.0 - (to_turn - _TURN_RADIUS) / min(_PULL_OVER, 0.4 * along[-1]), 0.0, 1.0)
        moved += (side * _TURN_RADIUS * near**2 * (3.0 - 2.0 * near))[:, None] * right
        kept &= (side == 0) | (to_turn >= _TURN_RADIUS)
    return np.asarray(moved[kept])


def _half_circle(before: Array, after: Array) -> Array:
    """Points of a turn from the end of one leg to the start of the next, without the two."""
    start, end = before[-1], after[0]
    centre, arm = 0.5 * (start + end), 0.5 * (start - end)
    forward = before[-1] - before[-2]
    forward = np.array([forward[0], forward[1], 0.0])
    forward *= np.linalg.norm(arm) / max(float(np.linalg.norm(forward)), 1e-9)
    angle = np.linspace(0.0, np.pi, 9)[1:-1, None]
    return np.asarray(centre + np.cos(angle) * arm + np.sin(angle) * forward)
