"""Raw GNSS live: UBX and RTCM 3 over TCP or serial are fused, and the log replays."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import Literal

import msgspec
import pytest

from companion.types import Channel, Verdict
from replay.children import free_port
from replay.configuration import choose_config
from replay.player import play
from replay.reader import read_log
from replay.run_log import read_solution
from replay.simulator.live.client import VehicleProcess
from tests.live import system

HEADING_DEG = 33.0
"""Of the simulated vehicle on the ground."""


def _await_epochs(vehicle: VehicleProcess, count: int) -> None:
    """Wait until the receiver has said so many more."""
    until = vehicle.counts()["raw_epochs"] + count
    end = time.monotonic() + system.PATIENCE_S
    while vehicle.counts()["raw_epochs"] < until:
        assert time.monotonic() < end
        time.sleep(0.2)


@pytest.mark.parametrize(
    ("line", "protocol"), [("tcp", "ublox"), ("serial", "ublox"), ("tcp", "rtcm3")]
)
def test_a_live_receiver_is_fused_tightly_and_its_log_replays(
    line: str, protocol: Literal["ublox", "rtcm3"], tmp_path: Path
) -> None:
    source = "UBLOX" if protocol == "ublox" else "RTCM"
    receiver = "tcp" if line == "tcp" else str(tmp_path / "ublox")
    arguments = ["--mavlink", "udpin:127.0.0.1:0", "--can", str(tmp_path / "can")]
    arguments += [
        "--receiver-protocol",
        protocol,
        "--imu-rate",
        "100",
        "--rest",
        "8",
        "--seconds",
        "300",
        "--receiver",
        receiver,
    ]
    log = tmp_path / "run.mcap"
    with VehicleProcess(arguments) as vehicle:
        config = system.config_beside(vehicle, tmp_path, f"tcp/127.0.0.1:{free_port()}")
        raw = msgspec.structs.replace(
            config.raw_gnss, coupling="tight", endpoint=vehicle.ready["receiver"],
            protocol=protocol, latency_ms=80.0,
        )  # fmt: skip
        # While the heading is being found, fixes made of the ranges are fused in their place.
        heading = msgspec.structs.replace(
            config.alignment, heading="fixed", fixed_heading_deg=HEADING_DEG
        )
        config = msgspec.structs.replace(config, raw_gnss=raw, alignment=heading)
        with system.Companion(system.written(config, tmp_path), log) as companion:
            companion.await_event(f"link-up: {protocol} open")
            companion.await_event("satellite-set: ")
            companion.await_event("aligned")
            if line == "tcp":
                vehicle.fault("gnss-silent", for_s=3.0)
                companion.await_event(f"raw-silent: raw GNSS {source} silent")
                companion.await_event("raw-back")
            _await_epochs(vehicle, 40)
            companion.send_signal(signal.SIGTERM)
            companion.finish()
            summary = companion.answer(system.PATIENCE_S)
        vehicle.end()
    assert ("raw", source) in {(one["kind"], one["source"]) for one in summary["inputs"]}
    logged = read_log([log])
    [recorded] = logged.vehicles
    assert len(recorded.raw[0]) > 20
    replayed = play(recorded, choose_config(logged).config)
    assert replayed.digest == summary["digest"]
    assert replayed.digest_published == summary["digest_published"]
    reports = read_solution(log).reports
    ranges = reports.channel == Channel.RANGE_GPS
    assert (reports.verdict[ranges] == Verdict.ACCEPTED).sum() > 100
    assert (reports.verdict[ranges] == Verdict.REJECTED_GATE).mean() < 0.05
