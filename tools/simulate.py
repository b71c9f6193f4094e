"""A simulated mine and flight into a directory, with a bar."""

from __future__ import annotations

from pathlib import Path

from semmap.rig import Rig
from tools.files import write_text
from tools.progress import progress_bar
from tools.settings import ToolSettings
from tools.simulator import Simulation, simulate


def simulate_mine(
    source: str, out: Path, settings: ToolSettings, *, route: Path | None = None, rig: Path | None = None
) -> Simulation:
    """Simulate ``source`` into ``out``, with a bar, and keep the settings beside the files."""
    sensors = None if rig is None else Rig.from_yaml(rig)
    with progress_bar("simulating") as progress:
        done = simulate(
            source, out=out, route=route, rig=sensors, seed=settings.seed, settings=settings.simulate, progress=progress
        )
    used = settings.model_copy(update={"simulate": done.settings})
    write_text(out / "settings.yaml", used.to_yaml())
    return done


def outcome(done: Simulation) -> str:
    """What came out, for people: one line."""
    parts = [f"{done.scans} scans", f"{done.duration_s:.0f} s", f"{done.length_m:.0f} m"]
    if done.floor_shift:
        parts.append(f"the route moved up to {done.floor_shift:.1f} m up or down to the mesh's floor")
    if done.junctions is None:
        parts.append("no junctions.csv, because a mesh does not say where its intersections are")
    return f"{done.mine}: {', '.join(parts)}"
