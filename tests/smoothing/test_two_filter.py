"""The two-filter smoothers on simulated flights, and the reversal of time that they stand on."""

from __future__ import annotations

import numpy as np
import pytest

from companion.config import Config
from companion.smoothing.backward_run import run_backwards
from companion.smoothing.correction import apart, state_rows, to_rows
from companion.smoothing.two_filter import two_filter
from companion.types import F64, NS, Solution, VehicleRecording
from replay.preparation import withhold_gnss
from replay.recorded import RecordedRun
from replay.smoothing import record_for, smoothed
from replay.window import Window
from tests.consistency import runs

OUTAGES = (Window(45.0, 15.0), Window(80.0, 20.0))
SCENARIO = runs.honest("multirotor-mission", 130.0)
RATE_HZ = 10.0


@pytest.fixture(scope="module")
def flight() -> tuple[VehicleRecording, Config]:
    """Two minutes with two outages, fixes late, the heading found in motion."""
    config = runs.matching_config(SCENARIO)
    return withhold_gnss(runs.run(SCENARIO, 3).recording, OUTAGES), config


@pytest.fixture(scope="module")
def run(flight: tuple[VehicleRecording, Config]) -> RecordedRun:
    return record_for("two-filter-weighted", *flight, rate_hz=RATE_HZ)


def in_sd(one: Solution, two: Solution) -> F64:
    """(N, 5) root mean square difference over a block's components, in deviations of ``two``."""
    between = apart(to_rows(one), to_rows(two)).reshape(-1, 5, 3)
    return np.sqrt(np.mean((between / two.sd) ** 2, axis=2))


def test_weighted_by_covariance_is_the_optimal_smoother(run: RecordedRun) -> None:
    """But for the linearisation about other states, and a hundredth of the start told twice."""
    optimal = smoothed(run, "bryson-frazier")
    weighted = smoothed(run, "two-filter-weighted")
    assert np.array_equal(weighted.t_ns, optimal.t_ns)
    apart_sd = in_sd(weighted, optimal)
    assert np.median(apart_sd) < 0.1
    assert (apart_sd < 1.0).mean() > 0.99
    ratio = weighted.sd / optimal.sd
    assert 0.95 < np.median(ratio) < 1.05


def test_simplified_fades_from_one_run_to_the_other(
    flight: tuple[VehicleRecording, Config], run: RecordedRun
) -> None:
    solution = two_filter(run.solution, run.reports, run.stretches, run.config)
    back = run_backwards(run.stretches[0], run.config, run.solution.t_ns)
    assert back.known.all()
    backward = state_rows(back.nominal)
    forward, mixed = to_rows(run.solution), to_rows(solution)
    t = (solution.t_ns - flight[0].imu[0].t_ns[0]) / NS
    for outage in OUTAGES:
        # The last fix before an outage is 0.2 s old, the first after it comes at its end.
        for fraction in (0.25, 0.5, 0.75):
            at = int(np.argmin(np.abs(t - outage.start_s - fraction * outage.seconds)))
            begin = outage.start_s - 0.2
            share = (t[at] - begin) / (outage.start_s + outage.seconds - begin)
            row = slice(at, at + 1)
            whole = apart(backward[row], forward[row])
            part = apart(mixed[row], forward[row])
            assert np.allclose(part, share * whole, rtol=0.02, atol=1e-9)
