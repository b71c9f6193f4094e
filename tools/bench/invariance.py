"""Does a live view give the same invariant point and the same wall contours as the map, and no other place's?

    python -m tools.bench.invariance demo:1 random:1 random:2 random:3 ramp:1 --figures DIR
    python -m tools.bench.invariance MINE/edgar_mine.ply --map MINE/prior_map.laz --figures DIR

A mine is ``scenario:seed`` or a mesh file with its point cloud. Every intersection is entered from each of its
branches, five stacked keyframes a view, and what `observe_intersections` makes of them is compared with the whole map.
A view that does not show the intersection at all is a miss everywhere. `near` are the views all of whose keyframes are
within eight metres of the intersection, `all` those whose last one is.

Scan Context is given the same clouds, see `tools.bench.scan_contexts`: around the sensor as its authors do (SC), and
around the invariant point that was found (SC@p), each the best of four variants.
"""

from __future__ import annotations

import argparse
import csv
import time
from dataclasses import fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maps.build import build_semantic_map
from maps.prior_map import read_prior_map
from semmap.intersections import SemanticMap
from tools.bench.measured import Measured, area_under_roc, best_variant, measure, own_first
from tools.bench.mines import map_of
from tools.bench.scan_contexts import VARIANTS
from tools.bench.views import approaches
from tools.simulator import Mine, load_mesh, scenario

HEAD = (
    "                         point [m]                 own is the most similar [%]    area under ROC\n"
    "mine           views seen median  p90 <=0.5  rise |  PWCV   CWC  both  SC@p    SC |  PWCV   CWC  SC@p    SC"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mines", nargs="+", help="scenario:seed, or a mesh file")
    parser.add_argument("--map", type=Path, help="point cloud of the mesh file")
    parser.add_argument("--views", type=int, default=250, help="views a mine")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pose-noise", action="store_true", help="odometry errors between the stacked keyframes")
    parser.add_argument("--figures", type=Path, help="folder for pictures and numbers")
    options = parser.parse_args()
    print(HEAD)
    for name in options.mines:
        begin = time.perf_counter()
        mine, there = mine_and_map(name, options.map)
        if not len(there):
            print(f"{name}: the map has no intersections")
            continue
        measured = measure(there, approaches(there, mine, options.views, seed=options.seed, noise=options.pose_noise))
        label = Path(name).stem
        for which, chosen in (("near", measured.near), ("all", measured.near | True)):
            print(line(f"{label:9s} {which:4s}", measured, chosen), flush=True)
        seconds = time.perf_counter() - begin
        best = [str(VARIANTS[best_variant(measured, at_point=at_point)]) for at_point in (True, False)]
        print(f"{len(there)} intersections; best contexts: {'; '.join(best)}; {seconds:.0f} s", flush=True)
        if options.figures:
            save(options.figures / label.replace(":", ""), measured)


def mine_and_map(name: str, cloud: Path | None) -> tuple[Mine, SemanticMap]:
    """The mine that rays are cast in, and its database."""
    if ":" in name and not Path(name).exists():
        plan, seed = name.rsplit(":", 1)
        mine = scenario(plan, seed=int(seed))
        return mine, map_of(mine, int(seed))
    mine = load_mesh(name)
    return mine, build_semantic_map(read_prior_map(cloud)) if cloud else map_of(mine, 0)


def line(label: str, measured: Measured, chosen: NDArray[np.bool_]) -> str:
    """One line of the table, for some of the views."""
    row, error = measured.row[chosen], measured.error[chosen]
    contexts = [measured.contexts[chosen, best_variant(measured, at_point=at_point)] for at_point in (True, False)]
    tables = [measured.pwcv[chosen], measured.cwc[chosen], *contexts]
    first = [own_first(table, row).mean() for table in tables]
    first.insert(2, (measured.matched[chosen] == row).mean())
    p50, p90 = np.percentile(error, [50.0, 90.0], method="higher")
    rise = np.percentile(measured.rise[chosen], 90.0, method="higher")
    return (
        f"{label} {len(row):5d} {100.0 * np.isfinite(error).mean():4.0f} {p50:6.2f} {p90:4.2f}"
        f" {100.0 * (error <= 0.5).mean():5.1f} {rise:5.2f} |{''.join(f'{100.0 * share:6.1f}' for share in first)} |"
        f"{''.join(f'{area_under_roc(table, row):6.3f}' for table in tables)}"
    )


def save(folder: Path, measured: Measured) -> None:
    """Pictures, everything measured as NPZ, and a CSV line a view."""
    from tools.bench.invariance_figures import save_figures

    folder.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(folder / "invariance.npz", **{f.name: getattr(measured, f.name) for f in fields(measured)})
    views = np.arange(len(measured.row))
    with (folder / "views.csv").open("w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out)
        writer.writerow(["row", "branch", "along_m", "near", "error_m", "rise_m", "pwcv", "cwc", "matched"])
        for v in views:
            own = [f"{table[v, measured.row[v]]:.4f}" for table in (measured.pwcv, measured.cwc)]
            lengths = [f"{column[v]:.3f}" for column in (measured.error, measured.rise)]
            where = [measured.row[v], measured.branch[v], f"{measured.along[v]:.2f}", int(measured.near[v])]
            writer.writerow([*where, *lengths, *own, measured.matched[v]])
    save_figures(folder, measured)


if __name__ == "__main__":
    main()
