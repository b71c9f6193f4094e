"""Pictures of the benchmark with real UWB ranges: tracks over the reference, and what was refused when."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from numpy.typing import NDArray

from semmap.geometry import Array
from semmap.rig import UwbBlock

if TYPE_CHECKING:
    from tools.bench.uwb_real import Track

matplotlib.use("Agg")
from matplotlib import pyplot as plt

_COLOURS = ("tab:blue", "tab:red")


def draw_walk(
    stamps: NDArray[np.int64],
    truth: Array,
    block: UwbBlock,
    theirs: dict[str, tuple[NDArray[np.int64], Array]],
    tracks: dict[str, Track],
    path: Path,
) -> None:
    """Plan of one walk, and below it the anchors: heard (dots) and refused (crosses) over time."""
    figure, (plan, time) = plt.subplots(2, 1, figsize=(12, 8), height_ratios=[2, 1])
    for (name, (_, p)), grey in zip(theirs.items(), ("0.75", "0.55"), strict=True):
        plan.plot(p[:, 0], p[:, 1], ".", color=grey, ms=1.5, label=f"authors' {name}")
    plan.plot(truth[:, 0], truth[:, 1], "k", lw=1.0, label="reference")
    for (name, track), colour in zip(tracks.items(), _COLOURS, strict=True):
        p = np.array(track.p_map)
        plan.plot(p[:, 0], p[:, 1], color=colour, lw=0.7, label=name)
    anchors = np.array(list(block.anchors.values()))
    plan.plot(anchors[:, 0], anchors[:, 1], "g^", label="anchors")
    plan.set(xlim=(-8, 56), ylim=(-12, 12), xlabel="x [m]", ylabel="y [m]", aspect="equal")
    plan.legend(ncols=3, fontsize=8)
    track = list(tracks.values())[-1]
    for row, (anchor, heard) in enumerate(sorted(track.heard.items())):
        time.plot((np.array(heard) - stamps[0]) * 1e-9, np.full(len(heard), row), "|", color="0.6", ms=8)
        refused = np.array([r["stamp_ns"] for r in track.refused if r["anchor"] == anchor], np.int64)
        time.plot((refused - stamps[0]) * 1e-9, np.full(len(refused), row), "rx", ms=5)
    time.set(yticks=range(len(track.heard)), yticklabels=sorted(track.heard), xlabel="t [s]", ylabel="anchor")
    _save(figure, path)


def draw_mow(truth: Array, block: UwbBlock, tracks: dict[str, Track], path: Path) -> None:
    """Plan of the mower's way."""
    figure, plan = plt.subplots(figsize=(9, 9))
    plan.plot(truth[:, 0], truth[:, 1], "k", lw=1.0, label="reference")
    for (name, track), colour in zip(tracks.items(), ("tab:red", "0.7"), strict=True):
        p = np.array(track.p_map)
        plan.plot(p[:, 0], p[:, 1], color=colour, lw=0.6, label=name)
    anchors = np.array(list(block.anchors.values()))
    plan.plot(anchors[:, 0], anchors[:, 1], "g^", label="beacons")
    plan.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    plan.legend()
    _save(figure, path)


def _save(figure: plt.Figure, path: Path) -> None:
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)
