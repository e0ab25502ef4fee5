"""The log of a live run, replayed, gives the digests that the run wrote, whatever happened."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from companion.config import Bank, Config, FurtherImu
from companion.types import NS, ImuSamples, MagSamples, VehicleRecording
from replay.player import play
from replay.run_log import read_run, read_solution

from . import flights
from .flights import Arrival, LinkChange, Piece, can_frames, pieces

Flight = tuple[VehicleRecording, Config]


@pytest.fixture(scope="module")
def copter() -> Flight:
    """Heading by magnetometer: one filter, where a bank of twelve takes twelve times as long."""
    vehicle, config = flights.vehicle()
    mag = msgspec.structs.replace(config.mag, use=True, declination_deg=4.0)
    return vehicle, msgspec.structs.replace(config, mag=mag)


def _same(flown: flights.Flown) -> None:
    """Replay the log and hold it against what the run wrote."""
    (vehicle,) = read_run(flown.path).vehicles
    engine = play(vehicle, flown.core.config)
    stored = read_solution(flown.path)
    assert stored.digest == flown.digest
    assert stored.digest_published == flown.digest_published
    assert engine.digest == flown.digest
    assert engine.digest_published == flown.digest_published
    assert len(stored.solution) > 100


def _aids(vehicle: VehicleRecording, delay: Callable[[int], int] = lambda _: 0) -> list[Arrival]:
    streams = (*vehicle.gnss, *vehicle.baro, *vehicle.mag)
    return [piece for stream in streams for piece in pieces(stream, delay)]


def _without(arrivals: list[Any], start_s: float, end_s: float) -> list[Any]:
    t0 = min(a.t_ns for a in arrivals)
    return [a for a in arrivals if not t0 + start_s * NS <= a.t_ns < t0 + end_s * NS]


def test_an_undisturbed_run(copter: Flight, tmp_path: Path) -> None:
    vehicle, config = copter
    arrivals = [*can_frames(vehicle.imu[0]), *_aids(vehicle)]
    flown = flights.fly(arrivals, flights.with_can(config, "imu"), tmp_path / "run.mcap")
    _same(flown)
    assert flown.core.engine.counters.late_fused > 20  # GNSS is 100 ms late in this flight


def test_a_heading_that_is_found_on_the_way(tmp_path: Path) -> None:
    vehicle, config = flights.vehicle()
    mag = msgspec.structs.replace(config.mag, use=False)
    arrivals = [*can_frames(vehicle.imu[0]), *_aids(vehicle)]
    config = msgspec.structs.replace(flights.with_can(config, "imu"), mag=mag)
    _same(flights.fly(arrivals, config, tmp_path / "run.mcap"))


def test_late_and_shuffled_aiding(copter: Flight, tmp_path: Path) -> None:
    vehicle, config = copter
    rng = np.random.default_rng(1)
    # Up to 0.7 s: some beyond the delay ring of 0.5 s.
    arrivals = [*can_frames(vehicle.imu[0]), *_aids(vehicle, lambda _: int(rng.integers(7e8)))]
    flown = flights.fly(arrivals, flights.with_can(config, "imu"), tmp_path / "run.mcap")
    _same(flown)
    assert flown.core.engine.counters.refused["refused_late"] > 5


def test_lost_can_frames(copter: Flight, tmp_path: Path) -> None:
    vehicle, config = copter
    rng = np.random.default_rng(2)
    frames = [f for f in can_frames(vehicle.imu[0]) if rng.random() > 0.01]
    flown = flights.fly(
        [*frames, *_aids(vehicle)], flights.with_can(config, "imu"), tmp_path / "run.mcap"
    )
    _same(flown)
    assert flown.core.counters()["imu.lost"] > 50


def test_a_reconnect(copter: Flight, tmp_path: Path) -> None:
    vehicle, config = copter
    aids = _aids(vehicle)
    t0 = min(a.t_ns for a in aids)
    changes = [
        LinkChange(t0 - 1, "mavlink", "up"),
        LinkChange(t0 + 5 * NS, "mavlink", "lost"),
        LinkChange(t0 + 6 * NS, "mavlink", "retrying"),
        LinkChange(t0 + 8 * NS, "mavlink", "up"),
    ]
    arrivals = [*can_frames(vehicle.imu[0]), *_without(aids, 5, 8), *changes]
    flown = flights.fly(arrivals, flights.with_can(config, "imu"), tmp_path / "run.mcap")
    _same(flown)
    links = [e.kind for e in flown.events if e.kind.startswith("link")]
    assert links == ["link-up", "link-lost", "link-up"]
    assert "gnss-silent" in flown.kinds()
    assert "gnss-back" in flown.kinds()


@pytest.mark.parametrize("seconds", [0.4, 3.0])
def test_a_silent_imu(copter: Flight, tmp_path: Path, seconds: float) -> None:
    vehicle, config = copter
    frames = _without(can_frames(vehicle.imu[0]), 6, 6 + seconds)
    flown = flights.fly(
        [*frames, *_aids(vehicle)], flights.with_can(config, "imu"), tmp_path / "run.mcap"
    )
    _same(flown)
    silent = [e for e in flown.events if e.kind in ("imu-silent", "imu-back")]
    assert [e.kind for e in silent] == (["imu-silent", "imu-back"] if seconds > 0.5 else [])


def test_a_silent_receiver(copter: Flight, tmp_path: Path) -> None:
    vehicle, config = copter
    fixes = _without(pieces(vehicle.gnss[0]), 6, 9)
    others = [p for s in (*vehicle.baro, *vehicle.mag) for p in pieces(s)]
    flown = flights.fly(
        [*can_frames(vehicle.imu[0]), *fixes, *others],
        flights.with_can(config, "imu"),
        tmp_path / "run.mcap",
    )
    _same(flown)
    assert flown.kinds().count("gnss-silent") == 1


def test_an_inertial_clock_that_restarts(copter: Flight, tmp_path: Path) -> None:
    """The autopilot's IMU with stamps that jump back by five seconds, and none to repair them."""
    vehicle, config = copter
    imu = vehicle.imu[0]
    half = len(imu) // 2
    t = imu.t_ns.copy()
    t[half:] -= 5 * NS
    flown = flights.fly(
        [*pieces(replace(imu, t_ns=t)), *_aids(vehicle)], config, tmp_path / "run.mcap"
    )
    _same(flown)
    assert any(e.kind == "clock-back" for o in flown.outputs for e in o.events)


