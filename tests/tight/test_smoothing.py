"""Smoothing of tight runs: two methods, one answer; better through partial outages; on line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from companion.smoothing.offline import smooth
from companion.types import NS, ConfigError, VehicleRecording
from replay.on_line import on_line_config, smooth_on_line
from replay.player import play
from replay.recorded import record
from replay.smoothing import record_for

from . import flights


def _partial() -> VehicleRecording:
    """Two satellites for twenty seconds, and a clock that jumps in that time."""
    vehicle = flights.withheld(flights.flight().recording, 50.0, 70.0, 2)
    raw, t = vehicle.raw[0], flights.seconds(vehicle)
    jump = np.where(t >= 80.0, 41_234.5, 0.0)[:, None]
    return flights.with_raw(vehicle, replace(raw, pseudorange=raw.pseudorange + jump))


def test_forward_of_a_smoothed_run_has_the_settled_bits() -> None:
    vehicle, config = _partial(), flights.config()
    assert record(vehicle, config).digest == play(vehicle, config).digest


def test_both_methods_agree_and_improve() -> None:
    """As for loose runs (tests/smoothing/test_flights.py), with the clock's states and its jump."""
    vehicle, config = _partial(), flights.config()
    run = record(vehicle, config, rate_hz=10.0)
    assert any(e.kind == "receiver-clock" for e in run.events)
    one, two = smooth(run.tapes, run.config), smooth(run.tapes, run.config, "rts")
    assert np.array_equal(one.t_ns, two.t_ns)
    # A clock that is let go has a variance of 1e10 m² beside others of 1e-6: RTS inverts that.
    assert np.abs(one.lat - two.lat).max() * 6.4e6 < 1e-3
    assert np.abs(one.height - two.height).max() < 1e-3
    assert np.abs(one.vel_n - two.vel_n).max() < 1e-4
    assert np.abs(one.sd[:, :3] / two.sd[:, :3] - 1).max() < 0.02
    forward = run.solution.take(np.flatnonzero(np.isin(run.solution.t_ns, one.t_ns)))
    assert (one.sd[:, :3] <= forward.sd[:, :3] * (1 + 1e-3)).all()
    at, error = flights.errors(forward)
    inside = (at > 50.0) & (at < 70.0)
    smoothed = flights.errors(one)[1]
    worst = [np.linalg.norm(e[inside], axis=1).max() for e in (error, smoothed)]
    assert worst[1] < 0.5 * worst[0]


def test_on_line_ends_an_interval_with_each_epoch() -> None:
    vehicle = _partial()
    config = on_line_config(flights.config(), 3, 10.0)
    run = smooth_on_line(vehicle, config)
    assert run.smoothed.smoothed.mean() > 0.95
    # Windows of three epochs at 5 Hz: what lags more lags behind the outage or the start.
    lag = np.median(run.smoothed.lag_ns) / NS
    assert lag < 3 * 0.2 + config.engine.delay_ring_s + 0.2


def test_what_cannot_go_backwards_says_so() -> None:
    with pytest.raises(ConfigError, match="bryson-frazier"):
        record_for("two-filter", flights.flight().recording, flights.config())
