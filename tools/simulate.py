"""A simulated mine and flight into a directory, with a bar."""

from __future__ import annotations

from pathlib import Path

from tools.files import write_text
from tools.progress import progress_bar
from tools.settings import ToolSettings
from tools.simulator import Simulation, simulate


def simulate_mine(source: str, out: Path, settings: ToolSettings, *, route: Path | None = None) -> Simulation:
    """Simulate ``source`` into ``out``, with a bar, and keep the settings beside the files."""
    with progress_bar("simulating") as progress:
        done = simulate(source, out=out, route=route, seed=settings.seed, settings=settings.simulate, progress=progress)
    write_text(out / "settings.yaml", settings.to_yaml())
    return done
