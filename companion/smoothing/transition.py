"""Φ of a recorded step and its transpose, applied by the blocks that exist.

The whole transition of a step is D Φ: strapdown error over the interval, then the Gauss-Markov
decay D of the slow states. The noise Q is laid out as in covariance.py.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.parameters import (
    ACCEL_BIAS_PSD,
    ACCEL_BIAS_TAU,
    BARO_PSD,
    CLOCK_RAMP_TAU,
    GNSS_PSD,
    GNSS_PSD_DOWN,
    GNSS_TAU,
    GYRO_BIAS_PSD,
    GYRO_BIAS_TAU,
)
from companion.estimation.receiver_clock import clock_cross_noise, clock_noise
from companion.estimation.tape import C_LET_GO, C_NOISE_A, C_NOISE_B, C_NOISE_V, F32
from companion.navigation.layout import (
    ACCEL_BIAS,
    ATT,
    DRIFT,
    GYRO_BIAS,
    L_BARO,
    L_CLOCK,
    L_GNSS,
    POS,
    RAMP,
    VEL,
)
from companion.types import F64, I64


@njit("f8(f8[:, :, ::1], i8, i8, f8[::1], i8)", cache=True)
def _row(B: F64, block: int, i: int, x: F64, at: int) -> float:
    """Row ``i`` of a block times three elements of ``x``."""
    return float(B[block, i, 0] * x[at] + B[block, i, 1] * x[at + 1] + B[block, i, 2] * x[at + 2])


@njit("f8(f8[:, :, ::1], i8, i8, f8[::1], i8)", cache=True)
def _column(B: F64, block: int, i: int, x: F64, at: int) -> float:
    """Column ``i`` of a block times three elements of ``x``."""
    return float(B[block, 0, i] * x[at] + B[block, 1, i] * x[at + 1] + B[block, 2, i] * x[at + 2])


@njit("void(f8[:, :, ::1], i8, i8, f8[::1], f8[::1])", cache=True)
def carry(B: F64, i_sa: int, i_sg: int, x: F64, y: F64) -> None:
    """``y`` (9,) ← rows p, v, φ of Φ times ``x`` (n,)."""
    for i in range(3):
        y[i] = _row(B, 0, i, x, 0) + B[1, i, i] * x[3 + i] + _row(B, 2, i, x, 6)
        y[i] += _row(B, 3, i, x, 9) + _row(B, 4, i, x, 12)
        y[3 + i] = B[8, i, 2] * x[2] + _row(B, 9, i, x, 3) + _row(B, 10, i, x, 6)
        y[3 + i] += _row(B, 11, i, x, 9) + _row(B, 12, i, x, 12)
        y[6 + i] = _row(B, 17, i, x, 3) + _row(B, 18, i, x, 6) + _row(B, 20, i, x, 12)
        if i_sa >= 0:
            y[i] += _row(B, 5, i, x, i_sa) + _row(B, 6, i, x, i_sg)
            y[3 + i] += _row(B, 13, i, x, i_sa) + _row(B, 14, i, x, i_sg)
            y[6 + i] += _row(B, 22, i, x, i_sg)


@njit("void(f8[:, :, ::1], i8, i8, f8[::1])", cache=True)
def carry_back(B: F64, i_sa: int, i_sg: int, x: F64) -> None:
    """``x`` (n,) ← Φᵀ ``x`` in place: what does not need p, v, φ as they were goes last."""
    v, a = np.empty(3), np.empty(3)
    for i in range(3):
        x[9 + i] += _column(B, 3, i, x, 0) + _column(B, 11, i, x, 3)
        x[12 + i] += _column(B, 4, i, x, 0) + _column(B, 12, i, x, 3) + _column(B, 20, i, x, 6)
        if i_sa >= 0:
            x[i_sa + i] += _column(B, 5, i, x, 0) + _column(B, 13, i, x, 3)
            x[i_sg + i] += _column(B, 6, i, x, 0) + _column(B, 14, i, x, 3)
            x[i_sg + i] += _column(B, 22, i, x, 6)
        v[i] = B[1, i, i] * x[i] + _column(B, 9, i, x, 3) + _column(B, 17, i, x, 6)
        a[i] = _column(B, 2, i, x, 0) + _column(B, 10, i, x, 3) + _column(B, 18, i, x, 6)
    p0, p1, p2 = _column(B, 0, 0, x, 0), _column(B, 0, 1, x, 0), _column(B, 0, 2, x, 0)
    x[2] = p2 + B[8, 2, 2] * x[5]
    x[0], x[1] = p0, p1
    for i in range(3):
        x[3 + i], x[6 + i] = v[i], a[i]


@njit("void(f8, i8[::1], f8[::1], f8[::1])", cache=True)
def decay_factors(T: float, lay: I64, par: F64, d: F64) -> None:
    """``d`` (n,): diagonal of D over an interval ``T`` [s]."""
    d[:] = 1.0
    for start, tau in (
        (ACCEL_BIAS, par[ACCEL_BIAS_TAU]),
        (GYRO_BIAS, par[GYRO_BIAS_TAU]),
        (lay[L_GNSS], par[GNSS_TAU]),
    ):
        if start >= 0 and tau > 0.0:
            for i in range(3):
                d[start + i] = math.exp(-T / tau)
    if lay[L_CLOCK] >= 0:
        d[lay[L_CLOCK] + RAMP] = math.exp(-T / par[CLOCK_RAMP_TAU])


@njit("void(f4[::1], f8, i8[::1], f8[::1], f8[::1], f8[::1])", cache=True)
def noise_diagonal(c: F32, T: float, lay: I64, par: F64, d: F64, q: F64) -> None:
    """``q`` (n,): diagonal of Q but for attitude, from a step's numbers, its length and D."""
    q[:] = 0.0
    accel, gyro = par[ACCEL_BIAS_PSD] * c[C_NOISE_B], par[GYRO_BIAS_PSD] * c[C_NOISE_B]
    for start, tau, psd, psd_down in (
        (ACCEL_BIAS, par[ACCEL_BIAS_TAU], accel, accel),
        (GYRO_BIAS, par[GYRO_BIAS_TAU], gyro, gyro),
        (lay[L_GNSS], par[GNSS_TAU], par[GNSS_PSD], par[GNSS_PSD_DOWN]),
    ):
        if start >= 0:
            span = 0.5 * tau * (1.0 - d[start] * d[start]) if tau > 0.0 else T
            q[start] = q[start + 1] = psd * span
            q[start + 2] = psd_down * span
    if lay[L_BARO] >= 0:
        q[lay[L_BARO]] = par[BARO_PSD] * T
    if lay[L_CLOCK] >= 0:
        clock = lay[L_CLOCK]
        clock_noise(T, float(c[C_LET_GO]), par, d[clock + RAMP], q[clock:])
    for i in range(3):
        q[POS + i] = c[C_NOISE_V] * T * T / 3.0
        q[VEL + i] = c[C_NOISE_V]


