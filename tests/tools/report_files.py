"""A small run as files: made for tests of the reports, with the columns and words that `semmap localize` writes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from localize.results import Overlay
from semmap import database
from semmap.geometry import se3, yaw_rotation
from semmap.intersections import SemanticMap
from semmap.trajectory import Trajectory
from tools.evaluate import evaluate_run
from tools.overlays import write_overlays
from tools.run import UNCERTAINTY_COLUMNS

POSES = 100
HOSTILE = '</script><script>document.title="owned"</script><img src=x onerror=document.title="owned">$x$ "\'&amp;'
"""What a name in a recording or a database may be."""


def write_run(folder: Path, semantic_map: SemanticMap, name: str = "run", *, off: float = 0.25) -> Path:
    """A run of ten seconds over the map in ``folder / name``, ``off`` [m] beside its truth ``folder / truth.tum``."""
    out = folder / name
    out.mkdir(parents=True, exist_ok=True)
    stamps = np.int64(1e8) * np.arange(POSES)
    truth = semantic_map.origin + np.outer(np.arange(POSES) * 0.2, [1.0, 0.2, 0.0])
    R = np.array([yaw_rotation(0.01 * k) for k in range(POSES)])
    Trajectory("map", stamps, se3(R, truth)).save_tum(folder / "truth.tum")
    Trajectory("map", stamps, se3(R, truth + np.array([0.0, off, 0.0]))).save_tum(out / "trajectory.tum")
    Trajectory("map", stamps[40:], se3(R[40:], truth[40:])).save_tum(out / "realtime.tum")
    Trajectory("odom", stamps, se3(R, truth - truth[0])).save_tum(out / "odometry.tum")
    database.save(semantic_map, folder / "mine.h5")
    (out / "events.jsonl").write_text("".join(json.dumps(event) + "\n" for event in _events()))
    summary = {"map": str(folder / "mine.h5"), "scans": POSES, "intersections_recognised": [8], "versions": {"a": "1"}}
    more = {"ms_per_scan_median": 12.4, "recording": HOSTILE, "rig": "gone.yaml"}
    (out / "summary.json").write_text(json.dumps(summary | more))
    (out / "settings.yaml").write_text("seed: 0\n")
    (out / "uncertainty.csv").write_text(_uncertainty(stamps))
    (out / "timing.csv").write_text("ms\n" + "\n".join(f"{5.0 + k % 7}" for k in range(POSES)) + "\n")
    write_overlays(out / "overlays.h5", _overlays(semantic_map))
    evaluate_run(out, folder / "truth.tum")
    return out


def _events() -> list[dict[str, object]]:
    state = {"kind": "state", "before": "unknown", "after": "tracking", "why": "seen <twice>"}
    sight = {
        "kind": "intersection", "keyframe": 4, "sight": 0, "consecutive": 3, "fit": 0.9123, "likeness": 0.8,
        "candidates": [{"id": 8, "pwcv": 0.9, "cwc": 0.8}],
    }  # fmt: skip
    pins = [{"stamp_ns": 4_000_000_000, "keyframe": 4, "id": 8, "p_map": [0.0, 0.0, 0.0]}]
    return [
        {"stamp_ns": 500_000_000, "kind": "mode", "before": "", "after": "LIO"},
        {"stamp_ns": 4_000_000_000, **state},
        {"stamp_ns": 4_000_000_000, **sight, "id": 8, "accepted": True, "reason": "fits", "overlay": 0, "pins": pins},
        {"stamp_ns": 6_000_000_000, **sight, "id": 3, "accepted": False, "reason": HOSTILE, "overlay": 1, "pins": []},
        {"stamp_ns": 7_000_000_000, "kind": HOSTILE, "what": [HOSTILE, {"a": 1}], "much": 0.5},
    ]


def _uncertainty(stamps: np.ndarray) -> str:
    lines = [",".join(UNCERTAINTY_COLUMNS)]
    for k, stamp in enumerate(stamps.tolist()):
        row = dict.fromkeys(UNCERTAINTY_COLUMNS, "0.0")
        row |= {"stamp": f"{stamp * 1e-9:.9f}", "mode": "LIO", "degenerate": "0"}
        row |= dict.fromkeys(("rx_std", "ry_std", "rz_std", "odom_xx", "odom_yy", "odom_zz"), "0.01")
        row |= {f"map_{axes}": ("0.0004" if axes[0] == axes[1] else "0.0") if k >= 40 else "" for axes in _AXES}
        lines.append(",".join(row[name] for name in UNCERTAINTY_COLUMNS))
    return "\n".join(lines) + "\n"


_AXES = ("xx", "xy", "xz", "yy", "yz", "zz")


def _overlays(semantic_map: SemanticMap) -> list[Overlay]:
    rng = np.random.default_rng(0)
    overlays = []
    for id in (8, 3):
        points = rng.uniform(-5.0, 5.0, (300, 3)).astype(np.float32)
        overlays.append(Overlay(id, se3(np.eye(3), semantic_map.by_id(id).p_map), points))
    return overlays