def test_two_imus_of_which_one_is_used(copter: Flight, tmp_path: Path) -> None:
    vehicle, config = copter
    first, second = can_frames(vehicle.imu[0]), can_frames(vehicle.imu[0], 51)
    shifted = [replace(f, t_ns=f.t_ns + 1_300_000) for f in second]
    highres = pieces(vehicle.imu[0])
    flown = flights.fly(
        [*first, *shifted, *highres, *_aids(vehicle)],
        flights.with_can(config, "front", "rear"),
        tmp_path / "run.mcap",
    )
    _same(flown)
    (recording,) = read_run(flown.path).vehicles
    assert recording.imu[0].source == "front"
    assert {s.source for s in recording.imu[1:]} == {"rear", "HIGHRES_IMU"}
    counts = [len(s) for s in recording.imu]
    assert min(counts) > 0.99 * max(counts)
    assert flown.summary["inputs"][0]["source"] == "front"


def test_two_imus_fused_under_a_bank_with_one_that_falls_silent(
    copter: Flight, tmp_path: Path
) -> None:
    vehicle, config = copter
    config = msgspec.structs.replace(
        flights.with_can(config, "front", "rear"),
        imu=msgspec.structs.replace(config.imu, source="front"),
        further_imu=(FurtherImu(source="rear"),),
        bank=Bank(estimators=("error-state", "error-state+one-imu")),
    )
    second = [
        replace(f, t_ns=f.t_ns + 1_300_000)
        for f in _without(can_frames(vehicle.imu[0], 51), 8.0, 10.0)
    ]
    arrivals = [*can_frames(vehicle.imu[0]), *second, *_aids(vehicle)]
    flown = flights.fly(arrivals, config, tmp_path / "run.mcap")
    _same(flown)
    said = [e.kind for e in read_solution(flown.path).events]
    assert "imu-excluded" in said
    counters = flown.summary["counters"]
    assert counters["rear.exclusions"] == 1
    assert counters["bank.switches"] == 0


