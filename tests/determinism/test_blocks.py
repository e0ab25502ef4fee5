"""A block with the aiding that arrived among it is the same as its arrivals one after the other."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from companion.config import Config
from companion.engine import Engine
from companion.types import AidingReports, Event, Outputs, Solution, VehicleRecording
from replay.player import arrivals, blocks

from .test_bits import flight_of, with_arrivals


def _in_turn(vehicle: VehicleRecording, config: Config) -> tuple[Engine, list[Outputs]]:
    engine = Engine(config)
    return engine, [*(engine.step(one) for one in arrivals(vehicle, config)), engine.finish()]


def _in_blocks(vehicle: VehicleRecording, config: Config) -> tuple[Engine, list[Outputs]]:
    engine = Engine(config)
    outputs = [engine.step_block(imu, aids) for imu, aids in blocks(vehicle, config)]
    return engine, [*outputs, engine.finish()]


def _late(name: str, seed: int) -> tuple[VehicleRecording, Config]:
    """A run whose aiding is up to 650 ms late: beyond the ring, out of order, several at once."""
    vehicle, config = flight_of(name, "unknown", 75.0)
    rng = np.random.default_rng(seed)
    return with_arrivals(vehicle, lambda t: t + rng.integers(0, 650_000_000, len(t))), config


def _reports(outputs: list[Outputs]) -> np.ndarray:
    """All reports with the bits of their NIS, sorted: refusals come at other moments."""
    r = AidingReports.concatenate([o.reports for o in outputs])
    table = np.column_stack([r.t_ns, r.channel, r.source, r.verdict, r.nis.view(np.int64)])
    return np.asarray(table[np.lexsort(table.T[::-1])])


def _events(outputs: list[Outputs]) -> list[Event]:
    return [event for o in outputs for event in o.events]


@pytest.mark.parametrize("name", ["multirotor-mission", "car-with-stops"])
def test_late_aiding_in_blocks_gives_what_arrivals_in_turn_give(name: str) -> None:
    vehicle, config = _late(name, 1)
    one, first = _in_turn(vehicle, config)
    two, second = _in_blocks(vehicle, config)
    assert two.digest == one.digest
    assert two.digest_published == one.digest_published
    assert np.array_equal(_reports(second), _reports(first))
    assert _events(second) == _events(first)
    assert two.counters == one.counters
    assert one.counters.refused["refused_late"] > 10


def test_aiding_in_bursts_gives_what_arrivals_in_turn_give() -> None:
    """A link that hands on five times a second: fix and pressure between the same samples.

    The first fix is late, so that navigation begins in the past: what it reaches is published
    before the pressure behind it, which has to be the same epochs in both.
    """
    vehicle, config = flight_of("multirotor-mission", "unknown", 40.0)
    # Where a field waits for its declination, a block is taken one by one anyway.
    config = msgspec.structs.replace(config, mag=msgspec.structs.replace(config.mag, use=False))
    vehicle = replace(vehicle, mag=())
    burst = 200_000_000
    vehicle = with_arrivals(vehicle, lambda t: t - t % burst + burst + 50_000_000)
    one, _ = _in_turn(vehicle, config)
    two, _ = _in_blocks(vehicle, config)
    assert two.digest == one.digest
    assert two.digest_published == one.digest_published


def test_settled_epochs_come_once_though_a_snapshot_lies_before_the_ring() -> None:
    vehicle, config = _late("car-with-stops", 2)
    _, outputs = _in_turn(vehicle, config)
    settled = Solution.concatenate([o.settled for o in outputs])
    assert np.all(np.diff(settled.t_ns) > 0)


def test_a_block_with_broken_samples_is_taken_one_by_one() -> None:
    vehicle, config = _late("car-with-stops", 3)
    imu = vehicle.imu[0]
    gyro, t = imu.gyro_b.copy(), imu.t_ns.copy()
    gyro[1000] = np.nan
    t[5000] = t[4990]
    broken = replace(vehicle, imu=(replace(imu, gyro_b=gyro, t_ns=t),))
    one, first = _in_turn(broken, config)
    two, second = _in_blocks(broken, config)
    assert (two.counters.imu_not_finite, two.counters.imu_out_of_order) == (1, 1)
    assert two.counters == one.counters
    assert two.digest == one.digest
    assert two.digest_published == one.digest_published
    assert np.array_equal(_reports(second), _reports(first))
