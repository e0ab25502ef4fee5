"""``companion demo``: all processes, all transports, and what is left of them."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

PATIENCE_S = 150.0
SECONDS = 12.0


def command(folder: Path, seconds: float) -> list[str]:
    options = ["--for", str(seconds), "--out", str(folder), "--json"]
    return [sys.executable, "-m", "companion", "demo", *options]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("demo")


@pytest.fixture(scope="module")
def flown(folder: Path) -> dict[str, Any]:
    done = subprocess.run(
        command(folder, SECONDS), capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert done.returncode == 0, done.stderr
    said: dict[str, Any] = json.loads(done.stdout)
    return said


def children_of(folder: Path) -> list[str]:
    """Command lines of processes that work in ``folder``."""
    lines = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            text = path.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if str(folder) in text:
            lines.append(text)
    return lines


def test_live_equals_replay(flown: dict[str, Any]) -> None:
    digest = flown["digest"]
    assert digest["equal"] is True
    assert digest["live"] == digest["replayed"]
    assert digest["live_published"] == digest["replayed_published"]


def test_every_sample_went_in(flown: dict[str, Any]) -> None:
    counters = flown["companion"]["counters"]
    assert {"can-imu", "GPS_RAW_INT", "SCALED_PRESSURE"} <= set(flown["rates_in"])
    for trouble in ("malformed", "restarts"):
        assert counters[f"can-imu.{trouble}"] == 0
    # A machine with no time for the adapter overflows its small buffer, and the vehicle counts it.
    if not flown["vehicle"]["can_bytes_dropped"]:
        assert counters["can-imu.incomplete"] == counters["can-imu.lost"] == 0
        # The end may have come in the middle of a sample's seven frames.
        assert 0 <= counters["can-imu.frames"] - 7 * counters["can-imu.samples"] < 7
    assert counters["can-imu.samples"] == counters["engine.imu"]
    assert counters["can-imu.samples"] >= 0.9 * 200.0 * SECONDS
    assert flown["vehicle"]["timesync_answers"] > 0


def test_states_came_out_soon(flown: dict[str, Any]) -> None:
    assert flown["states_received"] > 100
    # Generous: two cores may be shared with anything. Quiet, it is around 1 ms.
    assert 0.0 < flown["latency_ms"]["p50"] < 500.0


def test_it_knew_where_it_was(flown: dict[str, Any]) -> None:
    # The receiver's own error is 1 m white and slow together, each axis: four times that.
    assert flown["position_error"]["horizontal_rms_m"] < 4.0


def test_what_is_left(flown: dict[str, Any], folder: Path) -> None:
    assert flown["directory"] == str(folder)
    names = {path.name for path in folder.iterdir()}
    assert {"demo.mcap", "demo.toml", "truth.csv", "received.csv", "companion.txt"} <= names
    assert "can" not in names, "the adapter's device goes with the vehicle"
    assert children_of(folder) == []


def test_ctrl_c_ends_all_children(tmp_path: Path) -> None:
    with subprocess.Popen(
        command(tmp_path, 60.0), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as demo:
        end = time.monotonic() + PATIENCE_S
        while len(children_of(tmp_path)) < 4 and time.monotonic() < end:
            assert demo.poll() is None
            time.sleep(0.1)
        demo.send_signal(signal.SIGINT)
        _, told = demo.communicate(timeout=PATIENCE_S)
    assert demo.returncode != 0
    assert "Traceback" not in told
    assert children_of(tmp_path) == []
