"""The run backwards with whatever the forward run did: kinds of IMU, states, adaptation."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from companion.config import Config
from companion.smoothing.correction import apart, to_rows
from companion.types import NS, Solution
from replay.preparation import withhold_gnss
from replay.simulator import Scenario, Simulation
from replay.smoothing import record_for, smoothed
from replay.window import Window
from tests.consistency import runs

OUTAGE = Window(60.0, 15.0)
BASE = runs.honest("multirotor-mission", 100.0)


def _integral() -> Scenario:
    imu = msgspec.structs.replace(BASE.imu[0], output="integral")
    return msgspec.structs.replace(BASE, imu=(imu,))


CASES: dict[str, tuple[Scenario, dict[str, dict[str, object]]]] = {
    "integral": (_integral(), {}),
    "scale factors": (BASE, {"imu": {"scale_factor_states": True}}),
    "lever arm and slow error": (
        BASE,
        {"gnss": {"lever_arm_sd_m": 0.05, "slow_error_sd_m": 1.0, "slow_error_height_sd_m": 1.7}},
    ),
    "adapted R and Q": (
        BASE, {"adaptation": {"method": "fuzzy"}, "gnss": {"sd_position_m": 0.12}},
    ),
    "exponential weight": (
        BASE, {"adaptation": {"method": "flac"}, "gnss": {"sd_position_m": 0.12}},
    ),
}  # fmt: skip


def _flown(case: str) -> tuple[Simulation, Config]:
    scenario, keys = CASES[case]
    return runs.run(scenario, 3), runs.changed(runs.matching_config(scenario), **keys)


def _worst(simulation: Simulation, solution: Solution) -> float:
    """Largest horizontal error inside the outage [m]."""
    t = (solution.t_ns - simulation.t0_ns) / NS
    inside = (t >= OUTAGE.start_s) & (t <= OUTAGE.start_s + OUTAGE.seconds)
    return float(np.hypot(*runs.errors(simulation, solution)[inside, 0, :2].T).max())


@pytest.mark.parametrize("case", CASES)
def test_two_filters_come_out_where_the_optimal_smoother_does(case: str) -> None:
    """By covariances in half a deviation, as a run backwards adapts to other innovations."""
    simulation, config = _flown(case)
    run = record_for(
        "two-filter-weighted", withhold_gnss(simulation.recording, [OUTAGE]), config, rate_hz=5.0
    )
    optimal = smoothed(run, "bryson-frazier")
    weighted = smoothed(run, "two-filter-weighted")
    simple = smoothed(run, "two-filter")
    assert np.array_equal(weighted.t_ns, optimal.t_ns)
    between = apart(to_rows(weighted), to_rows(optimal)).reshape(-1, 5, 3)
    off = np.sqrt(np.mean((between / optimal.sd) ** 2, axis=2))
    assert np.median(off) < 0.5
    assert np.isfinite(simple.cov).all()
    forward = _worst(simulation, run.solution)
    for solution in (weighted, simple):
        assert _worst(simulation, solution) < 0.6 * forward
