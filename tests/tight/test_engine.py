"""Tight coupling through the whole engine: bits, the log, outages, clocks that jump."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from companion.engine import Engine
from companion.gnss.clock_steps import STEP_M
from companion.logbook import LogWriter
from companion.navigation import layout as lo
from companion.proto.navigation_pb2 import Satellites
from companion.types import (
    NS,
    AnySamples,
    Channel,
    ImuSamples,
    Outputs,
    VehicleRecording,
    Verdict,
)
from replay.player import blocks, play
from replay.run_log import read_run
from replay.simulator.raw_gnss import as_arrived
from tests.consistency import runs

from . import flights


def _late(vehicle: VehicleRecording, seed: int) -> VehicleRecording:
    """Epochs up to 400 ms late, in their own order, as a receiver's line delivers them."""
    raw = vehicle.raw[0]
    rng = np.random.default_rng(seed)
    arrival = np.maximum.accumulate(raw.t_ns + rng.integers(0, 400_000_000, len(raw)))
    return as_arrived(vehicle, vehicle.broadcast[0], replace(raw, t_rx_ns=arrival))


def test_late_epochs_settle_to_the_bits_of_prompt_ones() -> None:
    vehicle, config = flights.flight().recording, flights.config(raw_gnss={"latency_ms": 0.0})
    raw = vehicle.raw[0]
    prompt = as_arrived(vehicle, vehicle.broadcast[0], replace(raw, t_rx_ns=raw.t_ns))
    one, two = play(prompt, config), play(_late(vehicle, 1), config)
    assert two.counters.late_fused > 100
    assert two.counters.refused.get("refused_late", 0) == 0
    assert two.digest == one.digest
    assert two.digest_published != one.digest_published


def test_blocks_and_arrivals_in_turn_give_the_same_bits() -> None:
    vehicle, config = _late(flights.flight().recording, 2), flights.config()
    whole = play(vehicle, config)
    engine = Engine(config)
    for imu, aids in blocks(vehicle, config):
        for cut in np.array_split(np.arange(len(imu)), 3):
            if len(cut) == 0:
                continue
            part: ImuSamples = imu.take(cut)
            last = imu.seq[cut[-1]] if cut[-1] + 1 < len(imu) else np.iinfo(np.int64).max
            first = imu.seq[cut[0]] if cut[0] else -1
            own = [a.take((a.seq >= first) & (a.seq < last)) for a in aids]
            engine.step_block(part, [a for a in own if len(a)])
    engine.finish()
    assert engine.digest == whole.digest


def _messages(path: Path, name: str) -> list[Satellites]:
    with path.open("rb") as file:
        found = make_reader(file).iter_messages()
        return [Satellites.FromString(m.data) for _, c, m in found if c.topic.endswith(name)]


def test_a_logged_run_replays_to_the_same_digests(tmp_path: Path) -> None:
    vehicle, config = _late(flights.flight().recording, 3), flights.config()
    path = tmp_path / "run.mcap"
    with LogWriter(path, config_toml="", metadata={}) as log:
        log.describe(vehicle)

        def sink(samples: AnySamples, out: Outputs) -> None:
            log.samples(samples, vehicle.name)
            log.outputs(out, vehicle.name)

        engine = play(vehicle, config, sink)
        log.close({"digest": engine.digest, "digest_published": engine.digest_published})
    again = read_run(path).vehicles[0]
    assert len(again.raw[0]) == len(vehicle.raw[0])
    assert len(again.broadcast[0]) == len(vehicle.broadcast[0])
    skies = _messages(path, "nav/satellites")
    assert len(skies) == len(vehicle.raw[0])
    assert 6 <= skies[-1].used <= 30
    assert 1.0 < skies[-1].pdop < skies[-1].gdop < 5.0
    replayed = play(again, config)
    assert replayed.digest == engine.digest
    assert replayed.digest_published == engine.digest_published


