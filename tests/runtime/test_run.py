"""The real loop on real time: CAN on python-can's virtual bus, MAVLink over UDP on loopback."""

from __future__ import annotations

import errno
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.config import CanBus, CanImu, Config, Log, Mavlink, Vehicle, Zenoh, parse, to_toml
from companion.runtime import background
from companion.runtime.loop import Stop
from companion.runtime.run import run
from companion.runtime.start import prepare
from companion.types import NS, Event, Health, ImuSamples, Outputs
from drivers.can_imu import make_encoder
from replay.player import play
from replay.run_log import read_run

RATE_HZ = 100


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def _config(tmp_path: Path, port: int, channel: str) -> Config:
    unit = CanImu(name="imu", protocol="dronecan", node_id=50)
    return Config(
        vehicle=Vehicle(name="bench"),
        can=(CanBus(channel=channel, interface="virtual", imu=(unit,)),),
        mavlink=Mavlink(endpoint=f"udpin:127.0.0.1:{port}", imu=False, request_rates=False),
        zenoh=Zenoh(enabled=False),
        log=Log(directory=str(tmp_path)),
    )


class AtRest:
    """A vehicle at rest: 100 Hz on the bus, clock and 5 Hz of fixes over UDP, in a thread."""

    def __init__(self, channel: str, port: int) -> None:
        self._bus = can.Bus(channel, "virtual")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._to = ("127.0.0.1", port)
        self._packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._stop = threading.Event()
        self.sent = 0
        self._thread = threading.Thread(target=self._send, daemon=True)

    def __enter__(self) -> AtRest:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._bus.shutdown()
        self._socket.close()

    def _send(self) -> None:
        encoder = make_encoder("dronecan", node_id=50)
        rng = np.random.default_rng(1)
        begun = time.monotonic()
        while not self._stop.is_set():
            one, t = np.ones(1, np.int64), time.monotonic() - begun
            gyro = rng.normal(0.0, 0.002, (1, 3))
            accel = np.array([[0.0, 0.0, -9.81]]) + rng.normal(0.0, 0.02, (1, 3))
            block = ImuSamples("imu", one, one, one, gyro, accel, np.full(1, 1 / RATE_HZ))
            for frame in encoder.encode(block):
                self._bus.send(
                    can.Message(arbitration_id=frame.can_id, is_extended_id=True, data=frame.data)
                )
            if self.sent % RATE_HZ == 0:
                self._mavlink(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
            if self.sent % (RATE_HZ // 10) == 0:
                self._mavlink(mavlink.MAVLink_system_time_message(0, _boot_us(t) // 1000))
            if self.sent % (RATE_HZ // 5) == 0:
                self._mavlink(_fix(t))
            self.sent += 1
            self._stop.wait(max(0.0, self.sent / RATE_HZ - (time.monotonic() - begun)))

    def _mavlink(self, message: Any) -> None:
        self._socket.sendto(message.pack(self._packer), self._to)


def _boot_us(t: float) -> int:
    return round(t * 1e6) + 10_000_000


def _fix(t: float) -> Any:
    return mavlink.MAVLink_gps_raw_int_message(
        _boot_us(t), 3, 473_000_000, 85_000_000, 500_000, 80, 80, 0, 0, 12,
        alt_ellipsoid=547_000, h_acc=500, v_acc=800, vel_acc=100,
    )  # fmt: skip


class Watcher:
    """A publisher that keeps what it is given, and does something at a moment of the run."""

    def __init__(self, at_states: int = 0, act: Callable[[], None] = lambda: None) -> None:
        self.states = 0
        self.events: list[Event] = []
        self.reports: list[Health] = []
        self.toml = ""
        self.closed = False
        self._at, self._act = at_states, act

    def publish(self, outputs: Outputs, arrival_monotonic_ns: int) -> None:
        assert 0 <= time.monotonic_ns() - arrival_monotonic_ns < 60 * NS
        before, self.states = self.states, self.states + len(outputs.published)
        if before < self._at <= self.states:
            self._act()

    def event(self, event: Event) -> None:
        self.events.append(event)

    def health(self, health: Health) -> None:
        self.reports.append(health)

    def config(self, toml: str) -> None:
        self.toml = toml

    def notices(self) -> list[Any]:
        return []

    def close(self) -> None:
        self.closed = True

    def kinds(self) -> list[str]:
        return [event.kind for event in self.events]


def _run(tmp_path: Path, watcher: Watcher, stop: Stop, seconds: float = 60.0) -> dict[str, Any]:
    channel, port = f"test-{tmp_path.name}", _free_port()
    start = prepare(_config(tmp_path, port, channel), tmp_path / "run.mcap")
    with AtRest(channel, port):
        return run(start, tmp_path, seconds=seconds, publishers=[watcher], stop=stop)


def _replays(path: Path, summary: dict[str, Any]) -> bool:
    """Whether the log gives the digests of the run, with the configuration that it holds."""
    recording = read_run(path)
    (vehicle,) = recording.vehicles
    assert recording.config_toml is not None
    engine = play(vehicle, parse(recording.config_toml))
    digests = (engine.digest, engine.digest_published)
    return digests == (summary["digest"], summary["digest_published"])


def test_a_run_on_real_time(tmp_path: Path) -> None:
    stop = Stop()
    watcher = Watcher(150, stop.ask)
    summary = _run(tmp_path, watcher, stop)
    assert watcher.states >= 150, (watcher.kinds(), summary["counters"])
    assert watcher.closed
    assert {"link-up", "imu-chosen", "gnss-chosen", "autopilot-found"} <= set(watcher.kinds())
    assert [i["source"] for i in summary["inputs"]] == ["imu", "GPS_RAW_INT"]
    assert summary["counters"]["imu.samples"] == summary["counters"]["engine.imu"]
    assert summary["log_dropped_bytes"] == 0
    assert summary["latency_ms"]["p50"] > 0
    last = watcher.reports[-1]
    assert {link.name: link.state for link in last.links}["mavlink"] == "up"
    assert last.loop.load > 0
    recording = read_run(tmp_path / "run.mcap")
    assert recording.notes == ()
    assert recording.config_toml == watcher.toml
    assert _replays(tmp_path / "run.mcap", summary)


def test_a_disk_that_is_full_for_a_while(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full = threading.Event()
    write = os.write

    def refusing(fd: int, data: bytes) -> int:
        if full.is_set():
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(fd, data)

    monkeypatch.setattr(background.os, "write", refusing)
    stop = Stop()

    class Scene(Watcher):
        """Full from the first states on; room again once that was said; then the end."""

        def event(self, event: Event) -> None:
            super().event(event)
            if event.kind == "log-stopped":
                full.clear()
            elif event.kind == "log-resumed":
                stop.ask()

    watcher = Scene(20, full.set)
    summary = _run(tmp_path, watcher, stop)
    kinds = watcher.kinds()
    assert kinds.index("log-stopped") < kinds.index("log-resumed")
    assert summary["log_dropped_bytes"] == 0
    assert _replays(tmp_path / "run.mcap", summary)


def _companion(tmp_path: Path, *arguments: str) -> subprocess.Popen[bytes]:
    config = _config(tmp_path, _free_port(), "nobody")
    path = tmp_path / "live.toml"
    path.write_text(to_toml(config))
    return subprocess.Popen(
        [sys.executable, "-m", "companion", "run", str(path), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_process_cleanly(tmp_path: Path, number: signal.Signals) -> None:
    """With nothing on its links; systemd is told when it is ready and when it ends."""
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd,
        pytest.MonkeyPatch.context() as m,
    ):
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(300)
        m.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        m.setenv("WATCHDOG_USEC", "1000000")
        process = _companion(tmp_path, "--log", str(tmp_path / "run.mcap"), "--json")
        told = []
        while b"WATCHDOG=1" not in told:
            told.append(systemd.recv(200))
        process.send_signal(number)
        out, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
        systemd.setblocking(False)
        while b"STOPPING=1" not in told:
            told.append(systemd.recv(200))
    assert told[0] == b"READY=1"
    summary = json.loads(out)
    assert summary["mode"] == "aligning"
    assert "Traceback" not in err.decode()
    assert read_run(tmp_path / "run.mcap").notes == ()


def test_what_cannot_be_run_is_one_line(tmp_path: Path) -> None:
    process = _companion(tmp_path, "--log", "/proc/nowhere/run.mcap")
    _, err = process.communicate(timeout=300)
    assert process.returncode == 1
    last = err.decode().strip().splitlines()[-1]
    assert last.startswith("error: /proc/nowhere")
