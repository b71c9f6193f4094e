"""The figures of paper 000 over all systems: x and z against time (Fig. 6), variances against the way (Fig. 8)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from semmap.trajectory import Trajectory
from tools import metrics
from tools.bench.coal_runs import OURS, placed
from tools.report.colours import BLUE, FAINT, GREEN, INK, ORANGE, PINK, RED, SKY, YELLOW
from tools.report.figures import look
from tools.report.uncertainty import read_uncertainties

_COLOURS = dict(zip(OURS, (GREEN, RED, SKY, ORANGE, BLUE, PINK), strict=True))
_MORE = (YELLOW, FAINT)
_LEAST = 1e-5
"""[m²] the lower end of the variances' axis."""
_MARGIN = 5.0
"""[m] beyond the truth that the axes of positions show; who slides farther leaves the figure."""


def draw_tracks(out: Path, truth: Trajectory, tracks: dict[str, Trajectory]) -> None:
    """X and Z of every track against time, with the truth, as a PNG."""
    with look():
        fig = Figure(figsize=(9.5, 5.0))
        panels = fig.subplots(2, 1, sharex=True)
        for axes, axis in zip(panels, (0, 2), strict=True):
            for number, (name, track) in enumerate(tracks.items()):
                colour = _COLOURS.get(name, _MORE[number % len(_MORE)])
                seconds = (track.stamps_ns - truth.stamps_ns[0]) * 1e-9
                axes.plot(seconds, track.positions[:, axis], color=colour, linewidth=1.2, label=name)
            true = truth.positions[:, axis]
            axes.plot(
                (truth.stamps_ns - truth.stamps_ns[0]) * 1e-9, true, "--", color=INK, linewidth=1.0, label="truth"
            )
            axes.set_ylim(true.min() - _MARGIN, true.max() + _MARGIN)
            axes.set_ylabel(f"{'xyz'[axis]} [m]")
        panels[-1].set_xlabel("time [s]")
        fig.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
        fig.savefig(out, dpi=110)


def draw_variances(out: Path, truth: Trajectory, runs: dict[str, Path]) -> None:
    """Variances of x and z of the filter against the true way, one line a configuration, as a PNG."""
    steps = np.linalg.norm(np.diff(truth.positions, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    with look():
        fig = Figure(figsize=(9.5, 5.0))
        panels = fig.subplots(2, 1, sharex=True)
        for axes, axis in zip(panels, (0, 2), strict=True):
            for name, run in runs.items():
                known = read_uncertainties(run / "uncertainty.csv")
                at = np.interp(known.stamps_ns, truth.stamps_ns, way)
                variance = np.maximum(known.position[:, axis, axis], _LEAST)
                axes.plot(at, variance, color=_COLOURS[name], linewidth=1.2, label=f"{name}, in {known.frame}")
            axes.set_yscale("log")
            axes.set_ylabel(f"variance of {'xyz'[axis]} [m²]")
        panels[-1].set_xlabel("way [m]")
        fig.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
        fig.savefig(out, dpi=110)


def figures(directory: Path, truth: Trajectory, peers: dict[str, Path]) -> None:
    """Both figures of one seed's ``directory``: our run directories in it, and ``peers``, TUM files by name."""
    runs = {name: directory / name.replace(" ", "-") for name in OURS}
    runs = {name: run for name, run in runs.items() if (run / "trajectory.tum").is_file()}
    found = {name: Trajectory.load_tum(run / "trajectory.tum") for name, run in runs.items()}
    for name, path in peers.items():
        read = Trajectory.load_tum(path)
        found[name] = Trajectory("odom", read.stamps_ns, read.poses)
    tracks = {name: placed(track, metrics.associate(track, truth)) for name, track in found.items() if len(track)}
    draw_tracks(directory / "tracks.png", truth, tracks)
    if runs:
        draw_variances(directory / "variances.png", truth, runs)