def test_position_is_as_good_as_the_ranges_and_says_how_good() -> None:
    flown = runs.fly(flights.flight().recording, flights.config())
    t, error = flights.errors(flown.solution)
    late = t > 30.0
    assert np.sqrt((error[late] ** 2).sum(axis=1).mean()) < 1.0  # metre ranges of 15 satellites
    position = flown.solution.sd[late, 0]
    assert np.median(np.abs(error[late]) / position) < 1.5
    used = flown.reports.channel == Channel.RANGE_GALILEO
    assert (flown.reports.verdict[used] == Verdict.ACCEPTED).mean() > 0.99


@pytest.mark.parametrize("jump_m", [0.0, STEP_M, 87_654.3])
def test_after_an_outage_of_all_satellites_it_locks_again(jump_m: float) -> None:
    """Forty seconds of nothing, behind which the receiver's clock is somewhere else."""
    vehicle = flights.withheld(flights.flight().recording, 50.0, 90.0, 0)
    raw, t = vehicle.raw[0], flights.seconds(vehicle)
    jump = np.where(t >= 90.0, jump_m, 0.0)
    stepped = replace(
        raw,
        pseudorange=raw.pseudorange + jump[:, None],
        tow=raw.tow + jump / 299_792_458.0,
    )
    flown = runs.fly(flights.with_raw(vehicle, stepped), flights.config())
    said = flown.event("receiver-clock")
    assert (said is not None) == (jump_m == 87_654.3)
    at, error = flights.errors(flown.solution)
    behind = at > 95.0
    assert np.linalg.norm(error[behind], axis=1).max() < 3.0
    assert flown.event("relocked") is None


def test_a_jump_with_two_satellites_left_is_let_go() -> None:
    vehicle = flights.withheld(flights.flight().recording, 50.0, 80.0, 2)
    raw, t = vehicle.raw[0], flights.seconds(vehicle)
    jump = np.where(t >= 60.0, 41_234.5, 0.0)[:, None]
    stepped = replace(raw, pseudorange=raw.pseudorange + jump)
    flown = runs.fly(flights.with_raw(vehicle, stepped), flights.config())
    assert flown.event("receiver-clock") is not None
    at, error = flights.errors(flown.solution)
    still = runs.fly(vehicle, flights.config()).solution
    without = np.linalg.norm(flights.errors(still)[1][at > 30.0], axis=1)
    with_jump = np.linalg.norm(error[at > 30.0], axis=1)
    # Two ranges of one epoch more are needed for the clock; nothing worse.
    assert with_jump.max() < 1.5 * without.max() + 3.0


def test_a_filter_far_from_where_its_ranges_are_is_set_there() -> None:
    """Struck while there were no satellites: 200 m off when they are back, and P does not know."""
    vehicle = flights.withheld(flights.flight().recording, 45.0, 80.0, 0)
    imu = vehicle.imu[0]
    t = (imu.t_ns - imu.t_ns[0]) / NS
    struck = imu.accel_b + np.where((t > 50.0) & (t < 50.5), 15.0, 0.0)[:, None] * [1.0, 0.0, 0.0]
    vehicle = replace(vehicle, imu=(replace(imu, accel_b=struck),))
    flown = runs.fly(vehicle, flights.config(engine={"gate_relock_s": 5.0}))
    at, error = flights.errors(flown.solution)
    assert np.linalg.norm(error[(at > 78.0) & (at < 80.0)], axis=1).min() > 100.0
    event = flown.event("relocked")
    assert event is not None
    assert "ranges" in event.text
    assert np.linalg.norm(error[at > 95.0], axis=1).max() < 3.0


@pytest.mark.parametrize("noise", ["learned", "configured"])
def test_the_clock_of_the_filter_is_as_noisy_as_was_learned(noise: str) -> None:
    # Configured ten times too noisy: the simulated drift walks by 0.15 m/s/√s.
    raw = {"clock_noise": noise, "clock_drift_walk_mps_rts": 1.5}
    engine = play(flights.flight().recording, flights.config(raw_gnss=raw))
    scale = engine.filter.phases[-1].filters[0].s[lo.CLOCK_SCALE : lo.CLOCK_SCALE + 3]
    if noise == "configured":
        assert scale.tolist() == [1.0, 1.0, 1.0]
    else:
        # A factor of two in 110 s; see tests/gnss/test_clock_noise.py.
        assert 0.075 < 1.5 * np.sqrt(scale[lo.DRIFT]) < 0.3
