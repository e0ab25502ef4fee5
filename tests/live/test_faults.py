"""Faults against the running process: each is declared, each passes, and the log has the rest.

One companion lives through all faults of its sensors and links in a row; what it said at each is
looked at by a test of its own.
"""

from __future__ import annotations

import signal
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from companion.types import NS, Recording
from replay.children import free_port
from replay.configuration import choose_config
from replay.reader import read_log
from replay.run_log import RunResult, read_solution
from replay.session import run_session

from .system import PATIENCE_S, Companion, config_beside, vehicle_at, written


@dataclass
class Lived:
    """What one companion went through."""

    said: dict[str, list[str]]
    """Events awaited at each fault."""
    faults_ns: dict[str, int]
    """When each began."""
    summary: dict[str, Any]
    counts: dict[str, Any]
    stored: RunResult
    recording: Recording


@pytest.fixture(scope="module")
def lived(tmp_path_factory: pytest.TempPathFactory) -> Lived:
    folder = tmp_path_factory.mktemp("faults")
    log = folder / "faults.mcap"
    said: dict[str, list[str]] = {}
    began: dict[str, int] = {}
    with vehicle_at(folder) as vehicle:
        path = written(config_beside(vehicle, folder, f"tcp/127.0.0.1:{free_port()}"), folder)
        with Companion(path, log) as companion:
            companion.await_event("aligned")

            def suffer(name: Any, for_s: float, *events: str) -> None:
                began[name] = vehicle.fault(name, for_s=for_s)
                said[name] = [companion.await_event(event) for event in events]

            suffer("imu-silent", 1.2, "imu-silent: IMU can-imu", "imu-back: IMU can-imu")
            suffer("gnss-silent", 1.6, "gnss-silent", "gnss-back")
            suffer("mavlink-down", 6.0, "gnss-silent", "autopilot-silent", "gnss-back")
            asked = vehicle.counts()["mavlink_received"]["COMMAND_LONG"]
            began["autopilot-reboot"] = vehicle.fault("autopilot-reboot", for_s=1.0)
            # Its new clock may be noticed by the first fix that is back, or before or after it.
            companion.await_events("autopilot-restarted", "gnss-back")
            suffer("can-gone", 1.5, "link-lost", "link-up", "imu-back: IMU can-imu")
            vehicle.fault("mavlink-garbage")
            vehicle.fault("can-garbage")
            suffer("gnss-silent", 1.5, "gnss-silent", "gnss-back")
            vehicle.fault("can-loss", for_s=1.0, share=0.02)
            vehicle.fault("gnss-silent", for_s=1.5)
            companion.await_event("gnss-back")
            companion.send_signal(signal.SIGTERM)
            companion.finish()
            summary = companion.answer(PATIENCE_S)
            # Not before: what was sent in between would be missing here.
            counts = {**vehicle.counts(), "asked_before": asked}
    return Lived(said, began, summary, counts, read_solution(log), read_log([log]))


def imu_of(lived: Lived) -> Any:
    (vehicle,) = lived.recording.vehicles
    return next(imu for imu in vehicle.imu if imu.source == "can-imu")


def gaps_s(t_rx_ns: Any, since_ns: int, for_s: float) -> float:
    """Longest gap of arrivals that touches a span."""
    gaps = np.diff(t_rx_ns) / NS
    touches = (t_rx_ns[1:] > since_ns) & (t_rx_ns[:-1] < since_ns + for_s * NS)
    return float(gaps[touches].max())


def test_the_log_replays_to_the_bit(lived: Lived) -> None:
    chosen = choose_config(lived.recording)
    replayed = run_session(lived.recording.vehicles[0], chosen)
    assert replayed.digest == lived.stored.digest == lived.summary["digest"]
    assert replayed.digest_published == lived.stored.digest_published


def test_nothing_else_was_lost(lived: Lived) -> None:
    counters = lived.summary["counters"]
    imu = imu_of(lived)
    assert len(imu) == counters["can-imu.samples"] == counters["engine.imu"]
    assert lived.summary["log_dropped_bytes"] == 0
    # What the vehicle sent while it was listened to, less what was lost on the wire on order.
    sent = lived.counts["can_frames_heard"]
    assert counters["can-imu.frames"] <= sent
    # The rest: what was in the adapter when it was pulled, and at the end. A machine with no time
    # for the adapter overflows its small buffer besides, and the vehicle counts it.
    if not lived.counts["can_bytes_dropped"]:
        assert counters["can-imu.frames"] > 0.98 * sent


def test_imu_silent_and_back(lived: Lived) -> None:
    assert lived.said["imu-silent"][1].startswith("imu-back: IMU can-imu back after 1.")
    assert gaps_s(imu_of(lived).t_rx_ns, lived.faults_ns["imu-silent"], 1.2) > 1.0


def test_gnss_silent_and_back(lived: Lived) -> None:
    assert len(lived.said["gnss-silent"]) == 2
    fixes = lived.recording.vehicles[0].gnss[0].t_rx_ns
    assert gaps_s(fixes, lived.faults_ns["mavlink-down"], 6.0) > 5.5


def test_endpoint_killed_and_back(lived: Lived) -> None:
    silent, back = lived.said["mavlink-down"][1:]
    assert silent.startswith("autopilot-silent: no heartbeat")
    assert back.startswith("gnss-back")


def test_reboot_is_noticed_and_messages_asked_for_again(lived: Lived) -> None:
    assert lived.counts["mavlink_received"]["COMMAND_LONG"] > lived.counts["asked_before"]
    fixes = lived.recording.vehicles[0].gnss[0]
    # Validity stays on one clock: a fix is stamped when it has arrived at the autopilot.
    assert np.abs(fixes.t_rx_ns - fixes.t_ns).max() < 2 * NS
    assert fixes.t_ns[-1] > lived.faults_ns["autopilot-reboot"]


def test_adapter_pulled_and_put_back(lived: Lived) -> None:
    lost, up, back = lived.said["can-gone"]
    assert "can" in lost
    assert "open again" in up
    assert back.startswith("imu-back")


def test_garbage_is_counted_and_harmless(lived: Lived) -> None:
    counters = lived.summary["counters"]
    assert counters["mavlink.bad_bytes"] > 1000
    assert lived.summary["mode"] == "navigating"
    # Lost frames were ordered: a sample of seven frames each.
    assert counters["can-imu.lost"] > 0
    imu = imu_of(lived)
    assert np.abs(imu.gyro_b).max() < 10.0
    assert np.abs(np.linalg.norm(imu.accel_b, axis=1) - 9.8).max() < 15.0


def test_every_event_is_in_the_log(lived: Lived) -> None:
    kinds = {event.kind for event in lived.stored.events}
    wanted = {"imu-silent", "imu-back", "gnss-silent", "gnss-back", "link-lost", "link-up"}
    assert wanted | {"autopilot-silent", "autopilot-back", "autopilot-restarted"} <= kinds
