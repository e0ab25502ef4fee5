"""The simulated vehicle as a process, seen from the companion's side of its links."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.types import CompanionError
from replay.simulator.live.client import VehicleProcess

PATIENCE_S = 20.0


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[VehicleProcess]:
    folder = tmp_path_factory.mktemp("vehicle")
    arguments = ["--mavlink", "udpin:127.0.0.1:0", "--can", str(folder / "can"), "--imu-rate"]
    arguments += ["100", "--truth", str(folder / "truth.csv")]
    with VehicleProcess(arguments) as process:
        yield process


class Ground:
    """A UDP socket that speaks to the vehicle."""

    def __init__(self, endpoint: str) -> None:
        _, host, port = endpoint.split(":")
        self.mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
        self.mav.robust_parsing = True
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect((host, int(port)))
        self.socket.settimeout(0.2)

    def send(self, message: Any) -> None:
        self.socket.send(message.pack(self.mav))

    def until(self, wanted: Callable[[Any], bool]) -> Any:
        """The first message that is ``wanted``, saying hello until it comes."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            self.send(self.mav.heartbeat_encode(18, 8, 0, 0, 4))
            try:
                data = self.socket.recv(65_536)
            except (TimeoutError, ConnectionError):
                continue
            for message in self.mav.parse_buffer(data) or []:
                if wanted(message):
                    return message
        raise AssertionError("the vehicle did not say it")

    def knock(self) -> None:
        """Send until the kernel says that nobody listens."""
        for _ in range(100):
            self.send(self.mav.heartbeat_encode(18, 8, 0, 0, 4))
            time.sleep(0.01)


@pytest.fixture
def ground(vehicle: VehicleProcess) -> Iterator[Ground]:
    ground = Ground(vehicle.ready["mavlink"])
    yield ground
    ground.socket.close()


def named(name: str) -> Callable[[Any], bool]:
    return lambda message: message.get_type() == name


def test_it_says_where_it_is_and_flies(vehicle: VehicleProcess, ground: Ground) -> None:
    assert vehicle.ready["mavlink"].startswith("udpout:127.0.0.1:")
    assert ground.until(named("GPS_RAW_INT")).fix_type == 3
    truth = Path(vehicle.ready["can"]).with_name("truth.csv").read_text(encoding="ascii")
    first_ns = int(truth.splitlines()[1].split(",")[0])
    assert first_ns == vehicle.ready["start_unix_ns"]


def test_endpoint_killed_and_back_at_its_port(vehicle: VehicleProcess, ground: Ground) -> None:
    ground.until(named("HEARTBEAT"))
    vehicle.fault("mavlink-down")
    with pytest.raises(ConnectionError):  # the port is closed: the kernel says so
        ground.knock()
    vehicle.fault("mavlink-down", on=False)
    assert ground.until(named("HEARTBEAT"))


def test_reboot_starts_the_clock_again(vehicle: VehicleProcess, ground: Ground) -> None:
    assert ground.until(named("SYSTEM_TIME")).time_boot_ms > 20_000
    vehicle.fault("autopilot-reboot", for_s=0.3)
    young = ground.until(lambda m: m.get_type() == "SYSTEM_TIME" and m.time_boot_ms < 5000)
    assert young.time_unix_usec > vehicle.ready["start_unix_ns"] // 1000


def adapter(path: Path, bitrate: int = 1_000_000) -> can.BusABC:
    return can.Bus(str(path), interface="slcan", bitrate=bitrate, sleep_after_open=0.0)


def unplugged_while_open(vehicle: VehicleProcess, path: Path) -> None:
    with adapter(path) as bus:
        heard = [bus.recv(PATIENCE_S) for _ in range(14)]
        assert {m.arbitration_id >> 8 & 0xFFFF for m in heard if m is not None} == {1003}
        vehicle.fault("can-gone")


def test_frames_through_the_adapter_and_its_loss(vehicle: VehicleProcess) -> None:
    path = Path(vehicle.ready["can"])
    with pytest.raises(can.CanError, match="Could not write"):  # its last word, "close"
        unplugged_while_open(vehicle, path)
    assert not path.exists()
    vehicle.fault("can-gone", on=False)
    with adapter(path) as bus:
        assert bus.recv(PATIENCE_S) is not None


def test_a_wrong_bit_rate_hears_nothing(vehicle: VehicleProcess) -> None:
    with adapter(Path(vehicle.ready["can"]), 500_000) as bus:
        assert bus.recv(0.5) is None


def test_counts_and_bad_orders(vehicle: VehicleProcess, ground: Ground) -> None:
    ground.until(named("HEARTBEAT"))
    counts = vehicle.counts()
    assert counts["can_samples"] > 0
    assert counts["mavlink_received"]["HEARTBEAT"] > 0
    with pytest.raises(CompanionError, match="share: between 0 and 1"):
        vehicle.fault("can-loss", share=7.0)


def test_end_and_a_start_that_fails() -> None:
    with VehicleProcess(["--mavlink", "udpin:127.0.0.1:0"]) as short:
        taken = short.ready["mavlink"].rpartition(":")[2]
        with (
            pytest.raises(CompanionError, match="Address already in use"),
            VehicleProcess(["--mavlink", f"udpin:127.0.0.1:{taken}"]),
        ):
            pass
        assert short.end()["mavlink_sent"]["HEARTBEAT"] >= 1
