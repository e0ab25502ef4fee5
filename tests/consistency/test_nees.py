"""Errors against the covariance that was claimed, over seeds, in simulated flights and drives.

Sensors have only the errors that the filter models, in the sizes that it is told, so the normalised
estimation error squared (NEES) of each 3-vector is χ² with 3 degrees of freedom. Epochs of one
run are correlated, runs are not: bounds are taken at each epoch over the seeds, two-sided 95 %
for all epochs and blocks of a scenario together (Bonferroni).
"""

from __future__ import annotations

import numpy as np
import pytest

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


@pytest.mark.parametrize("name", ["fixed-wing", "multirotor-mission"])
def test_flight_is_consistent(name: str) -> None:
    """Heading given with 5° of error. Upper bound at every epoch, both bounds at the last.

    Early on the gyro bias is claimed too cautiously: its variance at rest is the larger of two
    estimates of the same noise. Zero velocity is off: simulated standing is stiller than stated.
    """
    times = (35.0, 50.0, 64.0)
    out = np.empty((SEEDS, len(times), 5))
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
        )
        flown = runs.fly(sim.recording, config)
        at = runs.epochs(flown.solution, sim.t0_ns, times)
        out[seed] = runs.nees(runs.errors(sim, flown.solution), flown.solution)[at]
    mean = out.mean(axis=0)
    low, high = _bounds(len(times))
    print("NEES by epoch", dict(zip(runs.BLOCKS, mean.T.round(2).tolist(), strict=True)))
    assert np.all(mean < high)
    assert np.all(mean[-1] > low)


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
