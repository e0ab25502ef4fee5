"""Seeded flights and drives with truth, from sensors as their datasheets give them.

``simulate(load_scenario("multirotor-mission"), seed=1)`` is a :class:`VehicleRecording` in memory;
:func:`write_folder` and :func:`write_tlog` put one on disk. Scenarios and their TOML form are
described in :mod:`replay.simulator.scenarios`.
"""

from replay.simulator.matching import matching_config
from replay.simulator.scenarios import SCENARIOS, Scenario, load_scenario, parse_scenario
from replay.simulator.simulation import Simulation, run, simulate

__all__ = [
    "SCENARIOS",
    "Scenario",
    "Simulation",
    "load_scenario",
    "matching_config",
    "parse_scenario",
    "run",
    "simulate",
]
