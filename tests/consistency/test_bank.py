"""What is published while the heading is unknown covers all hypotheses, not the likeliest alone."""

from __future__ import annotations

import numpy as np
import pytest

from companion.types import Mode

from . import runs

TIMES_S = (20.0, 40.0, 64.0)


def _check(seeds: int) -> None:
    """NEES of a multirotor that mostly hovers, no heading given, over ``seeds`` start headings.

    No lower bound: simulated standing is stiller than stated. Each hypothesis takes its own part of
    the gyro's mean for Earth's rate, 5e-5 rad/s here, and is sure of the rest to 3e-5: published as
    it stood, the gyro bias had a NEES of 8.
    """
    out = np.empty((seeds, len(TIMES_S), 5))
    unknown = 0
    for seed in range(seeds):
        scenario = runs.honest("multirotor-mission", 65.0, seed * 77 % 360 - 180.0)
        sim = runs.run(scenario, seed)
        config = runs.changed(
            runs.matching_config(scenario),
            engine={"output_rate_hz": 2.0},
            alignment={"heading": "unknown"},
        )
        flown = runs.fly(sim.recording, config)
        at = runs.epochs(flown.solution, sim.t0_ns, TIMES_S)
        out[seed] = runs.nees(runs.errors(sim, flown.solution), flown.solution)[at]
        unknown += int((flown.solution.mode[at] == Mode.HEADING_UNKNOWN).sum())
    assert unknown > seeds  # it is the bank that is looked at
    mean = out.mean(axis=0)
    print("NEES by epoch", dict(zip(runs.BLOCKS, mean.T.round(2).tolist(), strict=True)))
    high = runs.mean_bounds(seeds, probability=1.0 - 0.05 / mean.size)[1]
    assert np.all(mean < high)


def test_bank_does_not_claim_what_its_hypotheses_disagree_on() -> None:
    _check(6)


@pytest.mark.slow
@pytest.mark.xfail(
    strict=True,
    reason="attitude at 64 s: 4.4 where 4.1 is allowed; in 5 of 35 flights that hover on with the "
    "heading unknown the likeliest hypothesis is far off (docs/results.md)",
)
def test_bank_does_not_claim_what_its_hypotheses_disagree_on_in_more_flights() -> None:
    _check(50)
