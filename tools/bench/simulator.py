"""What the simulator costs: digging each built-in mine, and ten simulated seconds of the default rig.

Run it as ``python -m tools.bench.simulator``; it takes about a minute.
"""

from __future__ import annotations

import time

from semmap.measurements import Scan
from tools.simulator import SCENARIOS, SimulationSettings, fly, scenario, simulate_measurements

START_S, SECONDS = 20.0, 10.0


def main() -> None:
    """Print one line a mine."""
    print(f"{'mine':8} {'triangles':>10} {'dig [s]':>8} {'fly [s]':>8} {f'{SECONDS:.0f} s of sensors [s]':>22}")
    for name in SCENARIOS:
        begin = time.perf_counter()
        mine = scenario(name)
        dug = time.perf_counter()
        flight = fly(mine, settings=SimulationSettings(start_s=START_S, duration_s=SECONDS))
        ready = time.perf_counter()
        scans = sum(isinstance(m, Scan) for m in simulate_measurements(flight))
        done = time.perf_counter()
        assert scans == round(SECONDS * 10)
        print(
            f"{name:8} {len(mine.triangles):10} {dug - begin:8.2f} {ready - dug:8.2f} {done - ready:22.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
