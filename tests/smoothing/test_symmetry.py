"""P stays symmetric to the bit, and what smoothing would lose otherwise.

A prototype of this project whose update left P a little unsymmetric filtered as well as before and
lost half of its smoothed height accuracy, in silence: smoothing takes from P what the filter hardly
looks at.
"""

from __future__ import annotations

import numpy as np
import pytest

from companion.navigation import layout as lo
from companion.types import F64
from replay.preparation import withhold_gnss
from replay.recorded import record
from replay.window import Window
from tests.consistency import runs
from tests.smoothing.linear import linear_run
from tests.smoothing.test_linear import bryson_frazier

HEIGHT = 2


def unsymmetric(P: F64, gain: F64) -> None:
    """An update that takes a tenth less below the diagonal than above it."""
    whole = np.outer(gain, gain)
    P -= np.triu(whole) + 0.9 * np.tril(whole, -1)


@pytest.mark.parametrize("seed", range(3))
def test_an_unsymmetric_update_is_seen_in_smoothed_height(seed: int) -> None:
    """The watch is awake: what it holds below 1e-9 of a σ is some tenths of one then."""
    right, wrong = linear_run(seed), linear_run(seed, update=unsymmetric)
    sd = np.sqrt(right.batch_cov[:, HEIGHT, HEIGHT])
    off = []
    for run in (right, wrong):
        smoothed = run.forward + bryson_frazier(run)[0]
        off.append(np.sqrt(np.mean(((smoothed - right.batch)[:, HEIGHT] / sd) ** 2)))
    assert off[0] < 1e-9
    assert off[1] > 0.1


@pytest.mark.parametrize("correction", ["feedback", "feedforward"])
def test_the_filters_covariance_is_symmetric_to_the_bit(correction: str) -> None:
    """All optional states, late fixes, an outage, standing still: at each block and at the end."""
    scenario = runs.honest("multirotor-mission", 70.0)
    config = runs.changed(
        runs.matching_config(scenario),
        imu={"scale_factor_states": True},
        gnss={"lever_arm_sd_m": 0.05, "slow_error_sd_m": 1.0, "slow_error_height_sd_m": 1.7},
        engine={"correction": correction},
        alignment={"heading": "fixed", "fixed_heading_deg": 30.0},
    )
    vehicle = withhold_gnss(runs.run(scenario, 5).recording, [Window(40.0, 10.0)])
    run = record(vehicle, config, inputs=True, rate_hz=10.0)
    states = [c.s for tape in run.tapes for c in tape.chunks] + [
        mark.s for stretch in run.stretches for mark in stretch.marks
    ]
    assert len(states) >= 3
    for s in states:
        n = round(np.sqrt(len(s) - lo.P))
        P = s[lo.P :].reshape(n, n)
        assert np.array_equal(P, P.T)
        assert np.linalg.eigvalsh(P / np.sqrt(np.outer(np.diag(P), np.diag(P))))[0] > 0.0
