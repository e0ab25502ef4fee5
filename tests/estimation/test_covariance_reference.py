"""Thousands of epochs of propagation and update against dense algebra in extended precision.

The reference knows nothing of blocks, scalar updates or symmetry: Φ P Φᵀ + Q and the Joseph form
in long double, whose roundings are 2000 times smaller. It starts from the same Φ and H, so what is
compared is the arithmetic of the covariance alone.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.config import Config, EngineConfig, Imu
from companion.estimation import parameters as par
from companion.estimation import update as up
from companion.estimation.recording import nothing
from companion.navigation import layout as lo
from companion.types import F64

from .states import (
    ALL,
    CORE,
    close_interval,
    covariance,
    dense,
    fly,
    random_state,
    samples,
)

Long = np.longdouble
EPOCHS = 1000
UPDATE_EVERY = 10
EPS = np.finfo(np.float64).eps

pytestmark = pytest.mark.skipif(
    np.finfo(Long).eps > EPS / 100, reason="long double is double on this machine"
)

# Feedforward: the update is linear, and P is not turned about a corrected attitude.
CONFIG = Config(
    imu=Imu(gyro_bias_tau_s=300.0, accel_bias_tau_s=100.0),
    engine=EngineConfig(correction="feedforward", gate_probability=1 - 1e-12),
)


def _slow_states(layout: lo.Layout, config: Config, T: float) -> tuple[F64, F64]:
    """Decay (n,) of the Gauss-Markov states over ``T`` and all process noise Q (n, n)."""
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
        # Rounded as process_noise.py says: the same noise goes onto a smoother's tape.
        q = float(np.float32(p[par.ACCEL_PSD] * T))
        Q[i, i] += q * T**2 / 3
        Q[i, 3 + i] = Q[3 + i, i] = q * T / 2
        Q[3 + i, 3 + i], Q[6 + i, 6 + i] = q, np.float32(p[par.GYRO_PSD] * T)
    if layout.baro >= 0:
        Q[layout.baro, layout.baro] = p[par.BARO_PSD] * T
    return decay, Q


def _joseph(P: F64, H: F64, R: F64) -> F64:
    """(I − K H) P (I − K H)ᵀ + K R Kᵀ in the precision of ``P``, one scalar after the other."""
    eye = np.eye(len(P), dtype=Long)
    for h, r in zip(H.astype(Long), R.astype(Long), strict=True):
        K = P @ h / (h @ P @ h + r)
        A = eye - np.outer(K, h)
        P = A @ P @ A.T + np.outer(K, K) * r
    return P


def _sizes(layout: lo.Layout, sd: tuple[float, float, float, float, float]) -> F64:
    """(n,) standard deviations: the five of the core given, one for the rest."""
    size = np.full(layout.n, 1e-2)
    size[:15] = np.repeat(sd, 3)
    return size


START = {
    # lost: 10 km, 100 m/s, heading anywhere, biases of a bad sensor
    "lost": (1e4, 1e2, 1.0, 1.0, 0.05),
    # a navigation-grade unit at rest on a surveyed mark
    "surveyed": (1e-3, 1e-4, 1e-6, 1e-6, 1e-9),
    # known where, hardly anything else
    "uneven": (1e-3, 1e2, 1e-6, 1.0, 1e-9),
}


@pytest.mark.parametrize("sd_measured", [1e-3, 10.0], ids=["millimetres", "metres"])
@pytest.mark.parametrize("start", START)
@pytest.mark.parametrize(
    "layout", [CORE, pytest.param(ALL, marks=pytest.mark.slow)], ids=["core", "all"]
)
def test_covariance_stays_with_extended_precision(
    layout: lo.Layout, start: str, sd_measured: float
) -> None:
    rng = np.random.default_rng(7)
    s = random_state(rng, layout)
    n = layout.n
    P = covariance(s, layout)
    size = _sizes(layout, START[start])
    root = size[:, None] * (np.eye(n) + 0.2 * rng.standard_normal((n, n)) / np.sqrt(n))
    P[:] = root @ root.T
    P[:] = 0.5 * (P + P.T)
    exact = P.astype(Long)
    imu = samples(rng, EPOCHS + 1)
    imu[:, :3] *= 0.1
    lay, p, ip = layout.vector(), par.parameter_vector(CONFIG), par.integer_vector(CONFIG)
    H, W, report = np.zeros((3, n)), np.empty((9 + n, n)), np.zeros(up.REPORT_SIZE)
    tape = nothing(np.zeros(lo.INT_SIZE, np.int64))
    worst, cancelled = 0.0, 1.0
    for epoch in range(EPOCHS):
        fly(s, imu[epoch : epoch + 2], 0.02)
        decay, Q = _slow_states(layout, CONFIG, s[lo.SUM_T])
        F = (decay[:, None] * dense(s, layout)).astype(Long)
        exact = F @ exact @ F.T + Q.astype(Long)
        assert close_interval(s, layout, CONFIG)
        if epoch % UPDATE_EVERY == 0:
            H[:] = 0.0
            H[range(3), range(3)] = 1.0
            if layout.gnss >= 0:
                H[range(3), range(layout.gnss, layout.gnss + 3)] = 1.0
            R = np.full(3, sd_measured**2)
            cancelled = max(cancelled, float(np.max(np.diag(P)[:3] / R)))
            assert up.fuse(s, lay, p, ip, 0, 0, 0.0, H, np.zeros(3), R.copy(), 3, W, report, tape)
            exact = _joseph(exact, H, R)
        if epoch % 50 == 0 or epoch < 20:
            sd = np.sqrt(np.diag(exact).astype(np.float64))
            off = np.abs((P - exact).astype(np.float64)) / np.outer(sd, sd)
            worst = max(worst, float(off.max()))
            assert np.array_equal(P, P.T)
            assert np.linalg.eigvalsh(P / np.outer(sd, sd)).min() > 0
    print(f"worst {worst:.1e} of the standard deviations' product; cancelled {cancelled:.0e}")
    # An update that lowers a variance by a factor c leaves c roundings of what it was; a hundred
    # for the sums of n products and for the epochs that follow before it is forgotten. Propagation
    # adds a rounding an epoch, all of one sign at worst.
    assert worst < EPS * (100 * cancelled + EPOCHS)
