"""A recording through the localizer, into a run directory.

The directory holds ``trajectory.tum`` (smoothed, map frame), ``realtime.tum`` (what was known when each scan
was done), ``odometry.tum`` (the filter alone), ``events.jsonl``, ``overlays.h5``, ``uncertainty.csv``,
``timing.csv``, ``summary.json`` and ``settings.yaml``.
"""

from __future__ import annotations

import difflib
import importlib.metadata
import json
import platform
import resource
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

import semmap
from localize import LiveLocalizer, LocalizationResult, Localizer
from localize.clock_offset import ClockOffset
from localize.compilation import kernels_compiled
from localize.results import Uncertainty
from localize.settings import LocalizeSettings
from semmap import database
from semmap.errors import RigError, SettingsError
from semmap.measurements import Measurement, PrismFix, Scan
from semmap.recordings import read_recording
from semmap.rig import Rig
from semmap.trajectory import text_of_stamp_ns
from tools.files import writable_directory, write_text
from tools.overlays import write_overlays
from tools.prism import fixes_of_file, merged
from tools.progress import Advance
from tools.settings import ToolSettings

AIDS = ("uwb", "wheel", "prism", "lidar", "intersections", "inertial-enhancement")
"""What `--without` can leave out."""

NEVER_ANCHORED = """no poses: the run never found its place in the map (events.jsonl says what was seen)
odometry.tum holds the odometry, in a frame of its own"""

_UPPER = np.triu_indices(3)
_AXES = ("xx", "xy", "xz", "yy", "yz", "zz")
UNCERTAINTY_COLUMNS = (
    "stamp", "mode", "degenerate", "scan_degree", "translation_degree", "rotation_degree",
    "rx_std", "ry_std", "rz_std", *(f"odom_{axes}" for axes in _AXES), *(f"map_{axes}" for axes in _AXES),
)  # fmt: skip
"""Of `uncertainty.csv`, see docs/files.md."""

LIBRARIES = ("numpy", "scipy", "numba", "gtsam", "open3d-cpu", "open3d")


def localize_recording(
    recording: Path,
    rig_file: Path,
    out: Path,
    *,
    map_file: Path | None = None,
    prism_file: Path | None = None,
    without: Sequence[str] = (),
    settings: ToolSettings,
    live: bool = False,
    progress: Advance | None = None,
) -> dict[str, Any]:
    """Stream ``recording`` through a `Localizer`, write the run directory ``out``, return its summary.

    ``prism_file``: fixes of the total station, instead of those of a topic. ``live`` plays it at the pace at which it
    was recorded into a `LiveLocalizer`, which drops scans if it must.

    Nothing is written before the whole recording went through. Raises the errors of the rig, the database, the
    recording and the prism file.
    """
    check_aids(without)
    writable_directory(out)
    rig = Rig.from_yaml(rig_file).without(*without)
    rig, fixes, offset = _with_prism_file(recording, rig, prism_file, without, settings, progress)
    semantic_map = database.load(map_file) if map_file is not None and "intersections" not in without else None
    localizer = Localizer(rig, semantic_map, localize_settings(settings.localize, without))
    if not kernels_compiled():
        print("compiling the kernels of the odometry, once: up to half a minute", file=sys.stderr)
    started = time.perf_counter()
    measurements = read_recording(recording, rig, progress=progress)
    scan_ms: list[float] = []
    latency_ms: list[float] = []
    if live:
        playing = LiveLocalizer(localizer)
        result = play(playing, merged(measurements, fixes))
        latency_ms = [1e3 * seconds for seconds in playing.latency_s]
    else:
        scan_ms = stream(localizer, merged(measurements, fixes))
        result = localizer.finish()
    summary = {
        "recording": str(recording.resolve()),
        "rig": str(rig_file.resolve()),
        "map": None if semantic_map is None or map_file is None else str(map_file.resolve()),
        "prism_file": None if prism_file is None else str(prism_file.resolve()),
        "prism_fixes": len(fixes) if prism_file is not None else None,
        "prism_clock": asdict(offset) if offset else None,
        "without": sorted(without),
        "duration_s": round(measurements.info.duration_s, 3),
        "point_times": asdict(measurements.info.point_times) if measurements.info.point_times else None,
        "messages_dropped": dict(measurements.dropped),
        **result.summary,
        **timing(scan_ms),
        "wall_s": round(time.perf_counter() - started, 3),
        **process_facts(),
    }
    write_run(out, result, summary, settings)
    write_text(out / "timing.csv", timing_csv(scan_ms, latency_ms))
    return summary


def localize_settings(settings: LocalizeSettings, without: Sequence[str]) -> LocalizeSettings:
    """The settings, without loops where intersections shall be left out."""
    return settings.without_loops() if "intersections" in without else settings


def _with_prism_file(
    recording: Path,
    rig: Rig,
    prism_file: Path | None,
    without: Sequence[str],
    settings: ToolSettings,
    progress: Advance | None,
) -> tuple[Rig, tuple[PrismFix, ...], ClockOffset | None]:
    """The rig without the total station's topic, and the file's fixes on the robot's clock."""
    if prism_file is None:
        if rig.total_station is not None and not rig.total_station.topic:
            mend = "give --prism FILE, or leave it out: --without prism"
            raise RigError("has no topic", field="total_station.topic", mend=mend)
        return rig, (), None
    if "prism" in without:
        raise SettingsError("leaves out what --prism gives", field="--without", mend="give one of the two")
    if rig.total_station is not None:
        silent = rig.total_station.model_copy(update={"topic": ""})
        rig = rig.model_copy(update={"total_station": silent})
    fixes, offset = fixes_of_file(
        prism_file, rig, lambda: read_recording(recording, rig, progress=progress), settings.localize
    )
    if offset is not None and rig.total_station is not None:
        # LiDAR and IMU that told it are used again
        known = {"time_offset_s": offset.offset_s, "time_offset_std": 2.0 * offset.std_s}
        rig = rig.model_copy(update={"total_station": rig.total_station.model_copy(update=known)})
    return rig, fixes, offset


