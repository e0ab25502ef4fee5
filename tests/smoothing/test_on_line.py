"""Smoothing on line: the same as off line where it sees the same, and a filter that outlives it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from companion.config import Config
from companion.engine import Engine
from companion.estimation.running_tape import RunningTape
from companion.smoothing.fixed_lag import FixedLag
from companion.smoothing.offline import smooth
from companion.types import NS, Event, Smoothed, Solution, VehicleRecording
from replay.on_line import on_line_config, smooth_on_line
from replay.player import blocks, play
from replay.preparation import withhold_gnss
from replay.recorded import record
from replay.window import Window
from tests.consistency import runs

SCENARIO = runs.honest("multirotor-mission", 80.0)
OUTAGE = Window(45.0, 15.0)


@pytest.fixture(scope="module")
def flight() -> tuple[VehicleRecording, Config]:
    vehicle = withhold_gnss(runs.run(SCENARIO, 3).recording, [OUTAGE])
    return vehicle, runs.matching_config(SCENARIO)


def test_with_the_rest_of_the_run_in_its_window_it_is_the_smoother_off_line(
    flight: tuple[VehicleRecording, Config],
) -> None:
    """The last hundred intervals, 20 s less the latency of the fixes, are smoothed all at once."""
    vehicle, config = flight
    run = smooth_on_line(vehicle, on_line_config(config, 100, 10.0))
    off_line = record(vehicle, config, rate_hz=10.0)
    reference = smooth(off_line.tapes, off_line.config)
    late = run.smoothed.solution
    common = np.intersect1d(late.t_ns, reference.t_ns)
    common = common[common > late.t_ns[-1] - 19 * NS]
    assert len(common) > 150
    one = late.take(np.flatnonzero(np.isin(late.t_ns, common)))
    two = reference.take(np.flatnonzero(np.isin(reference.t_ns, common)))
    # As between the methods off line: single precision of some numbers on their tape.
    assert np.abs(one.lat - two.lat).max() * 6.4e6 < 1e-5
    assert np.abs(one.height - two.height).max() < 1e-5
    assert np.abs(one.vel_n - two.vel_n).max() < 1e-6
    assert np.abs(one.q_nb - two.q_nb).max() < 1e-7
    assert np.abs(one.sd / two.sd - 1).max() < 0.01


def test_more_of_the_future_is_better_and_surer(flight: tuple[VehicleRecording, Config]) -> None:
    vehicle, config = flight
    simulation = runs.run(SCENARIO, 3)
    worst, sd = [], []
    for window in (1, 5):
        run = smooth_on_line(vehicle, on_line_config(config, window, 10.0))
        late = run.smoothed.solution
        since = (late.t_ns - simulation.t0_ns) / NS
        inside = (since > OUTAGE.start_s) & (since < OUTAGE.start_s + OUTAGE.seconds)
        error = runs.errors(simulation, late)[inside, 0, :2]
        worst.append(float(np.linalg.norm(error, axis=1).max()))
        sd.append(late.sd[inside, 0, :2].max())
        same = run.solution.take(np.flatnonzero(np.isin(run.solution.t_ns, late.t_ns)))
        assert np.all(late.sd[:, :3] <= same.sd[:, :3] * (1 + 1e-9))
        # One interval and the ring behind outside the outage, all of it inside.
        assert np.median(run.smoothed.lag_ns) < (0.2 * (window + 1) + 0.51) * NS
        assert run.smoothed.lag_ns.max() > OUTAGE.seconds * NS
    forward = runs.errors(simulation, same)[inside, 0, :2]
    assert worst[0] < 0.6 * np.linalg.norm(forward, axis=1).max()
    assert sd[1] < sd[0]


def test_it_gives_way_for_the_windows_of_a_span(flight: tuple[VehicleRecording, Config]) -> None:
    vehicle, config = flight
    config = on_line_config(config, 1, 10.0)
    t0 = int(vehicle.imu[0].t_ns[0])
    span = (t0 + 30 * NS, t0 + 40 * NS)
    whole = smooth_on_line(vehicle, config)
    told_before = play(replace(vehicle, smoothing_gaps=(span,)), config)
    engine = Engine(config)
    smoother = engine.on_line.running
    assert smoother is not None
    parts, settled = [], []
    for imu, aids in blocks(vehicle, config, 1.0):
        for at, tell in ((span[0], smoother.give_way), (span[1], smoother.resume)):
            if int(imu.t_ns[0]) <= at <= int(imu.t_ns[-1]):
                tell(at)  # the moment that it is decided, a block before it counts
        settled.append(engine.step_block(imu, aids).settled)
        parts.append(engine.smooth().smoothed)
    settled.append(engine.finish().settled)
    parts.append(engine.smooth().smoothed)
    told = Smoothed.concatenate([p for p in parts if len(p)])
    assert engine.digest_smoothed == told_before.digest_smoothed != whole.digest_smoothed
    assert engine.digest == told_before.digest
    left = ~told.smoothed
    since = told.solution.t_ns[left] - t0
    assert 29 * NS < since.min() < since.max() < 40 * NS
    assert np.count_nonzero(left) == pytest.approx(100, abs=4)
    forward = Solution.concatenate(settled)
    same = forward.take(np.flatnonzero(np.isin(forward.t_ns, told.solution.t_ns[left])))
    assert np.array_equal(told.solution.take(np.flatnonzero(left)).cov, same.cov)
    assert np.array_equal(told.solution.lat[~left], whole.smoothed.solution.lat[~left])


def test_a_window_that_fails_is_the_filters_and_said_once(
    flight: tuple[VehicleRecording, Config],
) -> None:
    vehicle, config = flight
    config = on_line_config(config, 1, 10.0)
    engine = Engine(config)
    events: list[Event] = []
    parts: list[Smoothed] = []
    for number, (imu, aids) in enumerate(blocks(vehicle, config, 1.0)):
        engine.step_block(imu, aids)
        if number in (40, 41):
            tape = engine.filter.phases[-1].filters[0].tape
            assert isinstance(tape, RunningTape)
            tape.coarse[:] = np.nan
        out = engine.smooth()
        events += out.events
        parts.append(out.smoothed)
    engine.finish()
    parts.append(engine.smooth().smoothed)
    late = Smoothed.concatenate([p for p in parts if len(p)])
    assert [e.kind for e in events] == ["smoothing-failed", "smoothing-works"]
    assert 0 < np.count_nonzero(~late.smoothed) < 60
    assert np.isfinite(late.solution.cov).all()
    assert np.isfinite(late.solution.lat).all()
    assert np.all(np.diff(late.solution.t_ns) > 0)
    assert engine.digest == play(vehicle, config).digest


def test_the_filter_outlives_its_smoother(
    flight: tuple[VehicleRecording, Config], monkeypatch: pytest.MonkeyPatch
) -> None:
    vehicle, config = flight
    config = on_line_config(config, 1, 10.0)
    expected = play(vehicle, config).digest
    advance = FixedLag.advance

    def breaks(self: FixedLag, phases, settled_ns: int):  # type: ignore[no-untyped-def]
        if settled_ns > int(vehicle.imu[0].t_ns[0]) + 50 * NS:
            raise MemoryError("none left")
        return advance(self, phases, settled_ns)

    monkeypatch.setattr(FixedLag, "advance", breaks)
    run = smooth_on_line(vehicle, config)
    (stopped,) = [e for e in run.events if e.kind == "smoothing-stopped"]
    assert "none left" in stopped.text
    assert stopped.level == "error"
    assert len(run.smoothed) > 100
    assert play(vehicle, config).digest == expected


def test_a_declared_break_and_the_end_are_given_out_too(
    flight: tuple[VehicleRecording, Config],
) -> None:
    vehicle, config = flight
    imu = vehicle.imu[0]
    since = (imu.t_ns - imu.t_ns[0]) / NS
    cut = replace(vehicle, imu=(imu.take((since < 30.0) | (since > 33.0)),))
    run = smooth_on_line(cut, on_line_config(config, 3, 10.0))
    late = run.smoothed.solution
    assert any(e.kind == "imu-gap" for e in run.events)
    # A tenth of a second at most is missing before the break and at the end.
    assert run.solution.t_ns[-1] - late.t_ns[-1] < 0.11 * NS
    before = late.t_ns[late.resets == 0][-1]
    assert run.solution.t_ns[run.solution.resets == 0][-1] - before < 0.11 * NS
    assert set(np.unique(late.resets)) == {0, 1}


def test_memory_and_lag_are_bounded_without_fixes(
    flight: tuple[VehicleRecording, Config],
) -> None:
    vehicle, config = flight
    config = runs.changed(
        on_line_config(config, 1, 10.0),
        smoothing={"enabled": True, "rate_hz": 10.0, "longest_interval_s": 2.0},
    )
    blind = withhold_gnss(vehicle, [Window(20.0, 60.0)])
    engine = Engine(config)
    longest = 0
    for imu, aids in blocks(blind, config, 0.5):
        engine.step_block(imu, aids)
        late = engine.smooth().smoothed
        tape = engine.filter.phases[-1].filters and engine.filter.phases[-1].filters[0].tape
        if isinstance(tape, RunningTape):
            longest = max(longest, len(tape.fine))
        if len(late):
            assert late.lag_ns.max() <= (2 * 2.0 + 0.5 + 0.1) * NS
    # Five seconds of steps, updates and rows are about 20 000 numbers; a minute would be 240 000.
    assert 0 < longest < 100_000


@pytest.mark.slow
def test_errors_on_line_are_consistent() -> None:
    """NEES over fifty seeds, outage included: upper 95 % bound over blocks and epochs."""
    seeds, times = 50, (35.0, 50.0, 60.0)
    out = np.empty((seeds, len(times), 5))
    for seed in range(seeds):
        scenario = runs.honest("multirotor-mission", 65.0, 30.0)
        sim = runs.run(scenario, seed)
        heading = 30.0 + np.random.default_rng(1000 + seed).normal(0.0, 5.0)
        config = runs.changed(
            runs.matching_config(scenario),
            alignment={"heading": "fixed", "fixed_heading_deg": heading},
            mag={"sd_deg": 5.0},
            constraints={"zero_velocity": False},
        )
        vehicle = withhold_gnss(sim.recording, [Window(45.0, 10.0)])
        late = smooth_on_line(vehicle, on_line_config(config, 3, 10.0)).smoothed.solution
        at = runs.epochs(late, sim.t0_ns, times)
        out[seed] = runs.nees(runs.errors(sim, late), late)[at]
    mean = out.mean(axis=0)
    low, high = runs.mean_bounds(seeds, probability=1.0 - 0.05 / (5 * len(times)))
    print("NEES by epoch", dict(zip(runs.BLOCKS, mean.T.round(2).tolist(), strict=True)))
    assert np.all(mean < high)
    assert np.all(mean[-1, :3] > low)
