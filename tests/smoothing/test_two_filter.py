"""The two-filter smoothers on simulated flights, and the reversal of time that they stand on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from companion.config import Config
from companion.smoothing.backward_run import run_backwards
from companion.smoothing.correction import apart, state_rows, to_rows
from companion.smoothing.fading import consistent
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
    return np.asarray(np.sqrt(np.mean((between / two.sd) ** 2, axis=2)))


def test_weighted_by_covariance_is_the_optimal_smoother(run: RecordedRun) -> None:
    """But for the linearisation about other states, and a hundredth of the start told twice."""
    optimal = smoothed(run, "bryson-frazier")
    weighted = smoothed(run, "two-filter-weighted")
    assert np.array_equal(weighted.t_ns, optimal.t_ns)
    difference = in_sd(weighted, optimal)
    assert np.median(difference) < 0.1
    assert (difference < 1.0).mean() > 0.99
    assert 0.95 < np.median(weighted.sd / optimal.sd) < 1.05


def test_straight_weights_fade_from_one_run_to_the_other(
    flight: tuple[VehicleRecording, Config], run: RecordedRun
) -> None:
    back = run_backwards(run.stretches[0], run.config, run.solution.t_ns)
    assert back.known.all()
    backward, forward = state_rows(back.nominal), to_rows(run.solution)
    mixed = to_rows(smoothed(run, "two-filter-straight"))
    t = (run.solution.t_ns - flight[0].imu[0].t_ns[0]) / NS
    for outage in OUTAGES:
        # The last fix before an outage is 0.2 s old, the first after it comes at its end.
        begin, end = outage.start_s - 0.2, outage.start_s + outage.seconds
        for fraction in (0.25, 0.5, 0.75):
            at = int(np.argmin(np.abs(t - outage.start_s - fraction * outage.seconds)))
            row = slice(at, at + 1)
            share = (t[at] - begin) / (end - begin)
            whole = apart(backward[row], forward[row])
            # A difference in degrees of heading does not commute with one of tilt, to its square.
            assert np.allclose(apart(mixed[row], forward[row]), share * whole, atol=1e-6)


@pytest.mark.parametrize("seconds", [2.0, 30.0])
def test_consistent_weights_are_those_of_an_optimal_bridge(seconds: float) -> None:
    """White acceleration between two ends known in position and velocity: its posterior mean.

    The batch solution of a chain of 100 steps, the ends as hard measurements, corrects a forward
    integration by what :func:`consistent` says of the difference to the backward one. The chain
    holds acceleration over a step, which a hundredth of the outage resolves to its square.
    """
    count = 100
    dt = seconds / count
    F = np.array([[1.0, dt], [0.0, 1.0]])
    to = [np.zeros((2, count))]
    for k in range(count):
        step = F @ to[-1]
        step[:, k] += [0.5 * dt * dt, dt]
        to.append(step)
    end = to[-1]
    missed = np.array([3.0, -0.7])
    best = end.T @ np.linalg.solve(end @ end.T, missed)
    for k in (10, 50, 83):
        error = to[k] @ best
        # Backwards from the true end, without acceleration, against forwards without it.
        apart_there = np.array([missed[0] - missed[1] * (count - k) * dt, missed[1]])
        A = consistent(np.array([k / count]), seconds)[0]
        assert np.allclose(A @ apart_there, error, rtol=2e-3, atol=2e-3)


def test_two_filters_are_within_twice_the_optimum_in_mid_outage() -> None:
    """Three flights with two outages of 20 s, root mean square over their middles."""
    middle: dict[str, list[float]] = {"bryson-frazier": [], "two-filter": []}
    inside: dict[str, list[float]] = {"forward": [], "two-filter": []}
    windows = (Window(60.0, 20.0), Window(95.0, 20.0))
    for seed in range(3):
        simulation = runs.run(SCENARIO, seed)
        recorded = record_for(
            "two-filter-weighted",
            withhold_gnss(simulation.recording, windows),
            runs.matching_config(SCENARIO),
            rate_hz=RATE_HZ,
        )
        found = {"forward": recorded.solution}
        for method in ("bryson-frazier", "two-filter"):
            found[method] = smoothed(recorded, method)  # type: ignore[arg-type]
        for name, solution in found.items():
            error = runs.errors(simulation, solution)[:, 0, :2]
            t = (solution.t_ns - simulation.t0_ns) / NS
            for window in windows:
                since = (t - window.start_s) / window.seconds
                if name in middle:
                    middle[name].append(float(np.hypot(*error[np.argmin(np.abs(since - 0.5))])))
                if name in inside:
                    part = error[(since >= 0) & (since <= 1)]
                    inside[name].append(float(np.max(np.hypot(*part.T))))
    rms = {name: float(np.sqrt(np.mean(np.square(x)))) for name, x in middle.items()}
    assert rms["two-filter"] < 2.0 * rms["bryson-frazier"]
    assert max(inside["two-filter"]) < 0.5 * max(inside["forward"])


def test_a_declared_break_is_not_crossed(flight: tuple[VehicleRecording, Config]) -> None:
    """Each side of a gap in the IMU is smoothed as if it were alone."""
    vehicle, config = flight
    imu = vehicle.imu[0]
    t = (imu.t_ns - imu.t_ns[0]) / NS
    cut = replace(vehicle, imu=(imu.take((t < 64.0) | (t > 68.0)),))
    short = replace(vehicle, imu=(imu.take(t < 64.0),))
    both = smoothed(record_for("two-filter", cut, config, rate_hz=RATE_HZ), "two-filter")
    first = smoothed(record_for("two-filter", short, config, rate_hz=RATE_HZ), "two-filter")
    assert len(np.unique(both.resets)) == 2
    assert np.array_equal(both.lat[: len(first)], first.lat)
    assert np.isfinite(both.cov).all()
