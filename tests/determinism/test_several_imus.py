"""Several inertial units: late, out of order between each other, in blocks or one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from companion.engine import Engine
from companion.types import NS, VehicleRecording
from replay.player import arrivals, play
from replay.recorded import record
from replay.smoothing import smoothed

from ..intake.flights import flown


def _until(vehicle: VehicleRecording, end_ns: int) -> VehicleRecording:
    return replace(
        vehicle,
        imu=tuple(s.take(s.t_ns < end_ns) for s in vehicle.imu),
        gnss=tuple(s.take(s.t_ns < end_ns) for s in vehicle.gnss),
        baro=tuple(s.take(s.t_ns < end_ns) for s in vehicle.baro),
    )


def test_arrivals_in_turn_blocks_of_any_length_and_late_fixes_give_the_same_bits() -> None:
    simulation, config = flown("scaled")
    vehicle = _until(simulation.recording, simulation.t0_ns + 55 * NS)
    rng = np.random.default_rng(8)
    fixes = vehicle.gnss[0]
    late = fixes.t_ns + rng.integers(0, 400_000_000, len(fixes))
    order = np.argsort(late, kind="stable")
    everyone = [*vehicle.imu, replace(fixes.take(order), t_rx_ns=late[order]), *vehicle.baro]
    rx = np.concatenate([s.t_rx_ns for s in everyone])
    seq = np.empty(len(rx), np.int64)
    seq[np.argsort(rx, kind="stable")] = np.arange(len(rx))
    parts = np.split(seq, np.cumsum([len(s) for s in everyone])[:-1])
    numbered = [replace(s, seq=n) for s, n in zip(everyone, parts, strict=True)]
    shuffled = replace(
        vehicle, imu=tuple(numbered[:3]), gnss=(numbered[3],), baro=tuple(numbered[4:])
    )
    prompt = play(vehicle, config)
    long, short = play(shuffled, config), play(shuffled, config, block_s=0.7)
    turn = Engine(config)
    for samples in arrivals(shuffled, config):
        turn.step(samples)
    turn.finish()
    assert long.counters.late_fused > 50
    assert {prompt.digest, long.digest, short.digest, turn.digest} == {prompt.digest}
    assert long.digest_published == short.digest_published == turn.digest_published
    # How often one goes back for late fixes depends on how many come in one call.
    assert replace(long.counters, rewinds=0) == replace(turn.counters, rewinds=0)
    assert turn.fusion is not None
    assert turn.fusion.excluded() == {"imu2": "scaled"}


def test_what_is_recorded_for_a_smoother_is_the_same_run() -> None:
    simulation, config = flown("silent")
    vehicle = _until(simulation.recording, simulation.t0_ns + 55 * NS)
    run = record(vehicle, config)
    assert run.digest == play(vehicle, config).digest
    assert any(event.kind == "imu-excluded" for event in run.events)
    assert len(smoothed(run, "bryson-frazier")) == len(run.solution)
