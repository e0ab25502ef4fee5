"""Smoothing in a live run: what it gives out, when it gives way, and the same again in replay."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import msgspec
import pytest

from companion.config import Config
from companion.runtime.smoothing_pace import PAUSE_NS, SPAN_NS, SmoothingPace
from companion.types import NS
from replay.player import play
from replay.run_log import read_run, read_solution
from replay.verification import compare_with_live

from . import flights


def _config() -> tuple[list[flights.Arrival], Config]:
    vehicle, config = flights.vehicle()
    config = msgspec.structs.replace(
        config,
        mag=msgspec.structs.replace(config.mag, use=True, declination_deg=4.0),
        smoothing=msgspec.structs.replace(config.smoothing, enabled=True, window=2),
    )
    streams = (*vehicle.gnss, *vehicle.baro, *vehicle.mag)
    arrivals = [piece for stream in streams for piece in flights.pieces(stream)]
    return [*flights.can_frames(vehicle.imu[0]), *arrivals], flights.with_can(config, "imu")


def test_the_log_replayed_smooths_to_the_same_bits(tmp_path: Path) -> None:
    arrivals, config = _config()
    flown = flights.fly(arrivals, config, tmp_path / "run.mcap")
    stored = read_solution(flown.path)
    assert stored.smoothed is not None
    assert len(stored.smoothed) > 80
    assert sum(len(o.smoothed) for o in flown.outputs) == len(stored.smoothed)
    (vehicle,) = read_run(flown.path).vehicles
    engine = play(vehicle, flown.core.config)
    assert engine.digest_smoothed == flown.summary["digest_smoothed"]
    found = compare_with_live(
        flown.path, vehicle, config, engine.digest, engine.digest_published, "another"
    )
    assert found is not None
    assert not found.equal
    assert flown.core.counters()["smoothing.epochs"] == len(stored.smoothed)


def test_it_gives_way_where_it_takes_too_long_and_replay_follows(tmp_path: Path) -> None:
    """Each look at the stopwatch is 4 ms after the last: 200 steps a second and as many calls of
    the smoother make 1.6 s of every second."""
    arrivals, config = _config()
    ticks = itertools.count(step=4_000_000)
    flown = flights.fly(arrivals, config, tmp_path / "run.mcap", stopwatch=lambda: next(ticks))
    assert flown.kinds().count("smoothing-gave-way") == 1
    counters = flown.core.counters()
    assert counters["smoothing.gave_way"] == 1
    assert counters["smoothing.as_filtered"] > 20
    (vehicle,) = read_run(flown.path).vehicles
    assert len(vehicle.smoothing_gaps) == 1
    assert play(vehicle, flown.core.config).digest_smoothed == flown.summary["digest_smoothed"]
    told = read_solution(flown.path)
    assert told.digest == flown.digest


def test_the_pace_of_a_busy_smoother() -> None:
    pace = SmoothingPace(Config(), 0)
    now = 0

    def span(filter_s: float, smooth_s: float) -> str | None:
        nonlocal now
        pace.filtered(round(filter_s * NS), 400)
        pace.smoothed(round(smooth_s * NS), 20)
        now += SPAN_NS
        return pace.tick(now)

    assert span(0.4, 0.6) is None  # half of the two seconds
    assert span(0.4, 1.2) == "give-way"
    paused = now
    assert pace.giving_way
    while (decision := span(0.4, 0.0)) is None:
        assert now - paused < PAUSE_NS
    assert decision == "resume"
    assert now - paused == PAUSE_NS
    # It was no use: twice as long.
    assert span(0.4, 1.2) == "give-way"
    paused = now
    while span(0.4, 0.0) is None:
        assert now - paused < 2 * PAUSE_NS
    assert now - paused == 2 * PAUSE_NS
    # The filter alone takes too much: not the time to go on.
    assert span(0.2, 1.5) == "give-way"
    for _ in range(100):
        assert span(1.9, 0.0) is None


def test_the_bound_on_the_output_rate_is_the_papers() -> None:
    """Section 3.2: 0.3 ms a filter step and 0.5 ms a smoothed epoch at 50 Hz allow about 40 Hz."""
    pace = SmoothingPace(Config(), 0)
    assert math.isnan(pace.rate_bound_hz(NS, 1.0))
    for _ in range(50):
        pace.filtered(300_000, 1)
    pace.smoothed(25 * 500_000, 25)
    assert pace.rate_bound_hz(NS, 1.0) == pytest.approx(39.4, abs=0.1)
