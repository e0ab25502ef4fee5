"""The noise of a receiver's clock, learned: what simulated clocks of known noise make of it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.config import RawGnss
from companion.gnss.clock_noise import (
    LEAST,
    MOST,
    Q_BIAS,
    Q_DRIFT,
    Q_RAMP,
    Q_SIZE,
    SCALE,
    interrupt,
    learn_clock,
    new_learner,
)
from companion.types import F64

CONFIG = RawGnss()
HZ = 5
NAN = math.nan


def clock(seconds: int, seed: int, *, drift: float, ramp: float = 0.0) -> tuple[F64, F64, F64]:
    """Times, readings [m] and rates [m/s] of a clock whose drift walks by ``drift`` [m/s/√s]."""
    n = seconds * HZ
    rng = np.random.default_rng(seed)
    t = np.arange(n) / HZ
    rate = 50.0 + ramp * t + drift / math.sqrt(HZ) * np.cumsum(rng.normal(size=n))
    return t, np.cumsum(rate) / HZ, rate + 0.03 * rng.normal(size=n)


def learned(t: F64, readings: F64, rates: F64, learner: F64 | None = None) -> F64:
    """(3,) what is learned, as standard deviations: m/√s, m/s/√s, m/s²."""
    s = new_learner(CONFIG) if learner is None else learner
    for one in zip(t, readings, rates, strict=True):
        learn_clock(s, *one)
    asked = (CONFIG.clock_walk_m_rts, CONFIG.clock_drift_walk_mps_rts, CONFIG.clock_ramp_mps2)
    return np.asarray(np.sqrt(s[SCALE : SCALE + Q_SIZE]) * asked)


@pytest.mark.parametrize("drift", [0.01, 0.1, 1.0])
def test_drift_is_found_from_a_minute_on_within_a_factor_of_two(drift: float) -> None:
    for seed in range(5):
        found = learned(*clock(100, seed, drift=drift))[Q_DRIFT]
        # Sixteen independent samples of the longest intervals that tell; 3σ of √(χ²/ν).
        assert 0.5 * drift < found < 2.0 * drift


def test_a_steady_ramp_is_not_taken_for_noise() -> None:
    flat, steep = (learned(*clock(300, 1, drift=0.02, ramp=ramp)) for ramp in (0.0, 0.5))
    np.testing.assert_allclose(steep, flat, rtol=1e-3)
    assert steep[Q_RAMP] < 0.1 * CONFIG.clock_ramp_mps2


def test_as_configured_until_half_a_minute_was_seen() -> None:
    s = new_learner(CONFIG)
    t, readings, rates = clock(30, 2, drift=0.01)
    learned(t, readings, rates, s)
    assert (s[SCALE : SCALE + Q_SIZE] == 1.0).all()


def test_without_rates_it_is_learned_from_the_clock_itself() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(1500.0)
    readings = 1e3 + 50.0 * t + np.cumsum(0.3 * rng.normal(size=1500)) + rng.normal(size=1500)
    found = learned(t, readings, np.full(1500, NAN))
    assert 0.3 < found[Q_BIAS] < 1.0  # white noise of 1 m is not told from it entirely
    # Nothing drifted: at 256 s, half of 0.3 √(6/T) could have been.
    assert found[Q_DRIFT] < 0.1 * CONFIG.clock_drift_walk_mps_rts


def test_gaps_and_jumps_are_no_noise() -> None:
    t, readings, rates = clock(400, 5, drift=0.02)
    whole = learned(t, readings, rates)
    keep = (t < 150.0) | (t > 153.0)
    s = new_learner(CONFIG)
    for at, reading, rate in zip(t[keep], readings[keep], rates[keep], strict=True):
        if abs(at - 250.0) < 0.5 / HZ:
            interrupt(s)
        wrong = 300.0 if abs(at - 330.0) < 0.5 / HZ else 0.0
        learn_clock(s, at, reading, rate + wrong + (1e3 if at >= 250.0 else 0.0))
    found = np.sqrt(s[SCALE + Q_DRIFT]) * CONFIG.clock_drift_walk_mps_rts
    assert 0.5 * whole[Q_DRIFT] < found < 2.0 * whole[Q_DRIFT]


@pytest.mark.parametrize("noisier", [10.0, 100.0])
def test_a_clock_that_is_picked_up_is_no_longer_trusted_and_learned_anew(noisier: float) -> None:
    s = new_learner(CONFIG)
    t, readings, rates = clock(1800, 6, drift=0.01)
    assert learned(t, readings, rates, s)[Q_DRIFT] < 0.03
    t2, readings2, rates2 = clock(100, 7, drift=0.01 * noisier)
    t2, rates2 = t2 + 1800.0, rates2 - rates2[0] + rates[-1]
    early = t2 < 1815.0
    learned(t2[early], readings2[early], rates2[early], s)
    assert (s[SCALE : SCALE + Q_SIZE] >= 1.0).all()
    found = learned(t2[~early], readings2[~early], rates2[~early], s)
    assert 0.5 < found[Q_DRIFT] / (0.01 * noisier) < 2.0


def test_one_wrong_solution_is_no_change_of_the_clock() -> None:
    s = new_learner(CONFIG)
    t, readings, rates = clock(600, 9, drift=0.02)
    rates[300 * HZ] += 300.0
    assert learned(t, readings, rates, s)[Q_DRIFT] < 0.04
    t, readings, rates = clock(30, 10, drift=0.02)
    rates += 1000.0
    assert learned(t + 600.0, readings, rates, s)[Q_DRIFT] < 0.04


def test_it_stays_within_its_range_whatever_comes() -> None:
    rng = np.random.default_rng(8)
    t = np.arange(3000) / HZ
    still_then_wild = np.where(t < 100.0, 0.0, rng.normal(size=3000))
    for rates in (np.zeros(3000), still_then_wild, 1e4 * rng.normal(size=3000)):
        s = new_learner(CONFIG)
        learned(t, rates, rates, s)
        scale = s[SCALE : SCALE + Q_SIZE]
        assert (scale >= np.float32(LEAST**2)).all()
        assert (scale <= MOST**2).all()
        # A smoother's tape keeps single precision.
        assert (scale == scale.astype(np.float32)).all()
        assert (scale[Q_DRIFT] > 1.0) == (rates[-1] != 0.0)
