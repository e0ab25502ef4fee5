"""Runs that did not end: killed ones, and ones whose log lost a span."""

from __future__ import annotations

from pathlib import Path

import pytest

from companion.config import Config
from companion.types import NS, VehicleRecording
from replay.player import play
from replay.run_log import read_digests, read_run
from replay.verification import compare_with_live

from . import flights
from .flights import Arrival, can_frames, pieces

Flight = tuple[list[Arrival], Config]


@pytest.fixture(scope="module")
def flight() -> Flight:
    recording: VehicleRecording
    recording, config = flights.vehicle()
    streams = (*recording.gnss, *recording.baro)
    aids = [piece for stream in streams for piece in pieces(stream)]
    return [*can_frames(recording.imu[0]), *aids], flights.with_can(config, "imu")


@pytest.fixture(scope="module")
def killed(flight: Flight, tmp_path_factory: pytest.TempPathFactory) -> flights.Flown:
    arrivals, config = flight
    return flights.fly(arrivals, config, tmp_path_factory.mktemp("run") / "run.mcap", close=False)


def test_a_killed_run_is_checked_up_to_its_last_checkpoint(killed: flights.Flown) -> None:
    (vehicle,) = read_run(killed.path).vehicles
    found = compare_with_live(killed.path, vehicle, killed.core.config, "", "")
    assert found is not None
    assert found.until_seq is not None
    assert found.equal
    # 12 s of flight and a checkpoint every 10 s.
    (at,) = [s.t_rx_ns[s.seq <= found.until_seq][-1] for s in vehicle.imu]
    assert 9 * NS < at - vehicle.imu[0].t_rx_ns[0] < 11 * NS


def test_a_log_cut_anywhere_is_read_and_still_agrees(killed: flights.Flown, tmp_path: Path) -> None:
    data = killed.path.read_bytes()
    agreed = 0
    for share in (0.3, 0.7, 0.9):
        path = tmp_path / f"{share}.mcap"
        path.write_bytes(data[: int(share * len(data))])
        (vehicle,) = read_run(path).vehicles
        found = compare_with_live(path, vehicle, killed.core.config, "", "")
        assert found is None or found.equal
        agreed += found is not None
    assert agreed >= 1


def test_other_bits_are_noticed(killed: flights.Flown) -> None:
    (vehicle,) = read_run(killed.path).vehicles
    vehicle.imu[0].gyro_b[1500, 0] += 1e-6
    found = compare_with_live(killed.path, vehicle, killed.core.config, "", "")
    assert found is not None
    assert not found.equal


def test_a_closed_run_is_compared_as_a_whole(flight: Flight, tmp_path: Path) -> None:
    arrivals, config = flight
    flown = flights.fly(arrivals, config, tmp_path / "run.mcap")
    stored = read_digests(flown.path, flown.core.vehicle)
    assert stored is not None
    assert stored.seq is None
    (vehicle,) = read_run(flown.path).vehicles
    engine = play(vehicle, config)
    found = compare_with_live(flown.path, vehicle, config, engine.digest, engine.digest_published)
    assert found is not None
    assert found.equal
