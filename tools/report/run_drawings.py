"""The figures of a run, by the names of their files: for its page and for print."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from semmap.geometry import Array
from semmap.trajectory import Trajectory
from tools.evaluate import MAP_FRAME
from tools.report.colours import MODES, STATES, TRACKS, named
from tools.report.covariance import covariance_over_distance, ellipses_along_track
from tools.report.events import accepted_intersections, state_bands
from tools.report.figures import Drawing
from tools.report.plan import Track, plan
from tools.report.run_files import RunFiles
from tools.report.run_tracks import (
    TITLES,
    associated,
    check_point_line,
    consistency,
    distance_travelled,
    main_track,
    placed_trajectories,
    position_errors,
    sigma_of,
)
from tools.report.series import (
    Band,
    Bands,
    Line,
    errors_in_sigmas,
    errors_over_time,
    errors_over_way,
    mode_bands,
    roll_pitch_yaw,
    seconds,
    three_over_time,
)
from tools.report.timing import timing_histogram


def pins_of(run: RunFiles) -> list[float]:
    """Seconds at which an intersection was accepted."""
    return [(event["stamp_ns"] - run.start_ns) * 1e-9 for event in run.events if event.get("accepted") is True]


def bands_of(run: RunFiles) -> Bands:
    """Modes and states over the run."""
    return state_bands(run.events, run.start_ns, run.end_ns)


def over_time(run: RunFiles) -> Iterator[Drawing]:
    """What goes along the time of the run."""
    placed = placed_trajectories(run)
    if not any(len(one) for one in placed.values()):
        return
    pins, bands = pins_of(run), bands_of(run)
    position = [*_lines(run, placed, attitude=False), *check_point_line(run)]
    yield Drawing(
        "position", three_over_time(position, ("x [m]", "y [m]", "z [m]"), pins, bands),
        "Where the robot was; above it modes and states, at the foot the accepted intersections.", True,
    )  # fmt: skip
    attitude = _lines(run, placed, attitude=True)
    yield Drawing(
        "attitude", three_over_time(attitude, ("roll [°]", "pitch [°]", "yaw [°]"), pins, bands),
        "Attitude of the IMU in the map; the band is about its own axes.", True,
    )  # fmt: skip
    told = consistency(run, placed)
    if told is not None:
        times = seconds(told.stamps_ns, run.start_ns)
        yield Drawing(
            "errors_in_sigmas", errors_in_sigmas(times, told.errors, told.sigma, told.against, pins),
            f"Poses as published against {told.against}, and three standard deviations as stated then.", True,
        )  # fmt: skip
    curves = _error_curves(run, placed)
    if curves:
        by_time = [
            (TITLES[name], seconds(stamps, run.start_ns), errors, TRACKS[name]) for name, stamps, _, errors in curves
        ]
        yield Drawing("errors", errors_over_time(by_time, pins), "Odometry alone from the true start.", True)
    if bands:
        yield Drawing("modes", mode_bands(bands), "", True)


def over_distance(run: RunFiles) -> Iterator[Drawing]:
    """What goes along the way of the robot."""
    placed = placed_trajectories(run)
    curves = _error_curves(run, placed)
    if curves:
        by_way = [(TITLES[name], way, errors, TRACKS[name]) for name, _, way, errors in curves]
        yield Drawing("errors_over_distance", errors_over_way(by_way), "The same over the true distance travelled.")
    known = run.uncertainty
    track = run.trajectories.get("realtime" if known is not None and known.frame == MAP_FRAME else "odometry")
    if known is None or track is None or len(track) < 2:
        return
    known = known.at(track.stamps_ns)
    if len(known.stamps_ns) != len(track):
        return
    way = distance_travelled(track)
    words = f"Variance of the position in {known.frame}; the bands are the modes (paper 000, Fig. 8)."
    yield Drawing("covariance", covariance_over_distance(known, way), words)
    words = "The same as ellipses along the track, from above and from the side (paper 000, Fig. 7)."
    yield Drawing("covariance_ellipses", ellipses_along_track(known, track.positions), words)


def plans(run: RunFiles) -> Iterator[Drawing]:
    """Where the run went: all its trajectories, and the one that stands for it by error, mode and state."""
    placed = placed_trajectories(run)
    recognised = accepted_intersections(run.events)
    tracks = [Track("truth", run.truth.positions, TRACKS["truth"], dashed=True)] if run.truth is not None else []
    shown = [name for name in placed if len(placed[name]) and name != "realtime"]
    tracks += [
        Track(TITLES[name], placed[name].positions, TRACKS[name], dashed=name == "odometry") for name in reversed(shown)
    ]
    if tracks or run.semantic_map is not None:
        yield Drawing("plan", plan(run.semantic_map, tracks, recognised=recognised), "All trajectories.")
    name = main_track(placed)
    if name is None:
        return
    one = placed[name]
    errors = position_errors(one, run.truth)
    if np.isfinite(errors).any():
        track = Track(TITLES[name], one.positions, TRACKS[name], errors)
        yield Drawing("plan_by_error", plan(run.semantic_map, [track], recognised=recognised), "Paper 004, Fig. 10.")
    for kind, rows in bands_of(run).items():
        names = names_at(one, rows, run.start_ns)
        tints = named(names.tolist(), {**STATES, **MODES})
        track = Track(TITLES[name], one.positions, TRACKS[name], names=names, colours=tints)
        yield Drawing(f"plan_by_{kind}", plan(run.semantic_map, [track]), f"By {kind}.")


def timings(run: RunFiles) -> Iterator[Drawing]:
    """How long a scan takes."""
    if run.timing is not None and len(run.timing):
        yield Drawing("timing", timing_histogram(run.timing, run.timed), "")


def run_drawings(run: RunFiles) -> Iterator[Drawing]:
    """All figures of a run."""
    for group in (plans, over_time, over_distance, timings):
        yield from group(run)


def names_at(one: Trajectory, bands: Sequence[Band], start_ns: int) -> NDArray[np.str_]:
    """The band (n,) that each pose of a trajectory is in."""
    starts = np.array([band.start for band in bands])
    rows = np.searchsorted(starts, seconds(one.stamps_ns, start_ns), side="right") - 1
    return np.array([band.name for band in bands], np.str_)[np.clip(rows, 0, len(bands) - 1)]


def _lines(run: RunFiles, placed: dict[str, Trajectory], *, attitude: bool) -> list[Line]:
    """The trajectories as lines over time, the band of three sigmas about the one whose covariance is known."""
    known = run.uncertainty
    sure = "realtime" if known is not None and known.frame == MAP_FRAME else "odometry"
    lines = []
    for name in reversed(list(placed)):
        one = placed[name]
        if not len(one):
            continue
        sigma = sigma_of(known, one)[attitude] if name == sure else None
        values = roll_pitch_yaw(one.poses[:, :3, :3]) if attitude else one.positions
        times = seconds(one.stamps_ns, run.start_ns)
        lines.append(
            Line(TITLES[name], times, _level(values, lines, attitude), TRACKS[name], name == "odometry", sigma)
        )
    if run.truth is not None and len(run.truth):
        values = roll_pitch_yaw(run.truth.poses[:, :3, :3]) if attitude else run.truth.positions
        times = seconds(run.truth.stamps_ns, run.start_ns)
        lines.append(Line("truth", times, _level(values, lines, attitude), TRACKS["truth"], dashed=True))
    return lines


def _level(values: Array, others: Sequence[Line], attitude: bool) -> Array:
    """Yaw turned by whole turns so that it lies where the first line's does."""
    if attitude and others and len(values) and len(others[0].values):
        off = np.round((np.nanmedian(values[:, 2]) - np.nanmedian(others[0].values[:, 2])) / 360.0)
        values = values - np.array([0.0, 0.0, 360.0 * off])
    return values


def _error_curves(run: RunFiles, placed: dict[str, Trajectory]) -> list[tuple[str, NDArray[np.int64], Array, Array]]:
    """Name, stamps, distance travelled [m] and position errors [m] of each trajectory that has a truth."""
    curves = []
    for name, one in placed.items():
        pairs = associated(one, run.truth)
        if pairs is not None and run.truth is not None:
            way = np.interp(pairs.stamps_ns, run.truth.stamps_ns, distance_travelled(run.truth))
            curves.append((name, pairs.stamps_ns, way, pairs.position_errors()))
    return curves
