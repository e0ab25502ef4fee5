"""A start with biases saved from an earlier run: their small deviations must be honest too."""

from __future__ import annotations

import numpy as np
import pytest

from companion.config import DEG, Config
from companion.types import F64

from . import runs

SEEDS = 40
GYRO_SD_DPS, ACCEL_SD_MPS2 = 0.01, 0.01
"""Of a saved bias; at turn-on thirty and ten times that. A second at rest gives 0.008 deg/s."""
TIMES = (1.5, 10.0, 29.0)


def _config(scenario: runs.Scenario, seed: int, gyro_b: F64, accel_b: F64) -> Config:
    """Heading given with 5° of error, biases (3,) with the stated deviations."""
    rng = np.random.default_rng(1000 + seed)
    gyro_dps = gyro_b / DEG + rng.normal(0.0, GYRO_SD_DPS, 3)
    accel = accel_b + rng.normal(0.0, ACCEL_SD_MPS2, 3)
    return runs.changed(
        runs.matching_config(scenario),
        imu={
            "gyro_bias_dps": tuple(gyro_dps.tolist()),
            "gyro_bias_sd_dps": GYRO_SD_DPS,
            "accel_bias_mps2": tuple(accel.tolist()),
            "accel_bias_sd_mps2": ACCEL_SD_MPS2,
        },
        engine={"output_rate_hz": 2.0},
        alignment={"heading": "fixed", "fixed_heading_deg": 30.0 + float(rng.normal(0.0, 5.0))},
        mag={"use": False, "sd_deg": 5.0},
        constraints={"zero_velocity": False},
    )


@pytest.mark.parametrize("name", ["fixed-wing", "multirotor-mission"])
def test_start_is_consistent(name: str) -> None:
    """Attitude and biases, from levelling on; two-sided at the start, as the gyro's later is not.

    Upper bound at every epoch; 95 % for all epochs and blocks together (Bonferroni).
    """
    out = np.empty((SEEDS, len(TIMES), 5))
    claimed = np.empty((SEEDS, 5, 3))
    for seed in range(SEEDS):
        scenario = runs.honest(name, 30.0, 30.0)
        sim = runs.run(scenario, seed)
        config = _config(scenario, seed, sim.gyro_bias_b[0][0], sim.accel_bias_b[0][0])
        flown = runs.fly(sim.recording, config)
        at = runs.epochs(flown.solution, sim.t0_ns, TIMES)
        claimed[seed] = flown.solution.sd[at[0]]
        out[seed] = runs.nees(runs.errors(sim, flown.solution), flown.solution)[at]
    mean = out.mean(axis=0)
    print("NEES by epoch", dict(zip(runs.BLOCKS, mean.T.round(2).tolist(), strict=True)))
    low, high = runs.mean_bounds(SEEDS, probability=1.0 - 0.05 / (5 * len(TIMES)))
    assert np.all(mean < high)
    assert np.all(mean[0, 2:4] > low)
    # Saved and measured at rest together are better than either alone, and level profits.
    assert np.all(claimed[:, 4] < GYRO_SD_DPS * DEG)
    assert np.all(claimed[:, 3] < 1.001 * ACCEL_SD_MPS2)
    assert np.all(claimed[:, 2, :2] < 1.5 * ACCEL_SD_MPS2 / 9.8)
