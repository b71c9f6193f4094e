"""How large the pages of `semmap report` are, and how soon they open: of a large database, and of an hour-long run.

    python -m tools.bench.report --intersections 10000 --minutes 60 [--keep DIR]

The mine is the made-up one of `tools.bench.database`; the run goes to and fro on it at 10 poses a second, with an ICP
check every three seconds. Only sizes matter here. A page is open when its script has drawn it and filled its tables.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from localize.results import LocalizationResult, Overlay, Uncertainty
from semmap import database
from semmap.geometry import Array, se3, yaw_rotation
from semmap.intersections import SemanticMap
from semmap.trajectory import Trajectory
from tools.bench.chromium import chromium, missing, processor_seconds
from tools.bench.database import SPACING_M, made_up_map
from tools.evaluate import evaluate_run
from tools.files import write_text
from tools.report import Wanted, write_report
from tools.run import timing_csv, write_run
from tools.settings import ToolSettings

RATE_HZ = 10
SPEED_M_S = 1.5
CHECK_S = 3.0
CLOUD_POINTS = 1500


def made_up_run(folder: Path, map_file: Path, seconds: float) -> Path:
    """Files of a run of so many seconds along the rows of the made-up mine, with its truth."""
    semantic_map = database.load(map_file)
    out, rng = folder / "run", np.random.default_rng(0)
    stamps = np.arange(round(seconds * RATE_HZ), dtype=np.int64) * (10**9 // RATE_HZ)
    truth = _way(len(stamps), round(len(semantic_map) ** 0.5))
    off = np.cumsum(rng.normal(0.0, 0.002, (len(stamps), 3)), axis=0)
    R = yaw_rotation(0.0) @ np.array([yaw_rotation(0.2 * np.sin(0.01 * k)) for k in range(len(stamps))])
    final, true = Trajectory("map", stamps, se3(R, truth + off)), Trajectory("map", stamps, se3(R, truth))
    events, overlays = _checks(semantic_map, truth, stamps, rng)
    result = LocalizationResult(
        final, Trajectory("map", stamps[50:], final.poses[50:]), Trajectory("odom", stamps, se3(R, truth - truth[0])),
        tuple(events), {"scans": len(stamps), "intersections_recognised": [], "anchored": True},
        tuple(_sureness(stamps)), tuple(overlays),
    )  # fmt: skip
    summary = {**result.summary, "map": str(map_file), "recording": "made up", "rig": "", "ms_per_scan_median": 2.0}
    write_run(out, result, summary, ToolSettings())
    write_text(out / "timing.csv", timing_csv(rng.gamma(2.0, 2.0, len(stamps)).tolist(), []))
    true.save_tum(folder / "truth.tum")
    evaluate_run(out, folder / "truth.tum")
    return out


def _way(count: int, side: int) -> Array:
    """Positions (count, 3) to and fro along the rows of crossings."""
    walked = SPEED_M_S / RATE_HZ * np.arange(count)
    length = SPACING_M * (side - 1)
    row, along = np.divmod(walked, length)
    return np.column_stack([np.where(row % 2, length - along, along), SPACING_M * (row % side), np.full(count, 1.5)])


def _checks(
    semantic_map: SemanticMap, truth: Array, stamps: Array, rng: np.random.Generator
) -> tuple[list[dict[str, object]], list[Overlay]]:
    events: list[dict[str, object]] = [
        {"stamp_ns": 5 * 10**9, "kind": "state", "before": "unknown", "after": "tracking", "why": "intersection proven"}
    ]
    overlays = []
    for number, k in enumerate(range(50, len(stamps), round(CHECK_S * RATE_HZ))):
        row = int(np.argmin(np.linalg.norm(semantic_map.p_map - truth[k], axis=1)))
        id = int(semantic_map.columns.id[row])
        candidates = [{"id": id, "pwcv": 0.9, "cwc": 0.9}, {"id": id + 1, "pwcv": 0.75, "cwc": 0.6}]
        events.append(
            {
                "stamp_ns": int(stamps[k]), "kind": "intersection", "keyframe": k, "sight": number, "consecutive": 3,
                "candidates": candidates, "id": id, "fit": 0.98, "likeness": 0.95, "icp_distance_m": 0.02,
                "runner_up_likeness": 0.2, "accepted": number % 5 > 0, "reason": "fits, and agrees with the track",
                "overlay": number, "pins": [],
            }
        )  # fmt: skip
        points = rng.normal(0.0, 5.0, (CLOUD_POINTS, 3)).astype(np.float32)
        overlays.append(Overlay(id, se3(np.eye(3), truth[k]), points))
    return events, overlays


def _sureness(stamps: Array) -> list[Uncertainty]:
    cov = 1e-4 * np.eye(3)
    return [
        Uncertainty(int(stamp), "LIO", False, 0.01, 0.01, 0.001, np.full(3, 0.001), cov, cov if k >= 50 else None)
        for k, stamp in enumerate(stamps.tolist())
    ]


def seconds_to_open(page: Path, goes: int = 3) -> tuple[float, float]:
    """Medians of the seconds from asking for a page until it has drawn itself: by the clock, and of the processor,
    for others may be at work as well. Fails if the page complains."""
    found = []
    with chromium() as browser:
        for _ in range(goes):
            browser.get("about:blank")
            began = time.perf_counter(), processor_seconds(browser)
            browser.get(f"file://{page.resolve()}")
            while browser.execute_script("return document.body.dataset.ready") != "yes":
                time.sleep(0.02)
            found.append((time.perf_counter() - began[0], processor_seconds(browser) - began[1]))
        complaints = browser.get_log("browser")
    if complaints:
        raise RuntimeError(f"{page.name}: {complaints[0]['message']}")
    clock, processor = np.median(found, axis=0)
    return float(clock), float(processor)


def _report(folder: Path, name: str, source: Path) -> None:
    page, began = folder / f"{name}.html", (time.perf_counter(), time.process_time())
    write_report([source], Wanted(page), ToolSettings())
    took = time.perf_counter() - began[0], time.process_time() - began[1]
    if missing():
        opened = f"not opened: {missing()}"
    else:
        opened = "open after {:.2f} s (processor {:.2f} s)".format(*seconds_to_open(page))
    size = page.stat().st_size / 1e6
    print(f"{name:10} {size:5.1f} MB, {opened}; written in {took[0]:.0f} s (processor {took[1]:.0f} s)", flush=True)


def main() -> None:
    """Print one line a page."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--intersections", type=int, default=10_000)
    parser.add_argument("--points", type=int, default=4_000, help="of each cloud")
    parser.add_argument("--minutes", type=float, default=60.0, help="of the run; 0: none")
    parser.add_argument("--keep", type=Path, help="where the files stay")
    wanted = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = wanted.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        semantic_map = made_up_map(round(wanted.intersections**0.5), wanted.points)
        database.save(semantic_map, folder / "mine.h5")
        if wanted.minutes > 0.0:
            _report(folder, "run", made_up_run(folder, folder / "mine.h5", 60.0 * wanted.minutes))
        _report(folder, "database", folder / "mine.h5")


if __name__ == "__main__":
    main()
