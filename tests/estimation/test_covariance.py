"""Φ against central differences of the strapdown kernel; P ← Φ P Φᵀ + Q against dense algebra."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.config import Config, Imu
from companion.estimation import parameters as par
from companion.navigation import layout as lo
from companion.navigation.error_model import box_plus
from companion.navigation.mechanisation import advance
from companion.types import F64

from .states import (
    ALL,
    CORE,
    box_minus,
    close_interval,
    covariance,
    dense,
    fly,
    random_state,
    samples,
)

USED = np.array([[1, 1, 1, 1, 1, 1, 1], [1, 1, 1, 1, 1, 1, 1], [0, 1, 1, 0, 1, 0, 1]], dtype=bool)
"""Which blocks of the rows p, v, φ exist."""
STEP = np.repeat([10.0, 1e-2, 1e-4, 1e-3, 1e-4], 3)
"""Half width of the differences: far above rounding, far below any curvature."""


def _numeric(s: F64, imu: F64, dt: float, layout: lo.Layout, integral: bool) -> F64:
    """∂ end / ∂ start (n, n) of the strapdown kernel by central differences through ⊞."""
    n, lay = layout.n, layout.vector()
    step = np.full(n, 1e-3)
    step[:15] = STEP
    out = np.empty((n, n))
    for j in range(n):
        dx = np.zeros(n)
        dx[j] = step[j]
        plus, minus = s.copy(), s.copy()
        box_plus(plus, lay, dx)
        box_plus(minus, lay, -dx)
        fly(plus, imu, dt, integral)
        fly(minus, imu, dt, integral)
        out[:, j] = box_minus(plus, minus, layout) / (2 * step[j])
    return out


@pytest.mark.parametrize("integral", [False, True], ids=["instants", "integrals"])
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("steps", "dt"), [(1, 0.005), (4, 0.005), (2, 0.01), (20, 0.001)])
def test_transition_is_the_derivative_of_the_mechanisation(
    seed: int, steps: int, dt: float, integral: bool
) -> None:
    """All states, the columns of the scale factors with them."""
    rng = np.random.default_rng(seed)
    s = random_state(rng, ALL)
    imu = samples(rng, steps + 1)
    end = s.copy()
    fly(end, imu, dt, integral)
    phi = dense(end, ALL)
    numeric = _numeric(s, imu, dt, ALL, integral)
    T = steps * dt
    w, f = (np.abs(part).sum(axis=1).max() for part in (imu[:, :3], imu[:, 3:]))
    # Attitude within a step is taken at its start, ½ ω dt off; what Φ keeps of order T² through
    # attitude errs by ω T of it; position paths are cut after their leading order. A scale factor
    # works as a bias of that part of the force or rate.
    tolerance = np.full((ALL.n, ALL.n), 1e-7)
    for accel, gyro, by_f, by_w in (
        (9, 12, 1.0, 1.0),
        (ALL.accel_scale, ALL.gyro_scale, f, w),
    ):
        a, g = slice(accel, accel + 3), slice(gyro, gyro + 3)
        tolerance[6:9, g] += by_w * 0.6 * w * dt * T
        tolerance[3:6, a] += by_f * 0.6 * w * dt * T
        tolerance[3:6, g] += by_w * f * T * T * (0.6 * w * T + 0.6 * dt / T)
        tolerance[0:3, a] += by_f * (0.6 * w * T * T * T + 0.6 * w * dt * T * T)
        tolerance[0:3, g] += by_w * f * T**3
    # ∫∫f of the kernel and transport during the interval: rates of 1e-4 rad/s.
    tolerance[0:6, 6:9] += 1e-4 * f * T * T + f * dt * dt
    tolerance[0:3, 3:6] += 1e-4 * T
    # Each step rounds the last bit of a longitude of 3 rad, 3 nm, in both runs.
    step = np.full(ALL.n, 1e-3)
    step[:15] = STEP
    tolerance[0:3] += (1 + steps) * 3e-9 / step
    assert np.all(np.abs(phi - numeric) < tolerance), np.abs(phi - numeric).max(axis=1)


def test_a_scale_factor_multiplies_what_was_measured() -> None:
    """Biases included: the columns are those of the bias times the measured force and rate."""
    s = random_state(np.random.default_rng(3), ALL)
    s[lo.ACCEL_BIAS_B : lo.ACCEL_BIAS_B + 3] = 0.5
    s[lo.GYRO_BIAS_B : lo.GYRO_BIAS_B + 3] = 0.05
    sample = np.array([0.3, -0.2, 0.1, 1.0, -2.0, -9.8])
    fly(s, np.tile(sample, (2, 1)), 0.005)
    phi = dense(s, ALL)
    force = phi[3:6, ALL.accel_scale : ALL.accel_scale + 3]
    rates = phi[6:9, ALL.gyro_scale : ALL.gyro_scale + 3]
    assert np.allclose(force, phi[3:6, 9:12] * sample[3:], rtol=1e-12)
    assert np.allclose(rates, phi[6:9, 12:15] * sample[:3], rtol=1e-12)


def test_gyro_bias_and_tilt_signs() -> None:
    """A positive accelerometer bias left in makes the estimate too fast: δv = v_true − v falls."""
    s = random_state(np.random.default_rng(0), CORE)
    s[:4] = [1, 0, 0, 0]
    fly(s, np.tile([0, 0, 0, 0, 0, -9.8], (5, 1)).astype(float), 0.005)
    phi = dense(s, CORE)
    assert phi[3, 9] == pytest.approx(-0.02, rel=1e-3)
    assert phi[8, 14] == pytest.approx(-0.02, rel=1e-3)
    # Nose truly higher than estimated (φ_E > 0): the force leans back, so δv_N grows negative.
    assert phi[3, 7] == pytest.approx(-9.8 * 0.02, rel=1e-2)


@pytest.mark.parametrize("layout", [CORE, ALL], ids=["core", "all"])
@pytest.mark.parametrize("seed", range(4))
def test_propagation_equals_dense_algebra(layout: lo.Layout, seed: int) -> None:
    rng = np.random.default_rng(seed)
    imu = Imu(gyro_bias_tau_s=50.0, accel_bias_tau_s=20.0, gyro_vibration_gain_rthz=0.03)
    config = Config(imu=imu)
    s = random_state(rng, layout)
    s[lo.VIBRATION] = 0.4
    s[lo.GYRO_VIBRATION : lo.GYRO_VIBRATION + 3] = shaken = rng.uniform(0.0, 0.02, 3)
    fly(s, samples(rng, 5), 0.005)
    C = s[lo.SUM_C : lo.SUM_C + 9].reshape(3, 3) / s[lo.SUM_T]
    s[lo.DX : lo.DX + layout.n] = dx = rng.standard_normal(layout.n)
    before, phi, T = covariance(s, layout).copy(), dense(s, layout), s[lo.SUM_T]
    p = par.parameter_vector(config)
    taus = [(9, p[par.ACCEL_BIAS_TAU], p[par.ACCEL_BIAS_PSD], p[par.ACCEL_BIAS_PSD])]
    taus.append((12, p[par.GYRO_BIAS_TAU], p[par.GYRO_BIAS_PSD], p[par.GYRO_BIAS_PSD]))
    if layout.gnss >= 0:
        taus.append((layout.gnss, p[par.GNSS_TAU], p[par.GNSS_PSD], p[par.GNSS_PSD_DOWN]))
    decay, Q = np.ones(layout.n), np.zeros((layout.n, layout.n))
    for at, tau, psd, down in taus:
        d = math.exp(-T / tau)
        decay[at : at + 3] = d
        Q[range(at, at + 3), range(at, at + 3)] = np.array([psd, psd, down]) * tau / 2 * (1 - d * d)
    for i in range(3):
        q = p[par.ACCEL_PSD] + p[par.VIBRATION_GAIN] * s[lo.VIBRATION]
        Q[i, i] += q * T**3 / 3
        Q[i, 3 + i] = Q[3 + i, i] = q * T**2 / 2
        Q[3 + i, 3 + i], Q[6 + i, 6 + i] = q * T, p[par.GYRO_PSD] * T
    Q[6:9, 6:9] += 0.03**2 * T * (C * shaken) @ C.T
    if layout.baro >= 0:
        Q[layout.baro, layout.baro] = p[par.BARO_PSD] * T
    full = np.diag(decay) @ phi
    assert close_interval(s, layout, config)
    after = covariance(s, layout)
    assert np.array_equal(after, after.T)
    expected = full @ before @ full.T + Q
    sd = np.sqrt(np.diag(expected))
    # The inertial noise is rounded to single precision, 24 bits; all else is double.
    allowed = 1e-13 * np.outer(sd, sd) + 2.0**-24 * np.abs(Q)
    assert np.all(np.abs(after - expected) < allowed)
    assert np.linalg.eigvalsh(after / np.outer(sd, sd)).min() > 0
    assert np.allclose(s[lo.DX : lo.DX + layout.n], full @ dx, rtol=1e-12, atol=1e-14)


def test_fifty_hertz_agrees_with_every_sample() -> None:
    rng = np.random.default_rng(8)
    start = random_state(rng, CORE)
    imu = samples(rng, 2001)
    C = np.empty((3, 3))
    ends = []
    for every in (1, 4):
        s = start.copy()
        for i in range(2000):
            advance(s, imu[i], imu[i + 1], 0.005, False, True, C)
            if (i + 1) % every == 0:
                assert close_interval(s, CORE, Config())
        ends.append(covariance(s, CORE).copy())
    sd = np.sqrt(np.diag(ends[0]))
    # The contract of transition_blocks says 1e-4 an interval; 500 intervals of mixed sign here.
    assert np.max(np.abs(ends[1] - ends[0]) / np.outer(sd, sd)) < 5e-3


def test_biases_forget_with_their_time_constant() -> None:
    s = random_state(np.random.default_rng(1), CORE)
    bias = s[lo.GYRO_BIAS_B : lo.GYRO_BIAS_B + 3].copy()
    config = Config(imu=Imu(gyro_bias_tau_s=10.0))
    for _ in range(1000):
        s[lo.SUM_T] = 0.02
        close_interval(s, CORE, config)
    assert np.allclose(s[lo.GYRO_BIAS_B : lo.GYRO_BIAS_B + 3], bias * math.exp(-2.0), rtol=1e-12)
    p = par.parameter_vector(config)
    stationary = p[par.GYRO_BIAS_PSD] * 10.0 / 2
    initial = covariance(random_state(np.random.default_rng(1), CORE), CORE)[12, 12]
    expected = initial * math.exp(-4.0) + stationary * (1 - math.exp(-4.0))
    assert covariance(s, CORE)[12, 12] == pytest.approx(expected, rel=1e-9)
