"""A run for the Rerun viewer: map, trajectories, scans and intersections over time. The only file that knows rerun."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from semmap.errors import InputFileError, SettingsError
from semmap.files import written_whole
from semmap.geometry import Array, transform
from semmap.intersections import SemanticMap
from semmap.measurements import Scan
from semmap.recordings import read_recording
from semmap.rig import Rig
from semmap.trajectory import Trajectory
from tools.progress import Advance
from tools.report.colours import FAINT, KINDS, LIVE_CLOUD, PROVEN, RED, TRACKS, WALL
from tools.report.pack import thinned
from tools.report.run_files import RunFiles
from tools.report.run_tracks import TITLES, main_track, placed_trajectories

SCANS = 600
"""Scans in the file, at the most, evenly over the run."""
_SCAN_POINTS = 4000
_MAP_POINTS = 400_000
_TIME = "time"


def write_rerun(path: Path, run: RunFiles, recording: Path | None = None, progress: Advance | None = None) -> None:
    """Write a run as ``.rrd``. Positions are relative to the database's origin.

    Scans come from the run's recording, or from ``recording``; where that is gone, the keyframes that were compared
    with the database are there all the same.

    Raises `SettingsError` where rerun is not installed, the errors of the recording where one is given.
    """
    rr = _rerun()
    placed = placed_trajectories(run)
    origin = run.semantic_map.origin if run.semantic_map is not None else np.zeros(3)
    with written_whole(path) as temporary:
        stream = rr.RecordingStream("semmap", recording_id=run.name)
        stream.save(temporary)
        stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if run.semantic_map is not None:
            _log_map(rr, stream, run.semantic_map, origin)
        _log_trajectories(rr, stream, run, placed, origin)
        _log_sights(rr, stream, run, origin)
        name = main_track(placed)
        if name is not None:
            _log_scans(rr, stream, run, placed[name], origin, recording, progress)
        stream.flush()
        stream.disconnect()
        del stream


def _rerun() -> Any:
    try:
        import rerun
    except ImportError:
        mend = "pip install rerun-sdk"
        raise SettingsError("needs the rerun-sdk package", field="--rerun", mend=mend) from None
    return rerun


def _rgb(colour: str) -> list[int]:
    """Red, green and blue of ``#rrggbb``."""
    return list(bytes.fromhex(colour[1:]))


def _log_map(rr: Any, stream: Any, semantic_map: SemanticMap, origin: Array) -> None:
    most = max(1, _MAP_POINTS // max(1, len(semantic_map)))
    clouds = [thinned(one.cloud, most) + (one.p_map - origin) for one in semantic_map.intersections]
    if clouds:
        stream.log("map/clouds", rr.Points3D(np.concatenate(clouds), colors=_rgb(WALL), radii=0.03), static=True)
    axes = [axis - origin for axis in semantic_map.roadways.edge_axes]
    stream.log("map/roadways", rr.LineStrips3D(axes, colors=_rgb(FAINT), radii=0.05), static=True)
    c = semantic_map.columns
    tints = [_rgb(KINDS.get(kind, RED)) for kind in c.kind.tolist()]
    names = [f"{id} ({kind})" for id, kind in zip(c.id.tolist(), c.kind.tolist(), strict=True)]
    marks = rr.Points3D(c.p_map - origin, colors=tints, labels=names, radii=0.5)
    stream.log("map/intersections", marks, static=True)


def _log_trajectories(rr: Any, stream: Any, run: RunFiles, placed: dict[str, Trajectory], origin: Array) -> None:
    tracks = {name: (TITLES[name], one) for name, one in placed.items()}
    if run.truth is not None:
        tracks["truth"] = ("truth", run.truth)
    for name, (title, one) in tracks.items():
        if len(one):
            line = rr.LineStrips3D([one.positions - origin], colors=_rgb(TRACKS[name]), labels=[title], radii=0.04)
            stream.log(f"trajectories/{name}", line, static=True)
    main = main_track(placed)
    if main is None:
        return
    one = placed[main]
    axes = rr.Arrows3D(vectors=np.eye(3), colors=(255 * np.eye(3)).astype(np.uint8), labels=list("xyz"))
    stream.log("robot/axes", axes, static=True)
    for stamp_ns, T in zip(one.stamps_ns.tolist(), one.poses, strict=True):
        stream.set_time(_TIME, duration=(stamp_ns - run.start_ns) * 1e-9)
        stream.log("robot", rr.Transform3D(translation=T[:3, 3] - origin, mat3x3=T[:3, :3]))


def _log_sights(rr: Any, stream: Any, run: RunFiles, origin: Array) -> None:
    """What was compared with the database, when, and what came of it."""
    for event in run.events:
        if event["kind"] != "intersection" or run.overlays is None:
            continue
        number = event.get("overlay")
        if type(number) is not int or not 0 <= number < len(run.overlays):
            continue
        stream.set_time(_TIME, duration=(event["stamp_ns"] - run.start_ns) * 1e-9)
        accepted = event.get("accepted") is True
        points = run.overlays.in_map(number) - origin
        stream.log(
            "intersections/seen", rr.Points3D(points, colors=_rgb(LIVE_CLOUD if accepted else FAINT), radii=0.05)
        )
        words = f"intersection {event.get('id')}: {'accepted' if accepted else 'refused'}, {event.get('reason')}"
        stream.log("intersections/events", rr.TextLog(words, level="INFO" if accepted else "WARN"))
        if accepted:
            middle = points.mean(axis=0, keepdims=True) if len(points) else np.zeros((0, 3))
            stream.log(
                "intersections/accepted",
                rr.Points3D(middle, colors=_rgb(PROVEN), radii=0.4, labels=[str(event.get("id"))]),
            )


def _log_scans(
    rr: Any,
    stream: Any,
    run: RunFiles,
    one: Trajectory,
    origin: Array,
    recording: Path | None,
    progress: Advance | None,
) -> None:
    """Every so many scans, each point where the robot was at its time."""
    found, rig_file = recording or Path(str(run.summary.get("recording"))), Path(str(run.summary.get("rig")))
    if recording is None and not (found.exists() and rig_file.is_file()):
        return
    if not rig_file.is_file():
        raise InputFileError("is no longer there", file=rig_file, mend="put the run's rig file back")
    rig = Rig.from_yaml(rig_file)
    if rig.lidar is None:
        return
    every = max(1, int(run.summary.get("scans") or 1) // SCANS)
    T_imu_lidar = rig.lidar.T_imu_lidar
    scans = (
        measurement for measurement in read_recording(found, rig, progress=progress) if isinstance(measurement, Scan)
    )
    for number, scan in enumerate(scans):
        if number % every or not one.stamps_ns[0] <= scan.end_ns <= one.stamps_ns[-1]:
            continue
        few = np.linspace(0, len(scan.points) - 1, min(len(scan.points), _SCAN_POINTS)).astype(np.int64)
        poses = one.at(scan.stamp_ns + scan.offsets_ns[few])
        p_imu = transform(T_imu_lidar, scan.points[few])
        p_map = np.einsum("nij,nj->ni", poses[:, :3, :3], p_imu) + poses[:, :3, 3]
        stream.set_time(_TIME, duration=(scan.end_ns - run.start_ns) * 1e-9)
        stream.log("scans", rr.Points3D(p_map - origin, colors=_rgb(TRACKS["realtime"]), radii=0.02))
