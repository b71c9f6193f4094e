"""The page about a run: where it went, how well, what it recognised and why, what it cost."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from semmap.errors import SemmapError
from semmap.geometry import Array
from semmap.intersections import SemanticMap
from semmap.rig import Rig
from semmap.trajectory import Trajectory
from tools.evaluate import DRIFT_HEAD, ERROR_HEAD, drift_rows, error_rows
from tools.report.colours import ANCHOR, INK, MODES, PINK, STATES, TRACKS, named
from tools.report.events import accepted_intersections, cell, event_tables
from tools.report.figures import Drawing
from tools.report.pack import Blobs, Clouds, numbers, thinned
from tools.report.page import facts, figure, folded, note, page, place, section, table
from tools.report.plan_data import WALL_POINTS, marks, plan_data, plan_origin
from tools.report.run_drawings import bands_of, over_distance, over_time, timings
from tools.report.run_files import RunFiles
from tools.report.run_tracks import TITLES, main_track, placed_trajectories, position_errors
from tools.report.series import Bands, roll_pitch_yaw, seconds

EVENTS = 5000
"""Events of intersections in a page, at the most; `events.jsonl` has all."""
_POSES = 60_000
"""Poses of a track in a page, at the most."""
_CLOUDS = 7_000_000
"""Characters that the clouds of the intersections may take, and as many those laid over them."""
_CLOUD_POINTS = 3000
_CHARACTERS_A_POINT = 5.4


def run_page(run: RunFiles, inertial: Sequence[Drawing] = ()) -> str:
    """The page (HTML) about a run; ``inertial`` are figures of its IMU."""
    placed = placed_trajectories(run)
    blobs = Blobs()
    truth = [] if run.truth is None else [run.truth.positions]
    origin = plan_origin(run.semantic_map, [*(one.positions for one in placed.values()), *truth])
    data = {
        **_plan_data(run, origin, blobs),
        "tracks": _tracks(run, placed, origin, blobs),
        "tints": _tints(run, placed, blobs),
        "points": surveyed_points(run, origin),
        **_seen(run, blobs),
        "tables": [
            {"kind": one.kind, "columns": one.columns, "words": one.words, "rows": one.rows}
            for one in event_tables(run.events, run.start_ns)
            if one.kind != "intersection"
        ],
    }
    return page(
        f"Run {run.name}",
        f"recording {Path(str(run.summary.get('recording', '?'))).name}, "
        f"database {Path(run.summary['map']).name if run.summary.get('map') else 'none'}",
        facts(headline(run)),
        section("Plan", f'<div class="main"><div>{place("plan")}{place("tinted", "legend")}</div>{_detail()}</div>'),
        section("Intersections seen", place("sights")) if data["events"] else "",
        section(
            "Over time", note("Point at a figure: the plan shows where the robot was then."), *_figures(over_time(run))
        )
        if any(len(one) for one in placed.values())
        else section("Over time", note("No pose at any time.")),
        section("Errors", _error_table(run.evaluation), _drift_table(run.evaluation), _point_rows(run.evaluation)),
        section("Over the distance travelled", *_figures(over_distance(run))),
        section("Inertial measurements", *_figures(inertial)),
        section("Other events", place("others")) if data["tables"] else "",
        section("Cost", *_figures(timings(run)), _costs(run.summary)),
        section("Settings", folded("settings as used", run.settings)),
        script="run",
        data=data,
        blobs=blobs,
    )


def _figures(drawings: Iterable[Drawing]) -> list[str]:
    return [figure(drawing) for drawing in drawings]


def headline(run: RunFiles) -> dict[str, str]:
    """The figures one looks for first."""
    s = run.summary
    figures = {"scans": s.get("scans"), "keyframes": s.get("keyframes")}
    values = {name: str(value) for name, value in figures.items() if value is not None}
    if s.get("map"):
        values["intersections recognised"] = str(len(s.get("intersections_recognised", ())))
    if s.get("ms_per_scan_median") is not None:
        values["time per scan, median"] = f"{s['ms_per_scan_median']:.1f} ms"
    row = run.evaluation.get("trajectories", {}).get("trajectory", {})
    if "absolute" in row:
        values["RMSE, no alignment"] = f"{row['absolute']['position_m']['rmse']:.3f} m"
        values["largest error"] = f"{row['absolute']['position_m']['max']:.3f} m"
    average = row.get("check_points", {}).get("AvgErr")
    if average is not None:
        values["AvgErr at check points"] = f"{average:.3f} m"
    first = run.evaluation.get("realtime", {}).get("first_fix_s")
    if first is not None:
        values["first place in the map after"] = f"{first:.0f} s"
    return values


def _plan_data(run: RunFiles, origin: Array, blobs: Blobs) -> dict[str, Any]:
    walls = _walls(run.semantic_map, origin)
    return {
        "plan": plan_data(run.semantic_map, origin, walls, blobs),
        "intersections": marks(run.semantic_map, origin),
        "recognised": accepted_intersections(run.events),
    }


def _walls(semantic_map: SemanticMap | None, origin: Array) -> Array:
    """Points (n, 2) of the walls around the intersections; of a large map only a few clouds would be points enough."""
    if semantic_map is None or len(semantic_map) > WALL_POINTS // 20:
        return np.zeros((0, 2))
    most = WALL_POINTS // max(1, len(semantic_map))
    parts = [
        thinned(one.cloud.astype(np.float64), most)[:, :2] + one.p_map[:2] - origin
        for one in semantic_map.intersections
    ]
    return np.concatenate([np.zeros((0, 2)), *parts])


def _tracks(run: RunFiles, placed: Mapping[str, Trajectory], origin: Array, blobs: Blobs) -> list[dict[str, Any]]:
    """The trajectories for the plan; the first of them is the one the time cursor goes along."""
    first = main_track(dict(placed))
    order = sorted((name for name in placed if len(placed[name])), key=lambda name: name != first)
    tracks = [(name, TITLES[name], placed[name]) for name in order]
    if run.truth is not None and len(run.truth):
        tracks.append(("truth", "truth", run.truth))
    told = []
    for name, title, one in tracks:
        add_track(blobs, name, one, run.start_ns, origin)
        hidden = name == "realtime" and first != "realtime"
        dashed = name in ("odometry", "truth")
        told.append({"name": name, "title": title, "colour": TRACKS[name], "dashed": dashed, "hidden": hidden})
    return told


def add_track(blobs: Blobs, name: str, one: Trajectory, start_ns: int, origin: Array) -> None:
    """A trajectory for a page's plan: times, places relative to ``origin``, headings."""
    rows = _drawn(one)
    positions = one.positions[rows] - np.array([origin[0], origin[1], 0.0])
    yaw = np.radians(roll_pitch_yaw(one.poses[rows, :3, :3])[:, 2])
    blobs.add(f"track-{name}-time", seconds(one.stamps_ns[rows], start_ns).astype(np.float32))
    blobs.add(f"track-{name}-pose", np.column_stack([positions, yaw]).astype(np.float32))


