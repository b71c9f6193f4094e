"""Are the intersections of a map found, and only those? On a labelled map, or on procedural mines.

    python -m tools.bench.semantic_map MAP.laz --labels junctions.csv --figures DIR
    python -m tools.bench.semantic_map --procedural levels random --seeds 2 --surveys plain open_top --figures DIR

Meetings of three roadways and more count; distances are those of the invariant points from the labels, in plan
where these have no height. Each disagreement is a line and, with --figures, a picture.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from maps.las import save_laz
from maps.prior_map import read_prior_map
from semmap.geometry import Array
from semmap.intersections import SemanticMap
from tools.bench.agreement import HEADER, Agreement, Figures, Label, agreement, read_labels
from tools.build import build_database
from tools.settings import ToolSettings

SURVEYS: dict[str, dict[str, object]] = {
    "plain": {},
    "open_top": {"open_top": True},
    "things": {"vehicles": 6, "pallets": 10, "posts": 10, "conveyors": 2},
    "sparse": {"spacing": 0.3},
    "noisy": {"noise": 0.05},
    "all": {"open_top": True, "spacing": 0.2, "noise": 0.03, "vehicles": 6, "pallets": 10, "posts": 10, "conveyors": 2},
}
"""Settings of the prior map, see `tools.simulator.settings.SurveySettings`."""


@dataclass(frozen=True, slots=True, eq=False)
class Built:
    """A map's database, and what it took to build."""

    there: SemanticMap
    seconds: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("map", nargs="?", type=Path, help="a point cloud with labels")
    parser.add_argument("--labels", type=Path)
    parser.add_argument("--figures", type=Path, help="where the pictures of disagreements go")
    parser.add_argument("--procedural", nargs="*", help="built-in mines; all if none is named")
    parser.add_argument("--surveys", nargs="+", default=list(SURVEYS), choices=SURVEYS)
    parser.add_argument("--seeds", type=int, default=2)
    options = parser.parse_args()
    if options.procedural is not None:
        on_procedural_mines(options.procedural, options.surveys, options.seeds, options.figures)
    elif options.map and options.labels:
        on_labelled_map(options.map, options.labels, options.figures)
    else:
        parser.error("give a map with --labels, or --procedural")


def on_labelled_map(path: Path, labels: Path, figures: Path | None) -> None:
    """Print the figures of one map."""
    built = _built(path)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    agreed = agreement(read_labels(labels), built.there.intersections)
    print(f"{HEADER}     time      peak")
    print(f"{agreed.figures()} {built.seconds:6.1f} s {peak:6.0f} MB")
    _say_and_draw(agreed, built.there, path, figures)


def on_procedural_mines(names: list[str], surveys: list[str], seeds: int, figures: Path | None) -> None:
    """Print the figures of each mine, and the sums over the mines for each kind of survey."""
    from tools.simulator import SCENARIOS, Mine, SurveySettings, scenario, survey

    def surveyed(mine: Mine, kind: str, seed: int, out: Path) -> Path:
        save_laz(out, survey(mine, SurveySettings.model_validate(SURVEYS[kind]), seed=seed))
        return out

    total: dict[str, Figures] = {}
    print(f"{'mine':10s} {'survey':9s} {HEADER}     time")
    for name in names or SCENARIOS:
        for seed in range(1, seeds + 1):
            mine = scenario(name, seed)
            labels = [Label(str(j.id), j.p_map, np.radians(j.bearings_deg)) for j in mine.junctions]
            for kind in surveys:
                with tempfile.TemporaryDirectory() as room:
                    path = surveyed(mine, kind, seed, Path(room) / "map.laz")
                    built = _built(path)
                    agreed = agreement(labels, built.there.intersections)
                    one = agreed.figures()
                    total[kind] = total[kind] + one if kind in total else one
                    print(f"{name:8s}{seed:2d} {kind:9s} {one} {built.seconds:6.1f} s", flush=True)
                    _say_and_draw(agreed, built.there, path, figures and figures / f"{name}{seed}_{kind}")
    for kind, sums in total.items():
        print(f"{'all':10s} {kind:9s} {sums}")


def _built(path: Path) -> Built:
    """The database of a map as `semmap build` makes it, reading and saving included."""
    with tempfile.TemporaryDirectory() as room:
        begin = time.perf_counter()
        there = build_database([path], Path(room) / "mine.h5", ToolSettings())
        return Built(there, time.perf_counter() - begin)


def _say_and_draw(agreed: Agreement, there: SemanticMap, path: Path, figures: Path | None) -> None:
    for label in agreed.missed:
        print(f"  missed: label {label.id} at {_at(label.p_map)}, {len(label.bearings)} branches")
    for one in agreed.extra:
        print(f"  extra: {one.id} ({one.kind}) at {_at(one.p_map)}, quality {one.quality:.2f}")
    for label, one in agreed.unequal:
        print(f"  branches: label {label.id} has {len(label.bearings)}, {one.id} ({one.kind}) at {_at(one.p_map)}")
    if figures is not None and (agreed.missed or agreed.extra or agreed.unequal):
        from tools.bench.disagreements import draw_disagreements

        prior = read_prior_map([path])
        draw_disagreements(agreed, there, prior.points + prior.origin, figures)


def _at(p: Array) -> str:
    x, y, z = p
    return f"({x:.1f}, {y:.1f}, {z:.1f})"


if __name__ == "__main__":
    main()
