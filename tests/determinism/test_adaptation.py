"""What a method has learned goes back in time with the filter, however the input is cut."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from companion.config import Config
from companion.engine import Engine
from companion.types import ImuSamples, VehicleRecording
from replay.player import arrivals, play
from replay.simulator import load_scenario, matching_config, simulate
from replay.simulator.aids import GnssSpec
from replay.simulator.disturbances import NoiseChange

from .test_bits import with_arrivals


@pytest.fixture(scope="module")
def flight() -> tuple[VehicleRecording, Config]:
    """A minute with half of it in noise that nobody configured."""
    base = load_scenario("multirotor-mission")
    noise = NoiseChange(start_s=20.0, length_s=20.0, factor=5.0)
    scenario = msgspec.structs.replace(
        base,
        trajectory=msgspec.structs.replace(base.trajectory, duration_s=60.0),
        gnss=(GnssSpec(noise_changes=(noise,)),),
        mag=None,
    )
    config = matching_config(scenario)
    return simulate(scenario, 2), msgspec.structs.replace(
        config,
        alignment=msgspec.structs.replace(config.alignment, heading="fixed", fixed_heading_deg=30),
        gnss=msgspec.structs.replace(config.gnss, latency_ms=0.0, sd_position_m=0.5),
    )


def _by(config: Config, method: str) -> Config:
    section = msgspec.structs.replace(config.adaptation, method=method)
    return msgspec.structs.replace(config, adaptation=section)


@pytest.mark.parametrize("method", ["fuzzy", "flac", "variational"])
def test_late_aiding_and_cut_blocks_settle_to_the_same_bits(
    flight: tuple[VehicleRecording, Config], method: str
) -> None:
    vehicle, config = flight[0], _by(flight[1], method)
    prompt = play(with_arrivals(vehicle, lambda t: t), config)
    assert prompt.digest != play(vehicle, flight[1]).digest  # the method does something here
    rng = np.random.default_rng(1)
    late = with_arrivals(vehicle, lambda t: t + rng.integers(0, 400_000_000, len(t)))
    engine = Engine(config)
    for block in arrivals(late, config):
        if isinstance(block, ImuSamples):
            cuts = np.sort(rng.integers(0, len(block) + 1, 1 + len(block) // 20))
            for a, b in zip([0, *cuts], [*cuts, len(block)], strict=True):
                engine.step(block.take(slice(int(a), int(b))))
        else:
            engine.step(block)
    engine.finish()
    assert engine.counters.late_fused > 100
    assert engine.digest == prompt.digest
