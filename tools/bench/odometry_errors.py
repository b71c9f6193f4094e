"""Errors of an odometry: after the best fit, as drift from the pose at the first metre, and where they arise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from semmap.geometry import Array, inverse, so3_log
from tools.metrics import Pairs, Statistics, best_alignment, relative_errors, start_alignment

FIRST_METRE = 1.0
SEGMENTS_M = (10.0, 100.0)


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors over the first ``metres`` of a flight, [m] and [deg].

    ape_rmse, ape_max : of the positions after the SE(3) fit (as ``evo_ape tum --align``).
    attitude_rmse : of the attitude after that fit.
    drift_rmse, drift_end : of the positions, the estimate put onto the truth by its pose at the first metre.
    tilt_end, yaw_end : the last attitude's error after that, across and about the vertical.
    start_m, start_deg : error of the pose at the first metre, the first pose put onto the truth.
    percent_10m, percent_100m : mean relative position error over such lengths; None where the flight is shorter.
    """

    metres: float
    poses: int
    ape_rmse: float
    ape_max: float
    attitude_rmse: float
    drift_rmse: float
    drift_end: float
    tilt_end: float
    yaw_end: float
    start_m: float
    start_deg: float
    percent_10m: float | None
    percent_100m: float | None


@dataclass(frozen=True, slots=True)
class Consistency:
    """Errors against the covariance that the system states; the start is the reference.

    nees : mean of the normalised error squared of the pose, divided by its 6 dimensions. inside : share of the
    poses inside the 95 % bound. along, across, up : root mean square of error / sigma of the position along the
    true heading, to its left, and upwards. sigma_along, error_along : at the end [m].
    """

    nees: float
    inside: float
    along: float
    across: float
    up: float
    sigma_along: float
    error_along: float


def up_to(pairs: Pairs, metres: float) -> Pairs:
    """The pairs of the first so many metres."""
    use = pairs.distance_flown() <= metres
    return Pairs(pairs.stamps_ns[use], pairs.estimate[use], pairs.truth[use])


def from_first_metre(pairs: Pairs) -> Pairs:
    """The estimate put onto the truth by its pose when the first metre has been flown; later pairs only."""
    rest = _after_first_metre(pairs)
    return rest.aligned(start_alignment(rest))


def _after_first_metre(pairs: Pairs) -> Pairs:
    first = int(np.searchsorted(pairs.distance_flown(), FIRST_METRE))
    return Pairs(pairs.stamps_ns[first:], pairs.estimate[first:], pairs.truth[first:])


def errors(pairs: Pairs) -> Errors:
    """All of a stretch's errors. The stretch must be longer than the first metre."""
    fitted, drifted = pairs.aligned(best_alignment(pairs)), from_first_metre(pairs)
    ape, drift = Statistics.of(fitted.position_errors()), drifted.position_errors()
    turn, start = _attitude_errors_deg(drifted)[-1], _after_first_metre(pairs.aligned(start_alignment(pairs)))
    relative = {row["length_m"]: row["translation_percent"] for row in relative_errors(pairs, SEGMENTS_M)}
    return Errors(
        metres=float(pairs.distance_flown()[-1]),
        poses=len(pairs),
        ape_rmse=ape.rmse,
        ape_max=ape.max,
        attitude_rmse=Statistics.of(fitted.rotation_errors_deg()).rmse,
        drift_rmse=Statistics.of(drift).rmse,
        drift_end=float(drift[-1]),
        tilt_end=float(np.hypot(*turn[:2])),
        yaw_end=float(turn[2]),
        start_m=float(start.position_errors()[0]),
        start_deg=float(start.rotation_errors_deg()[0]),
        percent_10m=relative.get(SEGMENTS_M[0]),
        percent_100m=relative.get(SEGMENTS_M[1]),
    )


def drift_profile(pairs: Pairs, step: float) -> list[dict[str, float]]:
    """Drift from the pose at the first metre, a row every ``step`` metres.

    Keys: ``metres`` flown; ``along`` the true heading, ``left``, ``up`` [m]; ``tilt_x``, ``tilt_y`` (about
    the map's x and y) and ``yaw`` [deg].
    """
    drifted = from_first_metre(pairs)
    flown = drifted.distance_flown()
    at = np.searchsorted(flown, np.arange(step, flown[-1], step))
    moved, turned = (
        _heading_frame(drifted, drifted.estimate[:, :3, 3] - drifted.truth[:, :3, 3]),
        _attitude_errors_deg(drifted),
    )
    names = ("along", "left", "up", "tilt_x", "tilt_y", "yaw")
    return [
        {"metres": float(flown[i] + FIRST_METRE), **dict(zip(names, map(float, [*moved[i], *turned[i]]), strict=True))}
        for i in at
    ]


def consistency(pairs: Pairs, covariances: Array) -> Consistency:
    """How the errors since the first pair agree with the covariances (n, 6, 6), see `Consistency`.

    The first pair says where the system's frame is: its pose is taken as exact.
    """
    true = pairs.estimate[0] @ inverse(pairs.truth[0]) @ pairs.truth
    R, off = pairs.estimate[:, :3, :3], true[:, :3, 3] - pairs.estimate[:, :3, 3]
    error = np.concatenate([so3_log(np.swapaxes(R, 1, 2) @ true[:, :3, :3]), off], axis=1)[1:]
    squared = np.einsum("ni,ni->n", error, np.linalg.solve(covariances[1:], error[..., None])[..., 0])
    axes = _heading_axes(true[1:])
    local = np.einsum("nij,nj->ni", axes, off[1:])
    sigma = np.sqrt(np.einsum("nij,njk,nik->ni", axes, covariances[1:, 3:, 3:], axes))
    normed = np.sqrt(np.mean((local / sigma) ** 2, axis=0))
    return Consistency(
        nees=float(squared.mean() / 6.0),
        inside=float(np.mean(squared < chi2.ppf(0.95, 6))),
        along=float(normed[0]),
        across=float(normed[1]),
        up=float(normed[2]),
        sigma_along=float(sigma[-1, 0]),
        error_along=float(local[-1, 0]),
    )


def _attitude_errors_deg(pairs: Pairs) -> Array:
    """Rotation vectors (n, 3) [deg] in the map frame that take the true attitude to the estimated one."""
    R = pairs.estimate[:, :3, :3] @ np.swapaxes(pairs.truth[:, :3, :3], 1, 2)
    return np.degrees(so3_log(R))


def _heading_axes(poses: Array) -> Array:
    """Rows (n, 3, 3): the level direction of each pose's x axis, left of it, and up."""
    x = poses[:, :2, 0] / np.linalg.norm(poses[:, :2, 0], axis=1, keepdims=True)
    axes = np.zeros((len(poses), 3, 3))
    axes[:, 0, :2], axes[:, 1, 0], axes[:, 1, 1], axes[:, 2, 2] = x, -x[:, 1], x[:, 0], 1.0
    return axes


def _heading_frame(pairs: Pairs, vectors: Array) -> Array:
    return np.asarray(np.einsum("nij,nj->ni", _heading_axes(pairs.truth), vectors))
