"""The digest depends on what was measured, not on when or how it was delivered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import msgspec
import numpy as np
import pytest

from companion.config import Config
from companion.engine import Engine
from companion.types import NS, AnySamples, ImuSamples, Samples, Solution, VehicleRecording
from replay.player import arrivals, play
from replay.simulator import load_scenario, matching_config, simulate

S = TypeVar("S", bound=Samples)
_LEVEL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
BEGINNING_S = 120.0
"""Rest, the search for the heading, its end, and more than a minute of motion after it."""


def flight_of(
    name: str, heading: str = "auto", seconds: float = BEGINNING_S
) -> tuple[VehicleRecording, Config]:
    scenario = load_scenario(name)
    config = matching_config(scenario)
    # A tilted mounting, so that the turn into body axes is part of what must not change.
    s, c = 0.6, 0.8
    axes = ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))
    imu = msgspec.structs.replace(config.imu, axes=axes if name.startswith("multi") else _LEVEL)
    config = msgspec.structs.replace(config, imu=imu)
    alignment = msgspec.structs.replace(config.alignment, heading=heading)
    gnss = msgspec.structs.replace(config.gnss, latency_ms=0.0)
    config = msgspec.structs.replace(config, alignment=alignment, gnss=gnss)
    return beginning(simulate(scenario, 3), seconds), config


def beginning(vehicle: VehicleRecording, seconds: float) -> VehicleRecording:
    """The first ``seconds`` of what the filter takes."""
    end = vehicle.imu[0].t_ns[0] + round(seconds * NS)

    def cut(streams: tuple[S, ...]) -> tuple[S, ...]:
        return tuple(s.take(s.t_ns < end) for s in streams)

    return replace(
        vehicle,
        imu=cut(vehicle.imu),
        gnss=cut(vehicle.gnss),
        baro=cut(vehicle.baro),
        mag=cut(vehicle.mag),
    )


@pytest.fixture(scope="module", params=["multirotor-mission", "car-with-stops"])
def flight(request: pytest.FixtureRequest) -> tuple[VehicleRecording, Config]:
    """A flight and a drive whose heading is found on the way: every phase of the filter."""
    return flight_of(request.param, "unknown")


def with_arrivals(
    vehicle: VehicleRecording, late: Callable[[np.ndarray], np.ndarray]
) -> VehicleRecording:
    """The same samples, aiding delivered ``late`` (validity ns → arrival ns), numbered anew."""
    streams = [*vehicle.imu[:1], *vehicle.gnss[:1], *vehicle.baro[:1], *vehicle.mag[:1]]
    times = [s.t_ns if isinstance(s, ImuSamples) else late(s.t_ns) for s in streams]
    order = np.argsort(np.concatenate(times), kind="stable")
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    at = 0
    moved: list[AnySamples] = []
    for stream, t in zip(streams, times, strict=True):
        seq = number[at : at + len(t)]
        at += len(t)
        rank = np.argsort(seq)
        new = replace(stream, t_rx_ns=t, seq=seq)
        moved.append(new.take(rank))
    return replace(
        vehicle,
        imu=(moved[0],),
        gnss=(moved[1],),
        baro=tuple(m for m in moved if type(m).__name__ == "BaroSamples"),
        mag=tuple(m for m in moved if type(m).__name__ == "MagSamples"),
    )


def test_replaying_twice_gives_one_digest(flight: tuple[VehicleRecording, Config]) -> None:
    vehicle, config = flight
    first, second = play(vehicle, config), play(vehicle, config)
    assert first.digest == second.digest
    assert first.digest_published == second.digest_published


@pytest.mark.parametrize("seed", range(3))
def test_late_and_out_of_order_aiding_settles_to_the_same_bits(
    flight: tuple[VehicleRecording, Config], seed: int
) -> None:
    vehicle, config = flight
    prompt = play(with_arrivals(vehicle, lambda t: t), config)
    rng = np.random.default_rng(seed)
    delayed = play(
        with_arrivals(vehicle, lambda t: t + rng.integers(0, 400_000_000, len(t))), config
    )
    assert delayed.counters.late_fused > 100
    assert delayed.counters.refused.get("refused_late", 0) == 0
    assert delayed.digest == prompt.digest
    assert delayed.digest_published != prompt.digest_published


def test_any_split_of_the_imu_gives_the_same_bits(
    flight: tuple[VehicleRecording, Config],
) -> None:
    vehicle, config = flight
    whole = play(vehicle, config)
    rng = np.random.default_rng(5)
    engine = Engine(config)
    parts = []
    for block in arrivals(vehicle, config):
        if isinstance(block, ImuSamples):
            cuts = np.sort(rng.integers(0, len(block) + 1, max(1, len(block) // 7)))
            for a, b in zip([0, *cuts], [*cuts, len(block)], strict=True):
                parts.append(engine.step(block.take(slice(int(a), int(b)))))
        else:
            parts.append(engine.step(block))
    parts.append(engine.finish())
    assert engine.digest == whole.digest
    assert engine.digest_published == whole.digest_published
    settled = Solution.concatenate([p.settled for p in parts])
    published = Solution.concatenate([p.published for p in parts])
    assert np.array_equal(settled.t_ns, published.t_ns)
    assert np.all(np.diff(settled.t_ns) > 0)


def test_a_nanometre_per_second_squared_changes_the_digest(
    flight: tuple[VehicleRecording, Config],
) -> None:
    vehicle, config = flight
    accel = vehicle.imu[0].accel_b.copy()
    accel[len(accel) // 2, 1] += 1e-9  # one sample; an ulp could be lost in rounding
    changed = replace(vehicle, imu=(replace(vehicle.imu[0], accel_b=accel),))
    assert play(changed, config).digest != play(vehicle, config).digest


def test_what_is_published_uses_only_what_had_arrived(
    flight: tuple[VehicleRecording, Config],
) -> None:
    vehicle, config = flight
    late = with_arrivals(vehicle, lambda t: t + 300_000_000)
    cut = int(len(late.imu[0]) * 0.6)
    seq = int(late.imu[0].seq[cut])
    early = replace(
        late,
        imu=(late.imu[0].take(slice(0, cut)),),
        gnss=(late.gnss[0].take(late.gnss[0].seq < seq),),
        baro=tuple(b.take(b.seq < seq) for b in late.baro),
        mag=tuple(m.take(m.seq < seq) for m in late.mag),
    )
    out: list[Solution] = []
    play(late, config, lambda _, o: out.append(o.published))
    full = Solution.concatenate(out)
    out = []
    play(early, config, lambda _, o: out.append(o.published))
    part = Solution.concatenate(out)
    n = len(part)
    assert n > 100
    assert np.array_equal(full.lat[:n], part.lat)
    assert np.array_equal(full.q_nb[:n], part.q_nb)
