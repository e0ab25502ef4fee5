"""A simulated flight on disk: sensor folder, tlog, CAN log and truth in one directory."""

from __future__ import annotations

from pathlib import Path

import msgspec

from companion.config import Adaptation, to_toml
from companion.types import VehicleRecording
from replay.sensor_folder_writer import write_folder
from replay.simulator.can_log import write_can_log
from replay.simulator.matching import matching_config
from replay.simulator.scenarios import Scenario
from replay.simulator.simulation import simulate
from replay.simulator.tlog_writer import write_tlog


def write_flight(scenario: Scenario, seed: int, directory: Path) -> VehicleRecording:
    """Simulate into ``directory`` (made if absent) and return the recording.

    Files: the sensor folder (``imu.csv`` …, ``truth.csv``, ``vehicle.toml`` with the matching
    configuration), ``flight.tlog`` and ``imu.log`` (the IMUs on a CAN bus, as candump). Raises
    :class:`CompanionError` for a scenario that cannot be simulated and a file that cannot be
    written.
    """
    recording = simulate(scenario, seed)
    # As a user has it, who does not know that every sensor is what it says.
    config = msgspec.structs.replace(matching_config(scenario), adaptation=Adaptation())
    write_folder(recording, directory, to_toml(config))
    write_tlog(recording, directory / "flight.tlog", config.vehicle.kind)
    write_can_log(recording, directory / "imu.log")
    return recording
