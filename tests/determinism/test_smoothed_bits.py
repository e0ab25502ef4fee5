"""What is smoothed on line depends on what was measured, not on when or how it was delivered."""

from __future__ import annotations

import itertools
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from companion.config import Config
from companion.engine import Engine
from companion.types import ImuSamples, Smoothed, VehicleRecording
from replay.player import arrivals, play
from tests.determinism.test_bits import flight_of, with_arrivals


@pytest.fixture(
    scope="module", params=[("multirotor-mission", "magnetometer"), ("car-with-stops", "unknown")]
)
def flight(request: pytest.FixtureRequest) -> tuple[VehicleRecording, Config]:
    """A minute of a flight, and of a drive whose heading is found on the way."""
    vehicle, config = flight_of(*request.param)
    smoothing = msgspec.structs.replace(config.smoothing, enabled=True, window=2, mixed=True)
    t0 = int(vehicle.imu[0].t_ns[0])

    def cut(streams):  # type: ignore[no-untyped-def]
        return tuple(s.take(s.t_ns - t0 < 60_000_000_000) for s in streams)

    short = replace(vehicle, imu=cut(vehicle.imu), gnss=cut(vehicle.gnss), baro=cut(vehicle.baro))
    return short, msgspec.structs.replace(config, smoothing=smoothing)


def test_late_and_out_of_order_aiding_is_smoothed_to_the_same_bits(
    flight: tuple[VehicleRecording, Config],
) -> None:
    vehicle, config = flight
    rng = np.random.default_rng(4)
    prompt = play(with_arrivals(vehicle, lambda t: t), config)
    delayed = play(
        with_arrivals(vehicle, lambda t: t + rng.integers(0, 400_000_000, len(t))), config
    )
    assert delayed.counters.late_fused > 50
    assert delayed.digest_smoothed == prompt.digest_smoothed
    # The tape goes on from the same state as without a smoother.
    off = msgspec.structs.replace(config.smoothing, enabled=False)
    config = msgspec.structs.replace(config, smoothing=off)
    alone = play(with_arrivals(vehicle, lambda t: t), config)
    assert alone.digest_smoothed is None
    assert (alone.digest, alone.digest_published) == (prompt.digest, prompt.digest_published)


def test_any_split_of_the_imu_is_smoothed_to_the_same_bits(
    flight: tuple[VehicleRecording, Config],
) -> None:
    vehicle, config = flight
    whole = play(vehicle, config)
    rng = np.random.default_rng(6)
    engine = Engine(config)
    parts: list[Smoothed] = []
    for block in arrivals(vehicle, config):
        cuts = [0, len(block)]
        if isinstance(block, ImuSamples):
            cuts = sorted({*cuts, *rng.integers(0, len(block) + 1, len(block) // 7).tolist()})
        for a, b in itertools.pairwise(cuts):
            engine.step(block.take(slice(a, b)))
            if rng.random() < 0.5:  # how often it is asked must not count either
                parts.append(engine.smooth().smoothed)
    engine.finish()
    parts.append(engine.smooth().smoothed)
    found = Smoothed.concatenate([p for p in parts if len(p)])
    assert engine.digest_smoothed == whole.digest_smoothed
    assert np.all(np.diff(found.solution.t_ns) > 0)
    assert found.smoothed.mean() > 0.15  # 10 of 50 Hz
    assert np.all(found.lag_ns > 0)
