"""A recording alone into a prior map, and its semantic database: `semmap map`.

Two passes: the first closes loops and finds where the robot was; the second puts the scans there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from localize import LocalizationResult, Localizer
from maps.accumulate import AccumulatedCloud, ScanMapSettings
from maps.las import las_extent, save_laz_blocks
from semmap.errors import RecordingError, RigError, SettingsError
from semmap.geometry import Array, transform
from semmap.recordings import read_recording
from semmap.rig import Rig
from tools.build import build_database
from tools.files import writable_file
from tools.progress import progress_bar
from tools.run import check_aids, localize_settings, stream
from tools.settings import ToolSettings

_ROUND_M = 1000.0


@dataclass(frozen=True, slots=True)
class MadeMap:
    """What became of a recording: keyframes and points of the map, loops closed, intersections of the database."""

    keyframes: int
    points: int
    loops: int
    intersections: int | None


def map_recording(
    recording: Path,
    rig_file: Path,
    out: Path,
    settings: ToolSettings,
    *,
    database: Path | None = None,
    without: Sequence[str] = (),
) -> MadeMap:
    """Write the map of a recording to ``out`` (LAS or LAZ), and its semantic database to ``database``.

    The map is in the frame of the total station or the UWB anchors where the rig has any, else in one of its own:
    level, from where the robot began. Raises the errors of the rig and the recording, and `RecordingError` where no
    place in the map is found.
    """
    check_aids(without)
    for file in (out, database):
        if file is not None:
            writable_file(file)
    if out.suffix.lower() not in (".laz", ".las"):
        raise SettingsError(f"cannot write `{out.suffix}`", field="--out", mend="name it .laz or .las")
    rig = Rig.from_yaml(rig_file).without(*without)
    if rig.lidar is None:
        raise RigError("has no lidar", file=rig_file, field="lidar", mend="a map is made of its scans")
    with progress_bar("localizing") as progress:
        localizer = Localizer(rig, None, localize_settings(settings.localize, without))
        stream(localizer, read_recording(recording, rig, progress=progress))
        result = localizer.finish()
    if not len(result.trajectory):
        mend = "leave UWB and total station out for a map in a frame of its own: --without uwb,prism"
        raise RecordingError("never found its place", file=recording, mend=mend)
    scan_map = ScanMap(result, settings.scan_map)
    with progress_bar("mapping") as progress:
        localizer = Localizer(rig, None, settings.localize.without_loops(), on_keyframe=scan_map.add)
        stream(localizer, read_recording(recording, rig, progress=progress))
        localizer.finish()
    save_laz_blocks(out, scan_map.blocks(), scan_map.origin)
    semantic_map = build_database([out], database, settings) if database is not None else None
    found = None if semantic_map is None else len(semantic_map)
    return MadeMap(scan_map.keyframes, las_extent(out).rows, result.summary["pins"], found)


class ScanMap:
    """Puts keyframes' points where the localized recording says they belong."""

    def __init__(self, result: LocalizationResult, settings: ScanMapSettings) -> None:
        self._trajectory, self.settings = result.trajectory, settings
        self.origin = _ROUND_M * np.round(result.trajectory.positions[0] / _ROUND_M)
        self._cloud = AccumulatedCloud(settings.voxel, self.origin)
        self.keyframes = 0

    def add(self, stamp_ns: int, points: NDArray[np.float32]) -> None:
        """Points (n, 3) in the imu frame as of a scan's stamp; left out where it is not known where that was."""
        row = int(np.searchsorted(self._trajectory.stamps_ns, stamp_ns))
        if row == len(self._trajectory) or self._trajectory.stamps_ns[row] != stamp_ns:
            return
        near = points[np.linalg.norm(points, axis=1) < self.settings.range]
        self._cloud.add(transform(self._trajectory.poses[row], near.astype(np.float64)))
        self.keyframes += 1

    def blocks(self) -> Iterator[Array]:
        """The map's points (n, 3) [m], some at a time."""
        return self._cloud.blocks(self.settings.least_points)


def outcome(made: MadeMap) -> str:
    """One sentence on what was made."""
    database = "" if made.intersections is None else f", {made.intersections} intersections"
    return f"{made.points} points of {made.keyframes} keyframes, {made.loops} views closed loops{database}"