def stream(localizer: Localizer, measurements: Iterable[Measurement]) -> list[float]:
    """Hand every measurement to ``localizer``; returns what each scan cost [ms]; alike where several came at once."""
    costs: list[float] = []
    cost = 0.0
    for measurement in measurements:
        started = time.perf_counter()
        update = localizer.add(measurement)
        cost += time.perf_counter() - started
        if update is not None:
            new = localizer.scans - len(costs)
            costs += [1e3 * cost / new] * new
            cost = 0.0
    return costs


def play(live: LiveLocalizer, measurements: Iterable[Measurement]) -> LocalizationResult:
    """Hand every measurement to ``live`` when its time has come, a scan at its end, and end the stream."""
    began, first_ns = time.monotonic(), None
    for measurement in measurements:
        come_ns = measurement.end_ns if isinstance(measurement, Scan) else measurement.stamp_ns
        first_ns = come_ns if first_ns is None else first_ns
        time.sleep(max(0.0, (come_ns - first_ns) * 1e-9 - (time.monotonic() - began)))
        live.add(measurement)
    return live.close()


def timing(scan_ms: Sequence[float]) -> dict[str, float | None]:
    """Median and 95th percentile of the milliseconds a scan cost; None where no scan was completed."""
    if not scan_ms:
        return {"ms_per_scan_median": None, "ms_per_scan_p95": None}
    median, p95 = np.percentile(scan_ms, [50, 95])
    return {"ms_per_scan_median": round(float(median), 2), "ms_per_scan_p95": round(float(p95), 2)}


def timing_csv(scan_ms: Sequence[float], latency_ms: Sequence[float]) -> str:
    """One column, a line a scan: what it cost, or, played live, how long after its arrival its pose came [ms]."""
    name, values = ("latency_ms", latency_ms) if latency_ms else ("ms", scan_ms)
    return "\n".join([name, *(f"{value:.3f}" for value in values)]) + "\n"


def check_aids(without: Iterable[str]) -> None:
    """Raise `SettingsError` with the nearest known name for a word `--without` does not know."""
    for name in without:
        if name not in AIDS:
            near = difflib.get_close_matches(name, AIDS, n=1, cutoff=0.4)
            mend = f"did you mean `{near[0]}`?" if near else f"known names: {', '.join(AIDS)}"
            raise SettingsError(f"does not know `{name}`", field="--without", mend=mend)


def write_run(out: Path, result: LocalizationResult, summary: dict[str, Any], settings: ToolSettings) -> None:
    """Write the files of a run; an evaluation left by an earlier run no longer applies and goes."""
    (out / "evaluation.json").unlink(missing_ok=True)
    lost = result.trajectory.frame == "map" and not len(result.trajectory)
    result.trajectory.save_tum(out / "trajectory.tum", comment=NEVER_ANCHORED if lost else "")
    result.realtime.save_tum(out / "realtime.tum")
    result.odometry.save_tum(out / "odometry.tum")
    write_text(out / "events.jsonl", "".join(json.dumps(event, default=_plain) + "\n" for event in result.events))
    write_overlays(out / "overlays.h5", result.overlays)
    write_text(out / "uncertainty.csv", uncertainty_csv(result.uncertainty))
    write_text(out / "settings.yaml", settings.to_yaml())
    write_text(out / "summary.json", json.dumps(summary, indent=1, default=_plain) + "\n")


def uncertainty_csv(rows: Iterable[Uncertainty]) -> str:
    """The table of `uncertainty.csv` as text; what is not known is an empty cell."""
    lines = [",".join(UNCERTAINTY_COLUMNS)]
    for row in rows:
        position_map = np.full((3, 3), np.nan) if row.position_map is None else row.position_map
        degrees = (row.scan_degree, row.translation_degree, row.rotation_degree)
        numbers = [*degrees, *row.rotation_std, *row.position_odom[_UPPER], *position_map[_UPPER]]
        cells = [f"{number:.6g}" if np.isfinite(number) else "" for number in numbers]
        lines.append(",".join([text_of_stamp_ns(row.stamp_ns), row.mode, str(int(row.degenerate)), *cells]))
    return "\n".join(lines) + "\n"


def outcome(summary: Mapping[str, Any]) -> str:
    """One sentence on how a run went."""
    if not summary["scans"]:
        return "no scan was completed"
    cost = f"{summary['scans']} scans, {cost_text(summary)} ms each"
    if not summary["anchored"]:
        closed = f", {summary['pins']} views closed loops" if summary["pins"] else ""
        return f"{cost}, no place in the map{closed}"
    count = len(summary["intersections_recognised"])
    return f"{cost}, in the map by {count} intersections" if count else f"{cost}, in the map"


def cost_text(summary: Mapping[str, Any]) -> str:
    """Milliseconds a scan, median and 95th percentile, as text."""
    median, p95 = summary["ms_per_scan_median"], summary["ms_per_scan_p95"]
    return "–" if median is None else f"{median:.0f} (p95 {p95:.0f})"


def process_facts() -> dict[str, Any]:
    """Peak memory of this process [MB] and the versions that computed."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    unit = 2**20 if sys.platform == "darwin" else 2**10  # bytes there, kibibytes on Linux
    versions = {"semmap": semmap.__version__, "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:  # one of the two names of open3d
            continue
    return {"peak_memory_mb": round(peak / unit, 1), "versions": versions}


def _plain(value: object) -> Any:
    """NumPy numbers and arrays as JSON has them."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} has no place in a result file")
