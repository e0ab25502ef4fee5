"""Fixes that arrive 200 ms after their epoch, against the same flight with fixes at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from companion.types import F64, NS, Solution
from replay.player import play

from . import runs

SETTLED_S = 25.0
LATENCY_S = 0.2


@dataclass(frozen=True)
class Flight:
    """Velocity errors (N, 3) [m/s] and NEES (N, 5) of one flight, later than ``SETTLED_S``."""

    published: F64
    settled: F64
    nees: F64
    """Of what was published."""


def _fly(latency_s: float, told_s: float) -> Flight:
    scenario = runs.honest("fixed-wing", 70.0, latency_ms=1e3 * latency_s, stamped="arrival")
    sim = runs.run(scenario, 3)
    config = runs.changed(
        runs.matching_config(scenario),
        alignment={"heading": "fixed", "fixed_heading_deg": 30.0},
        mag={"use": False, "sd_deg": 5.0},
        gnss={"latency_ms": 1e3 * told_s},
        engine={"output_rate_hz": 20.0},
    )
    parts: list[tuple[Solution, Solution]] = []
    play(sim.recording, config, lambda _, out: parts.append((out.published, out.settled)))

    def late(which: int) -> tuple[F64, F64]:
        solution = Solution.concatenate([p[which] for p in parts])
        error = runs.errors(sim, solution)
        used = (solution.t_ns - sim.t0_ns) / NS > SETTLED_S
        return error[used], runs.nees(error, solution)[used]

    published, nees = late(0)
    return Flight(published[:, 1], late(1)[0][:, 1], nees)


def _rms(error: F64) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


@pytest.fixture(scope="module")
def flights() -> tuple[Flight, Flight, Flight]:
    """Prompt; 200 ms late and told so; 200 ms late and not told."""
    return _fly(0.0, 0.0), _fly(LATENCY_S, LATENCY_S), _fly(LATENCY_S, 0.0)


def test_what_settles_is_as_good_as_without_latency(flights: tuple[Flight, ...]) -> None:
    prompt, late, _ = flights
    # The same fixes at the same epochs; only the last one, not yet arrived at the end, is missing.
    assert _rms(late.settled) == pytest.approx(_rms(prompt.settled), rel=0.01)


def test_what_is_published_costs_in_proportion(flights: tuple[Flight, ...]) -> None:
    """Each epoch lacks the last 200 ms of fixes: one more of a fifth of a second each."""
    prompt, late, _ = flights
    ratio = _rms(late.published) / _rms(prompt.published)
    print(f"velocity RMS {_rms(prompt.published):.4f} and {_rms(late.published):.4f} m/s")
    assert ratio < 1.25


def test_what_is_published_late_is_consistent(flights: tuple[Flight, ...]) -> None:
    """One flight's mean NEES of 3 degrees of freedom stays with that of the prompt one."""
    prompt, late, _ = flights
    print("NEES", prompt.nees.mean(axis=0).round(2), late.nees.mean(axis=0).round(2))
    assert np.all(late.nees[:, :2].mean(axis=0) < 1.25 * prompt.nees[:, :2].mean(axis=0))


def test_a_latency_that_is_not_told_is_seen_in_the_velocity(flights: tuple[Flight, ...]) -> None:
    """So that the tests above could fail: acceleration times 200 ms enters the velocity."""
    _, late, untold = flights
    assert _rms(untold.settled) > 3.0 * _rms(late.settled)
