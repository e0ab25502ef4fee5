"""``companion watch`` against a publisher, and ``companion replay --publish``."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from companion.config import Zenoh
from companion.outputs.subscriber import Subscriber
from companion.outputs.zenoh_publisher import ZenohPublisher
from companion.outputs.zenoh_settings import client_settings
from companion.types import Channel, Event
from companion.watch.picture import Fleet
from tests.outputs.test_zenoh_publisher import HEALTH
from tests.outputs.zenoh_help import PATIENCE_S, T0, free_port, outputs, report, solution, wait_for


@contextmanager
def publishing(endpoint: str, vehicle: str = "v1") -> Iterator[ZenohPublisher]:
    """A vehicle that publishes until the end."""
    stop = threading.Event()
    with closing(ZenohPublisher(Zenoh(listen=(endpoint,)), vehicle)) as publisher:
        assert publisher.link.wait_open(PATIENCE_S)
        publisher.event(Event(T0, "aligned", "level and heading"))

        def fly() -> None:
            k = 0
            while not stop.wait(0.02):
                publisher.publish(outputs(solution(first=k), report(Channel.BARO)), 1)
                if k % 50 == 0:
                    publisher.health(HEALTH)
                k += 1

        thread = threading.Thread(target=fly)
        thread.start()
        try:
            yield publisher
        finally:
            stop.set()
            thread.join()


def watch(*args: str, timeout: float = 60.0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "companion", "watch", *args]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)


def test_one_picture_as_text_and_as_json() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with publishing(endpoint):
        ran = watch("--once", "--connect", endpoint)
        assert ran.returncode == 0, ran.stderr
        assert "Vehicle v1  NAVIGATING" in ran.stdout
        assert "aligned: level and heading" in ran.stdout
        assert "\x1b[" not in ran.stdout  # no terminal, no colours
        ran = watch("--json", "--vehicle", "v1", "--connect", endpoint)
    assert ran.returncode == 0, ran.stderr
    picture = json.loads(ran.stdout)
    assert (picture["vehicle"], picture["is"]) == ("v1", "navigating")
    assert picture["gates"]["baro"]["accepted"] > 0
    assert picture["health"]["text"] == "GNSS silent"
    assert [e["kind"] for e in picture["events"]] == ["aligned"]


def test_nobody_there_is_one_line() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    ran = watch("--once", "--connect", endpoint)
    assert ran.returncode == 1
    assert ran.stderr == (
        f"error: {endpoint}: nobody listens there; is a companion running, or another --connect?\n"
    )
    ran = watch("--once", "--connect", "nonsense")
    assert ran.returncode == 1
    assert ran.stderr.startswith("error: zenoh.connect: 'nonsense' is no endpoint")


def test_another_vehicle_is_not_shown() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with publishing(endpoint):
        ran = watch("--once", "--vehicle", "v2", "--connect", endpoint)
    assert ran.returncode == 1
    assert ran.stderr == f"error: {endpoint}: connected, and no vehicle publishes\n"


def test_following_prints_pictures_and_ends_with_an_interrupt() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-u", "-m", "companion", "watch", "--connect", endpoint]
    with (
        publishing(endpoint),
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run,
    ):
        assert run.stdout is not None
        heads = (line for line in run.stdout if line.startswith("Vehicle v1"))
        assert "NAVIGATING" in next(heads)
        assert "NAVIGATING" in next(heads)
        run.send_signal(signal.SIGINT)
        _, err = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 0
    assert "Traceback" not in err


def test_subscriber_waits_for_a_vehicle_and_finds_it_again() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    fleet = Fleet()

    def listen() -> None:
        for heard in subscriber.take(0.05):
            fleet.update(heard, 0)

    def alive() -> bool | None:
        listen()
        return fleet.vehicles["v1"].alive if fleet.vehicles else None

    with closing(Subscriber(lambda: client_settings(endpoint))) as subscriber:
        for _ in range(2):
            with publishing(endpoint):
                wait_for(lambda: alive() is True, "appears")
            wait_for(lambda: alive() is False, "vanishes")


@pytest.fixture
def replayed(sample_flight: Path, tmp_path: Path) -> Iterator[str]:
    """The sample flight, published ten times as fast; its endpoint."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = tmp_path / "c.toml"
    config.write_text(f'[zenoh]\nlisten = ["{endpoint}"]\n')
    command = [sys.executable, "-m", "companion", "replay", str(sample_flight), "--publish",
               "--speed", "10", "--config", str(config), "--out", str(tmp_path / "x")]  # fmt: skip
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as run:
        yield endpoint
        run.send_signal(signal.SIGINT)
        run.wait()


def test_a_replay_is_seen_as_a_live_run_is(replayed: str) -> None:
    fleet = Fleet()
    times: list[int] = []

    def seen() -> bool:
        for heard in subscriber.take(0.05):
            fleet.update(heard, 0)
            vehicle = fleet.vehicles[heard.vehicle]
            if heard.name == "nav/state":
                times.append(vehicle.state.t_ns)
        v = next(iter(fleet.vehicles.values()), None)
        return v is not None and v.health is not None and len(times) > 500

    with closing(Subscriber(lambda: client_settings(replayed))) as subscriber:
        wait_for(seen, "a replayed flight")
    (v,) = fleet.vehicles.values()
    assert v.health is not None
    kinds = {s.kind: s for s in v.health.sensors}
    assert kinds["imu"].rate_hz == pytest.approx(100.0, rel=0.1)
    assert kinds["gnss"].state == "ok"
    assert Channel.GNSS_POSITION_H in v.gates
    # Paced finely: at ten times real time, blocks of 40 ms carry 0.4 s of the log.
    assert (times[-1] - times[0]) / 1e9 == pytest.approx(len(times) / 50, rel=0.35)