def test_the_second_imu_by_name(copter: Flight, tmp_path: Path) -> None:
    vehicle, config = copter
    config = flights.with_can(config, "front", "rear")
    config = msgspec.structs.replace(config, imu=msgspec.structs.replace(config.imu, source="rear"))
    frames = [*can_frames(vehicle.imu[0]), *can_frames(vehicle.imu[0], 51)]
    flown = flights.fly([*frames, *_aids(vehicle)], config, tmp_path / "run.mcap")
    _same(flown)
    assert flown.summary["inputs"][0]["source"] == "rear"


def test_the_autopilots_imu_after_its_trial(copter: Flight, tmp_path: Path) -> None:
    """Two messages of one sensor, the better one coming up late; fixes without and with a fix."""
    vehicle, config = copter
    imu = vehicle.imu[0]
    raw = replace(imu, source="RAW_IMU").take(slice(0, None, 2))
    gnss = vehicle.gnss[0]
    fix_type = gnss.fix_type.copy()
    fix_type[:30] = 0
    arrivals = [
        *pieces(raw),
        *pieces(imu.take(slice(100, None))),
        *pieces(replace(gnss, fix_type=fix_type)),
        *[p for s in (*vehicle.baro, *vehicle.mag) for p in pieces(s)],
    ]
    flown = flights.fly(arrivals, config, tmp_path / "run.mcap")
    _same(flown)
    chosen = {c["kind"]: c for c in flown.summary["inputs"]}
    assert chosen["imu"]["source"] == "HIGHRES_IMU"
    (recording,) = read_run(flown.path).vehicles
    assert int(recording.imu[0].seq[0]) == chosen["imu"]["first_seq"]
    assert recording.gnss[0].fix_type[0] >= 2
    assert recording.height_datum == "msl"


def test_chunks_of_a_byte_stream(copter: Flight, tmp_path: Path) -> None:
    """Everything of 30 ms in one piece, under one arrival number."""
    vehicle, config = copter
    by_time: dict[int, list[Any]] = {}
    for stream in (*vehicle.imu, *vehicle.gnss, *vehicle.baro, *vehicle.mag):
        slot = stream.t_rx_ns // 30_000_000
        for s in np.unique(slot):
            by_time.setdefault(int(s), []).append(stream.take(slot == s))
    chunks = [Piece((s + 1) * 30_000_000, tuple(parts)) for s, parts in by_time.items()]
    flown = flights.fly(chunks, config, tmp_path / "run.mcap")
    _same(flown)


def test_a_fast_magnetometer_that_comes_before_the_first_fix(
    copter: Flight, tmp_path: Path
) -> None:
    vehicle, config = copter
    mag = vehicle.mag[0]
    rate = np.repeat(np.arange(len(mag)), 5)
    t = mag.t_ns[rate] + np.tile(np.arange(5), len(mag)) * 20_000_000
    fast = MagSamples(mag.source, t, t + 5_000_000, np.arange(len(t)), mag.field_b[rate])
    config = msgspec.structs.replace(
        config, mag=msgspec.structs.replace(config.mag, use=True, declination_deg=None)
    )
    fixes = pieces(vehicle.gnss[0].take(slice(20, None)))
    arrivals = [*can_frames(vehicle.imu[0]), *fixes, *pieces(fast), *pieces(vehicle.baro[0])]
    flown = flights.fly(arrivals, flights.with_can(config, "imu"), tmp_path / "run.mcap")
    _same(flown)


def test_samples_that_are_no_numbers_or_come_twice(copter: Flight, tmp_path: Path) -> None:
    vehicle, config = copter
    imu = vehicle.imu[0]
    gyro = imu.gyro_b.copy()
    gyro[1500:1503] = np.nan
    bad: ImuSamples = replace(imu, gyro_b=gyro)
    twice = [p for p in pieces(bad) for _ in range(2)]
    aids = [p for p in _aids(vehicle) for _ in range(2)]
    flown = flights.fly([*twice, *aids], config, tmp_path / "run.mcap")
    _same(flown)
    assert flown.core.engine.counters.imu_not_finite > 0
    assert flown.core.engine.counters.imu_out_of_order > 500


def test_a_drive_with_course_and_constraint(tmp_path: Path) -> None:
    vehicle, config = flights.vehicle("car-with-stops")
    arrivals = [*can_frames(vehicle.imu[0]), *_aids(vehicle)]
    flown = flights.fly(arrivals, flights.with_can(config, "imu"), tmp_path / "run.mcap")
    _same(flown)