def _drawn(one: Trajectory) -> slice:
    return slice(None, None, max(1, -(-len(one) // _POSES)))


def _tints(run: RunFiles, placed: Mapping[str, Trajectory], blobs: Blobs) -> list[dict[str, Any]]:
    """By what the main track can be coloured: its error, or the names of bands of time."""
    name = main_track(dict(placed))
    if name is None:
        return []
    tints: list[dict[str, Any]] = []
    errors = position_errors(placed[name], run.truth)[_drawn(placed[name])]
    if np.isfinite(errors).any():
        blobs.add("errors", errors.astype(np.float32))
        tints.append({"name": "position error", "most": round(max(float(np.nanmax(errors)), 1e-3), 4)})
    bands: Bands = bands_of(run)
    for kind, rows in bands.items():
        told = [[round(band.start, 3), round(band.end, 3), band.name] for band in rows]
        colours = named((band.name for band in rows), {**STATES, **MODES})
        tints.append({"name": kind, "bands": told, "colours": colours})
    return tints


def surveyed_points(run: RunFiles, origin: Array) -> list[dict[str, Any]]:
    """What else is on the plan: check points, and anchors and total station of the rig, where its file is there."""
    points = []
    if run.check_points is not None:
        named_points = zip(run.check_points.names, run.check_points.points.tolist(), strict=True)
        points += [_point("check point", name, p, origin, INK, "L") for name, p in named_points]
    rig = _rig(run.summary.get("rig"))
    if rig is not None and rig.uwb is not None:
        points += [_point("UWB anchor", str(id), p, origin, ANCHOR, "T") for id, p in rig.uwb.anchors.items()]
    if rig is not None and rig.total_station is not None:
        points.append(_point("total station", "", rig.total_station.position, origin, PINK, "multi"))
    return points


def _point(sort: str, name: str, p: Sequence[float], origin: Array, colour: str, kind: str) -> dict[str, Any]:
    x, y = round(p[0] - float(origin[0]), 3), round(p[1] - float(origin[1]), 3)
    return {"sort": sort, "name": name, "x": x, "y": y, "colour": colour, "kind": kind}


def _rig(name: Any) -> Rig | None:
    """The rig of the run, where its file is still there: without it the plan merely lacks the anchors."""
    if not isinstance(name, str) or not Path(name).is_file():
        return None
    try:
        return Rig.from_yaml(name)
    except SemmapError:
        return None


def _seen(run: RunFiles, blobs: Blobs) -> dict[str, Any]:
    """The events of intersections, and the clouds laid over each other at them."""
    events = [event for event in run.events if event["kind"] == "intersection"]
    kept = events[:EVENTS]
    laid = [event["overlay"] for event in kept if _has_overlay(run, event)]
    seen, stored, rows = Clouds(blobs, "seen"), Clouds(blobs, "cloud"), {}
    wanted = sorted({int(run.overlays.id[k]) for k in laid}) if run.overlays is not None else []
    points = _points_each(len(wanted))
    p_of: dict[int, Array] = {}
    if run.semantic_map is not None:
        known = set(run.semantic_map.columns.id.tolist())
        for id in [id for id in wanted if id in known]:
            one = run.semantic_map.by_id(id)
            rows[id], p_of[id] = len(rows), one.p_map
            stored.add(thinned(one.cloud.astype(np.float64), points))
    number_of: dict[int, int] = {}
    most = _points_each(len(laid))
    for k in laid:
        assert run.overlays is not None
        cloud = thinned(run.overlays.in_map(k), most)
        number_of[k] = len(number_of)
        seen.add(cloud - p_of.get(int(run.overlays.id[k]), cloud.mean(axis=0) if len(cloud) else np.zeros(3)))
    return {
        "events": [_event(event, run, number_of) for event in kept],
        "events_left_out": len(events) - len(kept),
        "seen": seen.done(),
        "clouds": stored.done(),
        "cloud_of": {str(id): row for id, row in rows.items()},
    }


def _has_overlay(run: RunFiles, event: Mapping[str, Any]) -> bool:
    number = event.get("overlay")
    return run.overlays is not None and type(number) is int and 0 <= number < len(run.overlays)


def _points_each(count: int) -> int:
    return int(np.clip(_CLOUDS / (_CHARACTERS_A_POINT * max(1, count)), 100, _CLOUD_POINTS))


def _event(event: Mapping[str, Any], run: RunFiles, number_of: Mapping[int, int]) -> dict[str, Any]:
    scores = ("fit", "likeness", "icp_distance_m", "runner_up_likeness")
    candidates = event.get("candidates")
    pins = event.get("pins")
    return {
        "time": round((event["stamp_ns"] - run.start_ns) * 1e-9, 3),
        "id": event.get("id") if type(event.get("id")) is int else None,
        "accepted": event.get("accepted") is True,
        "reason": cell(event.get("reason")),
        "sight": cell(event.get("sight")),
        "keyframe": cell(event.get("keyframe")),
        "consecutive": cell(event.get("consecutive")),
        **{name: _score(event.get(name)) for name in scores},
        "candidates": [
            [one.get("id"), one.get("pwcv"), one.get("cwc")] for one in candidates if isinstance(one, dict)
        ] if isinstance(candidates, list) else [],
        "pins": [one.get("id") for one in pins if isinstance(one, dict)] if isinstance(pins, list) else [],
        "overlay": number_of.get(event["overlay"]) if _has_overlay(run, event) else None,
    }  # fmt: skip


def _score(value: Any) -> float | None:
    known = isinstance(value, float | int) and not isinstance(value, bool)
    return numbers([value], 4)[0] if known else None


def _detail() -> str:
    return (
        '<div id="detail" class="panel"><div class="bar"><h3 id="which" aria-live="polite">Nothing picked</h3>'
        '<button type="button" id="before">‹ before</button><button type="button" id="after">next ›</button></div>'
        '<p class="note" id="reason"></p><div id="cloud"></div><dl class="small" id="figures"></dl>'
        '<div id="candidates"></div></div>'
    )


def _error_table(evaluation: Mapping[str, Any]) -> str:
    if "trajectories" not in evaluation:
        return ""
    rows = [[TITLES.get(row[0], row[0]), *row[1:]] for row in error_rows(evaluation)]
    return note("Position errors in metres.") + table(ERROR_HEAD, rows, text=ERROR_HEAD[:2]) if rows else ""


def _drift_table(evaluation: Mapping[str, Any]) -> str:
    if "trajectories" not in evaluation:
        return ""
    rows = [[TITLES.get(row[0], row[0]), *row[1:]] for row in drift_rows(evaluation)]
    words = note("Drift over stretches of equal length: error of the way from end to end.")
    return words + table(DRIFT_HEAD, rows, text=DRIFT_HEAD[:1]) if rows else ""


def _point_rows(evaluation: Mapping[str, Any]) -> str:
    """Errors at the check points, one row a point and one column a trajectory."""
    found = evaluation.get("trajectories", {})
    points = {name: row["check_points"] for name, row in found.items() if "check_points" in row}
    names = next((list(one["errors"]) for one in points.values()), [])
    rows = [[name, *(cell(one["errors"][name]) for one in points.values())] for name in names]
    rows += [[key, *(cell(one[key]) for one in points.values())] for key in ("AvgErr", "TotalErr") if points]
    return table(["check point, error [m]", *(TITLES.get(name, name) for name in points)], rows)


def _costs(summary: Mapping[str, Any]) -> str:
    units = {"ms_per_scan_median": "ms", "ms_per_scan_p95": "ms", "wall_s": "s", "peak_memory_mb": "MB"}
    rows = [
        [key, f"{summary[key]:.1f} {unit}"] for key, unit in units.items() if isinstance(summary.get(key), int | float)
    ]
    rows += [[f"version of {name}", str(version)] for name, version in summary.get("versions", {}).items()]
    rows += [["recording", str(summary.get("recording"))], ["rig", str(summary.get("rig"))]]
    return table(["what", "value"], rows)
