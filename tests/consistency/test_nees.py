"""Errors against the covariance that was claimed, over seeds, in simulated flights and drives.

Sensors have only the errors that the filter models, in the sizes that it is told, so the normalised
estimation error squared (NEES) of each 3-vector is χ² with 3 degrees of freedom. Epochs of one
run are correlated, runs are not: bounds are taken at each epoch over the seeds, two-sided 95 %
for all epochs and blocks of a scenario together (Bonferroni).
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from companion.config.adaptation import Method
from companion.types import Channel

from . import runs

SEEDS = 50


def _nees(name: str, duration_s: float, times_s: tuple[float, ...], **gnss: object) -> np.ndarray:
    """(SEEDS, epochs, 5) NEES; start headings go round the compass."""
    out = np.empty((SEEDS, len(times_s), 5))
    for seed in range(SEEDS):
        scenario = runs.honest(name, duration_s, seed * 77 % 360 - 180.0, **gnss)
        sim = runs.run(scenario, seed)
        config = runs.changed(runs.matching_config(scenario), engine={"output_rate_hz": 2.0})
        flown = runs.fly(sim.recording, config)
        assert flown.event("reset") is None
        at = runs.epochs(flown.solution, sim.t0_ns, times_s)
        out[seed] = runs.nees(runs.errors(sim, flown.solution), flown.solution)[at]
    return out


def _bounds(epochs: int) -> tuple[float, float]:
    return runs.mean_bounds(SEEDS, probability=1.0 - 0.05 / (5 * epochs))


def test_drive_with_heading_found_in_motion_does_not_claim_too_much() -> None:
    """No lower bound: its constraints hold exactly here, tighter than the configuration says."""
    times = (35.0, 50.0, 64.0)
    mean = _nees("car-with-stops", 65.0, times).mean(axis=0)
    print("NEES by epoch", dict(zip(runs.BLOCKS, mean.T.round(2).tolist(), strict=True)))
    assert np.all(mean < _bounds(len(times))[1])


FLIGHT_TIMES = (5.0, 35.0, 50.0, 64.0)
INNOVATIONS = (
    Channel.GNSS_POSITION_H,
    Channel.GNSS_POSITION_V,
    Channel.GNSS_VELOCITY_H,
    Channel.GNSS_VELOCITY_V,
    Channel.BARO,
)


@cache
def _flights(name: str, adaptation: Method) -> tuple[np.ndarray, np.ndarray]:
    """(SEEDS, epochs, 5) NEES of flights with a heading given to 5°, and (channels, 2) of all
    their innovations: the sum of NIS and of degrees of freedom.

    Zero velocity is off: simulated standing is stiller than stated.
    """
    out = np.empty((SEEDS, len(FLIGHT_TIMES), 5))
    sums = np.zeros((len(INNOVATIONS), 2))
    for seed in range(SEEDS):
        scenario = runs.honest(name, 65.0, 30.0)
        sim = runs.run(scenario, seed)
        heading = 30.0 + np.random.default_rng(1000 + seed).normal(0.0, 5.0)
        config = runs.changed(
            runs.matching_config(scenario),
            engine={"output_rate_hz": 2.0},
            alignment={"heading": "fixed", "fixed_heading_deg": float(heading)},
            mag={"use": False, "sd_deg": 5.0},
            constraints={"zero_velocity": False},
            adaptation={"method": adaptation},
        )
        flown = runs.fly(sim.recording, config)
        at = runs.epochs(flown.solution, sim.t0_ns, FLIGHT_TIMES)
        out[seed] = runs.nees(runs.errors(sim, flown.solution), flown.solution)[at]
        for i, channel in enumerate(INNOVATIONS):
            own = (flown.reports.channel == channel) & (flown.reports.dof > 0)
            sums[i] += flown.reports.nis[own].sum(), flown.reports.dof[own].sum()
    return out, sums


@pytest.mark.parametrize(
    ("name", "adaptation"),
    [
        ("fixed-wing", "none"),
        ("multirotor-mission", "none"),
        pytest.param("fixed-wing", "fuzzy", marks=pytest.mark.slow),
        pytest.param("multirotor-mission", "fuzzy", marks=pytest.mark.slow),
    ],
)
def test_flight_is_consistent(name: str, adaptation: Method) -> None:
    """Both bounds at every epoch, at rest and in flight; healthy sensors leave the rules nothing to
    do, so what is published with them is as honest."""
    mean = _flights(name, adaptation)[0].mean(axis=0)
    low, high = _bounds(len(FLIGHT_TIMES))
    print("NEES by epoch", dict(zip(runs.BLOCKS, mean.T.round(2).tolist(), strict=True)))
    assert np.all(mean > low)
    assert np.all(mean < high)


@pytest.mark.parametrize("name", ["fixed-wing", "multirotor-mission"])
def test_innovations_are_as_large_as_the_filter_says(name: str) -> None:
    """NIS of a filter without adaptation: innovations of an optimal filter are white, so the sum
    over all updates of all flights is χ². Gated ones count too."""
    nis, dof = _flights(name, "none")[1].T
    tail = 0.5 * 0.05 / len(INNOVATIONS)
    low, high = chi2.ppf([[tail], [1.0 - tail]], dof) / dof
    mean = nis / dof
    print("NIS/dof", {c.name: round(float(m), 3) for c, m in zip(INNOVATIONS, mean, strict=True)})
    assert np.all(dof > 10_000)
    assert np.all(mean > low)
    assert np.all(mean < high)


def test_a_receiver_whose_error_wanders_is_known_to_from_its_first_fix_on() -> None:
    """Two-sided at every epoch: the first fix carries the slow error as much as any other.

    What the receiver reports is the whole of its error, so it is not the white part.
    """
    slow, tau_s, times = (1.5, 2.5), 60.0, (3.0, 15.0, 39.0)
    out = np.empty((SEEDS, len(times)))
    for seed in range(SEEDS):
        scenario = runs.honest(
            "static",
            40.0,
            correlated_sd_position_m=slow[0],
            correlated_sd_height_m=slow[1],
            correlated_tau_s=tau_s,
        )
        sim = runs.run(scenario, seed)
        receiver = scenario.gnss[0]
        config = runs.changed(
            runs.matching_config(scenario),
            engine={"output_rate_hz": 2.0},
            alignment={"heading": "fixed", "fixed_heading_deg": 30.0},
            gnss={
                "sd_position_m": receiver.sd_position_m,
                "sd_height_m": receiver.sd_height_m,
                "sd_reported": "ignore",
                "slow_error_sd_m": slow[0],
                "slow_error_height_sd_m": slow[1],
                "slow_error_tau_s": tau_s,
            },
        )
        flown = runs.fly(sim.recording, config)
        at = runs.epochs(flown.solution, sim.t0_ns, times)
        out[seed] = runs.nees(runs.errors(sim, flown.solution), flown.solution)[at, 0]
    mean = out.mean(axis=0)
    low, high = runs.mean_bounds(SEEDS, probability=1.0 - 0.05 / len(times))
    print("NEES of position by epoch", mean.round(2).tolist())
    assert np.all(mean > low)
    assert np.all(mean < high)
