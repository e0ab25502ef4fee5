"""``companion check`` against a simulated vehicle, over real links."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from replay.children import free_port
from replay.simulator.live.client import VehicleProcess

PATIENCE_S = 120.0


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[VehicleProcess]:
    device = tmp_path_factory.mktemp("check") / "can"
    arguments = ["--mavlink", "udpin:127.0.0.1:0", "--can", str(device), "--rest", "100"]
    arguments += ["--receiver", "tcp", "--receiver-protocol", "rtcm3"]
    with VehicleProcess([*arguments, "--imu-rate", "100"]) as process:
        yield process


def configuration(folder: Path, vehicle: VehicleProcess, node: int) -> Path:
    path = folder / "vehicle.toml"
    path.write_text(
        f'[[can]]\ninterface = "slcan"\nchannel = "{vehicle.ready["can"]}"\n'
        f'[[can.imu]]\nname = "can-imu"\nprotocol = "dronecan"\nnode_id = {node}\n'
        f'[mavlink]\nendpoint = "{vehicle.ready["mavlink"]}"\ngnss_rate_hz = 5.0\n'
        f'[raw_gnss]\nendpoint = "{vehicle.ready["receiver"]}"\nprotocol = "rtcm3"\n'
        'coupling = "tight"\n'
        f'[zenoh]\nlisten = ["tcp/127.0.0.1:{free_port()}"]\n'
        f'[log]\ndirectory = "{folder / "logs"}"\n',
        encoding="utf-8",
    )
    return path


def check(path: Path, seconds: float) -> tuple[int, dict[str, Any], str]:
    command = [sys.executable, "-m", "companion", "check", str(path), "--for", str(seconds)]
    done = subprocess.run(
        [*command, "--json"], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    return done.returncode, json.loads(done.stdout), done.stderr


def test_all_is_heard(vehicle: VehicleProcess, tmp_path: Path) -> None:
    status, said, text = check(configuration(tmp_path, vehicle, 42), 6.0)
    assert status == 0, text
    assert said["ok"] is True
    rates = {imu["source"]: imu["rate_hz"] for imu in said["imus"]}
    # On a loaded machine frames come late, not never: the mean over seconds stays.
    assert rates["can-imu"] == pytest.approx(100.0, rel=0.1)
    assert said["can"][0]["ids"][0]["extended"] is True
    assert said["mavlink"]["vehicle"] == [1, 1]
    assert said["mavlink"]["systems"][0]["autopilot"] == "ArduPilot"
    assert {s["source"] for s in said["streams"]} >= {"GPS_RAW_INT", "SCALED_PRESSURE"}
    assert "ArduPilot, system 1" in text
    assert said["receiver"]["rate_hz"] == pytest.approx(5.0, rel=0.2)
    assert said["receiver"]["satellites"]["GPS"] >= 4
    assert said["receiver"]["ephemerides"]
    assert "raw GNSS at " in text


def test_a_wrong_node_number_is_put_right(vehicle: VehicleProcess, tmp_path: Path) -> None:
    status, said, _ = check(configuration(tmp_path, vehicle, 7), 1.0)
    assert status == 1
    (wrong,) = [f for f in said["findings"] if f["part"] == "can-imu"]
    assert wrong["level"] == "error"
    assert "set node_id = 42" in wrong["advice"]


def test_nothing_there(tmp_path: Path) -> None:
    path = tmp_path / "none.toml"
    path.write_text(
        '[mavlink]\nendpoint = "/dev/no-such-device"\n[zenoh]\nenabled = false\n'
        f'[log]\ndirectory = "{tmp_path}"\n',
        encoding="utf-8",
    )
    status, said, text = check(path, 1.0)
    assert status == 1
    assert "Traceback" not in text
    assert [f["part"] for f in said["findings"] if f["level"] == "error"] == [
        "/dev/no-such-device",
        "imu",
        "gnss",
    ]


@pytest.mark.parametrize("text", ["", "[imu]\nlatency = 1\n"])
def test_configurations_without_a_link_or_sense(tmp_path: Path, text: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    status, said, told = check(path, 1.0)
    assert status == 1
    assert str(path) in said["error"]
    assert "Traceback" not in told
