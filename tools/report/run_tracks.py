"""The trajectories of a run on one plan, their errors, and how sure the run was of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semmap.errors import TrajectoryError
from semmap.geometry import Array, inverse, so3_log
from semmap.trajectory import Trajectory
from tools.evaluate import MAP_FRAME, TRAJECTORIES
from tools.metrics import Pairs, associate, start_alignment
from tools.report.colours import TRACKS
from tools.report.run_files import RunFiles
from tools.report.series import Line, seconds
from tools.report.uncertainty import Uncertainties

TITLES = {"trajectory": "final trajectory", "realtime": "in real time", "odometry": "odometry alone"}


def placed_trajectories(run: RunFiles) -> dict[str, Trajectory]:
    """The trajectories of a run by name, in the order of `TITLES`: those in another frame than the map are put where
    the truth, or else the result, begins."""
    in_map = {name: one for name, one in run.trajectories.items() if one.frame == MAP_FRAME and len(one)}
    reference = run.truth if run.truth is not None and len(run.truth) else in_map.get("trajectory")
    placed = {}
    for name in [name for name in TRAJECTORIES if name in run.trajectories]:
        one = run.trajectories[name]
        pairs = associated(one, reference) if one.frame != MAP_FRAME and reference is not None else None
        poses = one.poses if pairs is None else start_alignment(pairs) @ one.poses
        placed[name] = Trajectory(one.frame, one.stamps_ns, poses)
    return placed


def associated(estimate: Trajectory, reference: Trajectory | None) -> Pairs | None:
    """Poses of both at the same times, None where there are none."""
    if reference is None or not len(estimate) or not len(reference):
        return None
    try:
        pairs = associate(estimate, reference)
    except TrajectoryError:  # no time in common: nothing to compare
        return None
    return pairs if len(pairs) else None


def main_track(placed: dict[str, Trajectory]) -> str | None:
    """The trajectory that stands for the run: the final one, or the best there is."""
    return next((name for name in ("trajectory", "realtime", "odometry") if len(placed.get(name, ()))), None)


def position_errors(one: Trajectory, truth: Trajectory | None) -> Array:
    """Of each pose (n,) [m], NaN where the truth is not known."""
    errors = np.full(len(one), np.nan)
    pairs = associated(one, truth)
    if pairs is not None:
        errors[np.isin(one.stamps_ns, pairs.stamps_ns)] = pairs.position_errors()
    return errors


@dataclass(frozen=True, slots=True, eq=False)
class Consistency:
    """Errors of the poses as they were published, and what was said of them then.

    stamps_ns : (n,). errors, sigma : (n, 6) attitude about the IMU's axes [°], position in the map's axes [m].
    against : what the errors are measured against.
    """

    stamps_ns: NDArray[np.int64]
    errors: Array
    sigma: Array
    against: str


def consistency(run: RunFiles, placed: dict[str, Trajectory]) -> Consistency | None:
    """Poses as published, or of the odometry where none was, against the truth, or else the final trajectory."""
    known = run.uncertainty
    if known is None:
        return None
    name = "realtime" if known.frame == MAP_FRAME else "odometry"
    truth, against = (
        (run.truth, "the truth") if run.truth is not None else (placed.get("trajectory"), TITLES["trajectory"])
    )
    pairs = associated(placed[name], truth) if name in placed else None
    if pairs is None:
        return None
    kept = np.isin(pairs.stamps_ns, known.stamps_ns)
    known = known.at(pairs.stamps_ns)
    turned = _turn(run.trajectories[name], placed[name])
    variance = np.einsum("ij,njk,ik->ni", turned, known.position, turned)
    estimate, true = pairs.estimate[kept], pairs.truth[kept]
    about = so3_log(np.swapaxes(true[:, :3, :3], -1, -2) @ estimate[:, :3, :3])
    errors = np.concatenate([np.degrees(about), estimate[:, :3, 3] - true[:, :3, 3]], axis=1)
    sigma = np.concatenate([np.degrees(known.rotation_std), np.sqrt(np.maximum(variance, 0.0))], axis=1)
    return Consistency(pairs.stamps_ns[kept], errors, sigma, against)


def _turn(before: Trajectory, after: Trajectory) -> Array:
    """Rotation (3, 3) by which a trajectory was put elsewhere."""
    if not len(before):
        return np.eye(3)
    turn: Array = (after.poses[0] @ inverse(before.poses[0]))[:3, :3]
    return turn


def sigma_of(known: Uncertainties | None, one: Trajectory) -> tuple[Array | None, Array | None]:
    """Standard deviations of a trajectory's positions [m] and of its attitude [°], each (n, 3), NaN where not known."""
    if known is None:
        return None, None
    position, rotation = np.full((len(one), 3), np.nan), np.full((len(one), 3), np.nan)
    rows = np.isin(one.stamps_ns, known.stamps_ns)
    told = known.at(one.stamps_ns)
    position[rows] = np.sqrt(np.maximum(np.einsum("nii->ni", told.position), 0.0))
    rotation[rows] = np.degrees(told.rotation_std)
    return position, rotation


def check_point_line(run: RunFiles) -> list[Line]:
    """The check points of a run as dots over time, if it was compared with some."""
    points = run.check_points
    if points is None:
        return []
    return [Line("check points", seconds(points.stamps_ns, run.start_ns), points.points, TRACKS["truth"], dots=True)]


def distance_travelled(one: Trajectory) -> Array:
    """Along a trajectory up to each of its poses (n,) [m]."""
    steps = np.linalg.norm(np.diff(one.positions, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)]) if len(one) else np.zeros(0)
