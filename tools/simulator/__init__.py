"""Simulated mines and sensors: a plan or a mesh, a flight through it, and what its sensors would say.

>>> from tools.simulator import fly, scenario, simulate_measurements
>>> flight = fly(scenario("demo", seed=1))
>>> stream = simulate_measurements(flight)

`simulate` writes the same as files. Names are imported when they are first used, because they bring Open3D
with them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tools.simulator.flight import Flight, fly
    from tools.simulator.measurements import simulate_measurements
    from tools.simulator.mine import Mine, dig, load_mesh, scenario
    from tools.simulator.record import Simulation, simulate
    from tools.simulator.rigs import default_rig, with_total_station, with_uwb, with_uwb_along
    from tools.simulator.roadways import MineScenario, Roadway
    from tools.simulator.route import load_route
    from tools.simulator.scenarios import SCENARIOS, plan
    from tools.simulator.settings import MotionSettings, SensorFaults, SimulationSettings, SurveySettings
    from tools.simulator.surveying import survey

_HOMES = {
    "flight": ("Flight", "fly"),
    "measurements": ("simulate_measurements",),
    "mine": ("Mine", "dig", "load_mesh", "scenario"),
    "record": ("Simulation", "simulate"),
    "rigs": ("default_rig", "with_total_station", "with_uwb", "with_uwb_along"),
    "roadways": ("MineScenario", "Roadway"),
    "route": ("load_route",),
    "scenarios": ("SCENARIOS", "plan"),
    "settings": ("MotionSettings", "SensorFaults", "SimulationSettings", "SurveySettings"),
    "surveying": ("survey",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "SCENARIOS",
    "Flight",
    "Mine",
    "MineScenario",
    "MotionSettings",
    "Roadway",
    "SensorFaults",
    "Simulation",
    "SimulationSettings",
    "SurveySettings",
    "default_rig",
    "dig",
    "fly",
    "load_mesh",
    "load_route",
    "plan",
    "scenario",
    "simulate",
    "simulate_measurements",
    "survey",
    "with_total_station",
    "with_uwb",
    "with_uwb_along",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