@njit("void(f4[::1], f8, i8[::1], f8[::1], f8[::1], f8[::1], f8[::1])", cache=True)
def subtract_noise(c: F32, T: float, lay: I64, par: F64, q: F64, lam: F64, x: F64) -> None:
    """``x`` ← ``x`` − Q ``lam``, Q with the terms between states."""
    cross = 0.5 * float(c[C_NOISE_V]) * T
    for i in range(x.shape[0]):
        x[i] -= q[i] * lam[i]
    at = C_NOISE_A
    for i in range(3):
        x[POS + i] -= cross * lam[VEL + i]
        x[VEL + i] -= cross * lam[POS + i]
        for j in range(i, 3):
            x[ATT + i] -= c[at] * lam[ATT + j]
            if i != j:
                x[ATT + j] -= c[at] * lam[ATT + i]
            at += 1
    b = lay[L_CLOCK]
    if b >= 0:
        cross = clock_cross_noise(T, par)
        x[b] -= cross * lam[b + DRIFT]
        x[b + DRIFT] -= cross * lam[b]


@njit("void(f4[::1], f8, i8[::1], f8[::1], f8[::1], f8[:, ::1])", cache=True)
def add_noise(c: F32, T: float, lay: I64, par: F64, q: F64, P: F64) -> None:
    """``P`` ← ``P`` + Q."""
    cross = 0.5 * float(c[C_NOISE_V]) * T
    for i in range(P.shape[0]):
        P[i, i] += q[i]
    at = C_NOISE_A
    for i in range(3):
        P[POS + i, VEL + i] += cross
        P[VEL + i, POS + i] += cross
        for j in range(i, 3):
            P[ATT + i, ATT + j] += c[at]
            if i != j:
                P[ATT + j, ATT + i] += c[at]
            at += 1
    b = lay[L_CLOCK]
    if b >= 0:
        cross = clock_cross_noise(T, par)
        P[b, b + DRIFT] += cross
        P[b + DRIFT, b] += cross
