"""Φ of a recorded step and of its transpose, applied by the blocks that exist.

The whole transition of a step is D Φ: strapdown error over the interval, then the Gauss-Markov
decay D of the slow states. The noise Q is laid out as in covariance.py.
"""

from __future__ import annotations

import math

from numba import njit

from companion.estimation.parameters import (
    ACCEL_BIAS_PSD,
    ACCEL_BIAS_TAU,
    BARO_PSD,
    GNSS_PSD,
    GNSS_PSD_DOWN,
    GNSS_TAU,
    GYRO_BIAS_PSD,
    GYRO_BIAS_TAU,
)
from companion.estimation.tape import C_NOISE_A, C_NOISE_V, F32
from companion.navigation.layout import (
    ACCEL_BIAS,
    ATT,
    GYRO_BIAS,
    L_BARO,
    L_GNSS,
    POS,
    VEL,
)
from companion.types import F64, I64


@njit("void(f8[:, :, ::1], i8, i8, f8[:, ::1], i8, f8[:, ::1])", cache=True)
def apply_transposed(B: F64, i_sa: int, i_sg: int, X: F64, cols: int, Y: F64) -> None:
    """``Y`` ← Φᵀ ``X`` over the first ``cols`` columns, both (n, ≥ ``cols``), ``Y`` apart from X.

    Rows of states that Φ leaves alone are copied by the caller.
    """
    for i in range(3):
        for j in range(cols):
            p0, p1, p2 = X[0, j], X[1, j], X[2, j]
            v0, v1, v2 = X[3, j], X[4, j], X[5, j]
            a0, a1, a2 = X[6, j], X[7, j], X[8, j]
            Y[i, j] = B[0, 0, i] * p0 + B[0, 1, i] * p1 + B[0, 2, i] * p2 + B[8, 2, i] * v2
            Y[3 + i, j] = (
                B[1, i, i] * X[i, j]
                + (B[9, 0, i] * v0 + B[9, 1, i] * v1 + B[9, 2, i] * v2)
                + (B[17, 0, i] * a0 + B[17, 1, i] * a1 + B[17, 2, i] * a2)
            )
            Y[6 + i, j] = (
                (B[2, 0, i] * p0 + B[2, 1, i] * p1 + B[2, 2, i] * p2)
                + (B[10, 0, i] * v0 + B[10, 1, i] * v1 + B[10, 2, i] * v2)
                + (B[18, 0, i] * a0 + B[18, 1, i] * a1 + B[18, 2, i] * a2)
            )
            Y[9 + i, j] = (
                X[9 + i, j]
                + (B[3, 0, i] * p0 + B[3, 1, i] * p1 + B[3, 2, i] * p2)
                + (B[11, 0, i] * v0 + B[11, 1, i] * v1 + B[11, 2, i] * v2)
            )
            Y[12 + i, j] = (
                X[12 + i, j]
                + (B[4, 0, i] * p0 + B[4, 1, i] * p1 + B[4, 2, i] * p2)
                + (B[12, 0, i] * v0 + B[12, 1, i] * v1 + B[12, 2, i] * v2)
                + (B[20, 0, i] * a0 + B[20, 1, i] * a1 + B[20, 2, i] * a2)
            )
    if i_sa >= 0:
        for i in range(3):
            for j in range(cols):
                Y[i_sa + i, j] = X[i_sa + i, j]
                Y[i_sg + i, j] = X[i_sg + i, j]
                for k in range(3):
                    Y[i_sa + i, j] += B[5, k, i] * X[k, j] + B[13, k, i] * X[3 + k, j]
                    Y[i_sg + i, j] += (
                        B[6, k, i] * X[k, j] + B[14, k, i] * X[3 + k, j] + B[22, k, i] * X[6 + k, j]
                    )


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


@njit("void(f4[::1], f8, i8[::1], f8[::1], f8[::1], f8[::1])", cache=True)
def noise_diagonal(c: F32, T: float, lay: I64, par: F64, d: F64, q: F64) -> None:
    """``q`` (n,): diagonal of Q but for attitude, from a step's numbers, its length and D."""
    q[:] = 0.0
    for start, tau, psd, psd_down in (
        (ACCEL_BIAS, par[ACCEL_BIAS_TAU], par[ACCEL_BIAS_PSD], par[ACCEL_BIAS_PSD]),
        (GYRO_BIAS, par[GYRO_BIAS_TAU], par[GYRO_BIAS_PSD], par[GYRO_BIAS_PSD]),
        (lay[L_GNSS], par[GNSS_TAU], par[GNSS_PSD], par[GNSS_PSD_DOWN]),
    ):
        if start >= 0:
            span = 0.5 * tau * (1.0 - d[start] * d[start]) if tau > 0.0 else T
            q[start] = q[start + 1] = psd * span
            q[start + 2] = psd_down * span
    if lay[L_BARO] >= 0:
        q[lay[L_BARO]] = par[BARO_PSD] * T
    for i in range(3):
        q[POS + i] = c[C_NOISE_V] * T * T / 3.0
        q[VEL + i] = c[C_NOISE_V]


@njit("void(f4[::1], f8, f8[::1], f8[::1], f8[::1])", cache=True)
def subtract_noise(c: F32, T: float, q: F64, lam: F64, x: F64) -> None:
    """``x`` ← ``x`` − Q ``lam``, Q with the position-velocity terms and that of attitude."""
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


@njit("void(f4[::1], f8, f8[::1], f8[:, ::1])", cache=True)
def add_noise(c: F32, T: float, q: F64, P: F64) -> None:
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
