"""Configurations for live vehicles: what each kind must have, and files that belong together."""

from __future__ import annotations

from pathlib import Path

import cantools.database
import pytest

from companion.config import Config, load

CONFIGS = Path(__file__).resolve().parent.parent / "configs"
LIVE = ("multirotor", "rover", "sitl", "autopilot-imu")


@pytest.mark.parametrize("name", LIVE)
def test_each_kind_hears_an_autopilot(name: str) -> None:
    config = load(CONFIGS / f"{name}.toml")
    assert config.mavlink.endpoint
    assert config.to_autopilot.message == "off"
    assert all("127.0.0.1" in listen for listen in config.zenoh.listen)


def units(config: Config) -> list[str]:
    return [imu.protocol for bus in config.can for imu in bus.imu]


def test_each_kind_has_its_imu() -> None:
    protocols = {name: units(load(CONFIGS / f"{name}.toml")) for name in LIVE}
    assert protocols == {
        "multirotor": ["dronecan"],
        "rover": ["dbc"],
        "sitl": [],
        "autopilot-imu": [],
    }


def test_the_rover_s_signals_are_in_its_dbc() -> None:
    (imu,) = load(CONFIGS / "rover.toml").can[0].imu
    assert imu.dbc is not None
    database = cantools.database.load_file(CONFIGS / imu.dbc.file)
    assert isinstance(database, cantools.database.can.Database)
    signals = {s.name: s for message in database.messages for s in message.signals}
    wanted = [*imu.dbc.gyro_signals, *imu.dbc.accel_signals]
    assert {imu.dbc.time_signal, imu.dbc.counter_signal, *wanted} <= set(signals)
    assert imu.dbc.complete_on in {message.name for message in database.messages}
    # The full scale that is configured must be reachable on the wire.
    assert all(signals[s].maximum >= imu.gyro_range_dps for s in imu.dbc.gyro_signals)
    assert all(signals[s].maximum >= imu.accel_range_mps2 for s in imu.dbc.accel_signals)
    assert {signals[s].unit for s in imu.dbc.gyro_signals} == {imu.dbc.gyro_unit}
    assert {signals[s].unit for s in imu.dbc.accel_signals} == {imu.dbc.accel_unit}
