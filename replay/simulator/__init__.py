"""Seeded flights and drives with truth, from sensors as their datasheets give them.

``simulate(load_scenario("multirotor-mission"), seed=1)`` is a ``VehicleRecording`` in memory;
:func:`write_flight` puts one on disk. Scenarios and their TOML form are described in
:mod:`replay.simulator.scenarios`.
"""

from replay.sensor_folder_writer import write_folder
from replay.simulator.flight import write_flight
from replay.simulator.matching import matching_config
from replay.simulator.scenarios import SCENARIOS, Scenario, load_scenario, parse_scenario
from replay.simulator.simulation import Simulation, run, simulate
from replay.simulator.tlog_writer import write_tlog

__all__ = [
    "SCENARIOS",
    "Scenario",
    "Simulation",
    "load_scenario",
    "matching_config",
    "parse_scenario",
    "run",
    "simulate",
    "write_flight",
    "write_folder",
    "write_tlog",
]
