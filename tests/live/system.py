"""A companion beside a simulated vehicle, as processes, for the fault tests."""

from __future__ import annotations

import re
import time
from pathlib import Path

import msgspec

from companion.config import Config, Live, to_toml
from replay.children import Child
from replay.simulator.live.client import VehicleProcess
from replay.simulator.live.scenario import NODE_ID, live_config, live_scenario

PATIENCE_S = 60.0
"""For anything at all on a machine that does other things too."""
FLIGHT_S, REST_S, IMU_HZ = 900.0, 8.0, 100.0
"""The flight outlasts all tests of a module, however slow the machine is: they share a vehicle, and
one that has landed and gone fails the last of them."""


class Companion(Child):
    """``companion run`` with its events as they are printed."""

    def __init__(self, config: Path, log: Path) -> None:
        self.text = log.with_suffix(".txt")
        arguments = ["companion", "run", str(config), "--log", str(log), "--json"]
        super().__init__("companion run", arguments, self.text)
        self._seen = 0

    def events(self) -> list[str]:
        """Lines ``kind: text`` of all events so far."""
        lines = self.text.read_text(encoding="utf-8", errors="replace").splitlines()
        found = (re.match(r"\d\d:\d\d:\d\d  (.*)", line) for line in lines)
        return [match[1] for match in found if match]

    def await_event(self, start: str) -> str:
        """Wait for an event that begins with ``start``, later than those awaited before."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            events = self.events()
            for at in range(self._seen, len(events)):
                if events[at].startswith(start):
                    self._seen = at + 1
                    return events[at]
            if self.wait(0.05):
                break
        raise AssertionError(f"no event '{start}' in {self.events()[-8:]}; {self.last_words()}")

    def await_events(self, *starts: str) -> None:
        """Wait for events that may come in any order, later than those awaited before."""
        begin, last = self._seen, self._seen
        for start in starts:
            self._seen = begin
            self.await_event(start)
            last = max(last, self._seen)
        self._seen = last

    def cpu_s(self) -> float:
        """CPU time of the process so far."""
        text = Path(f"/proc/{self.pid}/stat").read_text(encoding="ascii")
        user, system = text.rpartition(")")[2].split()[11:13]
        return (int(user) + int(system)) / 100.0


def vehicle_at(folder: Path) -> VehicleProcess:
    """A vehicle whose adapter appears in ``folder``."""
    arguments = ["--mavlink", "udpin:127.0.0.1:0", "--can", str(folder / "can")]
    arguments += ["--node", str(NODE_ID), "--imu-rate", str(IMU_HZ), "--rest", str(REST_S)]
    return VehicleProcess([*arguments, "--seconds", str(FLIGHT_S)])


def config_beside(
    vehicle: VehicleProcess, folder: Path, zenoh: str, imu_hz: float = 100.0
) -> Config:
    """Configuration of a companion beside ``vehicle``."""
    scenario = live_scenario(FLIGHT_S, REST_S, imu_hz)
    device = vehicle.ready["can"]
    config = live_config(scenario, vehicle.ready["mavlink"], device, zenoh, str(folder))
    # Five fixes a second: one second of silence is plenty, and keeps these tests short.
    return msgspec.structs.replace(config, live=Live(gnss_timeout_s=1.0))


def written(config: Config, folder: Path, name: str = "vehicle.toml") -> Path:
    """The configuration as a file."""
    path = folder / name
    path.write_text(to_toml(config), encoding="utf-8")
    return path
