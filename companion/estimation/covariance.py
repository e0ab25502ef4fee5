"""Covariance propagation over one interval, by the 3×3 blocks of Φ that are not zero.

    P ← Φ P Φᵀ + Q

The inertial sums of the interval (see mechanisation.py) make Φ exact to second order, so the
interval may span several samples. Nothing here multiplies by a zero block, 92 of 225 coefficients
of Φ are walked for fifteen states, and of Φ P Φᵀ only the lower half is worked out.
"""

from __future__ import annotations

import math

import numpy as np
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
from companion.estimation.process_noise import attitude_noise, velocity_noise
from companion.navigation.error_model import transition_blocks
from companion.navigation.layout import (
    ACCEL_BIAS,
    ACCEL_BIAS_B,
    ATT,
    DX,
    GNSS_BIAS,
    GYRO_BIAS,
    GYRO_BIAS_B,
    L_ACCEL_SCALE,
    L_BARO,
    L_GNSS,
    L_GYRO_SCALE,
    L_N,
    LAST_GYRO,
    MAX_STATES,
    POS,
    Q_SCALE,
    SUM_T,
    SUM_XA,
    VEL,
)
from companion.navigation.layout import P as P_OFFSET
from companion.types import F64, I64

STRIDE = (MAX_STATES + 7) // 8 * 8
"""Columns of the scratch that covariances are worked on in."""


@njit("void(f8[:, :, ::1], i8, i8, f8[::1], i8, i8, i8, f8[::1])", cache=True)
def _apply(B: F64, i_sa: int, i_sg: int, X: F64, p: int, v: int, a: int, Y: F64) -> None:
    """Rows p, v, φ of Φ times the first ``p``, ``v``, ``a`` columns of ``X``, into ``Y``.

    Both are flat with rows of :data:`STRIDE`: with distances that it knows, the compiler makes
    vector code of the inner loops. Coefficients are in locals for the same reason.
    """
    for i in range(3):
        a0, a1, a2, T = B[0, i, 0], B[0, i, 1], B[0, i, 2], B[1, i, i]
        b0, b1, b2 = B[2, i, 0], B[2, i, 1], B[2, i, 2]
        c0, c1, c2 = B[3, i, 0], B[3, i, 1], B[3, i, 2]
        d0, d1, d2 = B[4, i, 0], B[4, i, 1], B[4, i, 2]
        out, own = Y[i * STRIDE :], X[(3 + i) * STRIDE :]
        for j in range(p):
            out[j] = (
                (a0 * X[j] + a1 * X[STRIDE + j] + a2 * X[2 * STRIDE + j] + T * own[j])
                + (b0 * X[6 * STRIDE + j] + b1 * X[7 * STRIDE + j] + b2 * X[8 * STRIDE + j])
                + (c0 * X[9 * STRIDE + j] + c1 * X[10 * STRIDE + j] + c2 * X[11 * STRIDE + j])
                + (d0 * X[12 * STRIDE + j] + d1 * X[13 * STRIDE + j] + d2 * X[14 * STRIDE + j])
            )
        a0, a1, a2, g = B[9, i, 0], B[9, i, 1], B[9, i, 2], B[8, i, 2]
        b0, b1, b2 = B[10, i, 0], B[10, i, 1], B[10, i, 2]
        c0, c1, c2 = B[11, i, 0], B[11, i, 1], B[11, i, 2]
        d0, d1, d2 = B[12, i, 0], B[12, i, 1], B[12, i, 2]
        out = Y[(3 + i) * STRIDE :]
        for j in range(v):
            out[j] = (
                (g * X[2 * STRIDE + j])
                + (a0 * X[3 * STRIDE + j] + a1 * X[4 * STRIDE + j] + a2 * X[5 * STRIDE + j])
                + (b0 * X[6 * STRIDE + j] + b1 * X[7 * STRIDE + j] + b2 * X[8 * STRIDE + j])
                + (c0 * X[9 * STRIDE + j] + c1 * X[10 * STRIDE + j] + c2 * X[11 * STRIDE + j])
                + (d0 * X[12 * STRIDE + j] + d1 * X[13 * STRIDE + j] + d2 * X[14 * STRIDE + j])
            )
        a0, a1, a2 = B[17, i, 0], B[17, i, 1], B[17, i, 2]
        b0, b1, b2 = B[18, i, 0], B[18, i, 1], B[18, i, 2]
        d0, d1, d2 = B[20, i, 0], B[20, i, 1], B[20, i, 2]
        out = Y[(6 + i) * STRIDE :]
        for j in range(a):
            out[j] = (
                (a0 * X[3 * STRIDE + j] + a1 * X[4 * STRIDE + j] + a2 * X[5 * STRIDE + j])
                + (b0 * X[6 * STRIDE + j] + b1 * X[7 * STRIDE + j] + b2 * X[8 * STRIDE + j])
                + (d0 * X[12 * STRIDE + j] + d1 * X[13 * STRIDE + j] + d2 * X[14 * STRIDE + j])
            )
    for at, row, block, cols in (
        (i_sa, 0, 5, p),
        (i_sa, 3, 13, v),
        (i_sg, 0, 6, p),
        (i_sg, 3, 14, v),
        (i_sg, 6, 22, a),
    ):
        if at >= 0:
            for i in range(3):
                for k in range(3):
                    c = B[block, i, k]
                    out, own = Y[(row + i) * STRIDE :], X[(at + k) * STRIDE :]
                    for j in range(cols):
                        out[j] += c * own[j]


@njit("void(f8[:, :, ::1], i8, i8, f8[:, ::1], i8, f8[:, ::1])", cache=True)
def apply_transition(B: F64, i_sa: int, i_sg: int, X: F64, cols: int, Y: F64) -> None:
    """``Y[:9]`` ← rows p, v, φ of Φ times ``X`` (n, ≥ ``cols``), by the blocks that exist.

    ``i_sa``, ``i_sg``: scale-factor states or −1. At most :data:`STRIDE` columns.
    """
    n = X.shape[0]
    W = np.empty((n + 9, STRIDE))
    for i in range(n):
        for j in range(cols):
            W[i, j] = X[i, j]
    flat = W.reshape(-1)
    _apply(B, i_sa, i_sg, flat, cols, cols, cols, flat[n * STRIDE :])
    for i in range(9):
        for j in range(cols):
            Y[i, j] = W[n + i, j]


@njit("void(f8[::1], i8[::1], f8[::1])", cache=True)
def _decay_and_noise(s: F64, lay: I64, par: F64) -> None:
    """Gauss-Markov decay of the slow states, in state and covariance, and all process noise."""
    n = lay[L_N]
    P = s[P_OFFSET : P_OFFSET + n * n].reshape((n, n))
    T = s[SUM_T]
    accel, gyro = par[ACCEL_BIAS_PSD] * s[Q_SCALE], par[GYRO_BIAS_PSD] * s[Q_SCALE]
    for start, tau, psd, psd_down, nominal in (
        (ACCEL_BIAS, par[ACCEL_BIAS_TAU], accel, accel, ACCEL_BIAS_B),
        (GYRO_BIAS, par[GYRO_BIAS_TAU], gyro, gyro, GYRO_BIAS_B),
        (lay[L_GNSS], par[GNSS_TAU], par[GNSS_PSD], par[GNSS_PSD_DOWN], GNSS_BIAS),
    ):
        if start < 0:
            continue
        d = 1.0
        q = T
        if tau > 0.0:
            d = math.exp(-T / tau)
            q = 0.5 * tau * (1.0 - d * d)
            for i in range(start, start + 3):
                s[nominal + i - start] *= d
                s[DX + i] *= d
                for j in range(n):
                    P[i, j] *= d
                for j in range(n):
                    P[j, i] *= d
        P[start, start] += psd * q
        P[start + 1, start + 1] += psd * q
        P[start + 2, start + 2] += psd_down * q
    if lay[L_BARO] >= 0:
        P[lay[L_BARO], lay[L_BARO]] += par[BARO_PSD] * T
    qv = velocity_noise(s, par)
    qa = np.empty(6)
    attitude_noise(s, par, qa)
    at = 0
    for i in range(3):
        P[POS + i, POS + i] += qv * T * T / 3.0
        P[POS + i, VEL + i] += 0.5 * qv * T
        P[VEL + i, POS + i] += 0.5 * qv * T
        P[VEL + i, VEL + i] += qv
        for j in range(i, 3):
            P[ATT + i, ATT + j] += qa[at]
            if i != j:
                P[ATT + j, ATT + i] += qa[at]
            at += 1


@njit("b1(f8[::1], i8[::1], f8[::1], f8[:, :, ::1], f8[:, ::1])", cache=True)
def propagate(s: F64, lay: I64, par: F64, B: F64, W: F64) -> bool:
    """Close the running interval: P ← Φ P Φᵀ + Q in ``s``, and clear the sums.

    ``B`` (24, 3, 3) and ``W`` (n + 9, STRIDE) are scratch. False when the state or a variance is no
    longer finite and positive. In feedforward mode the carried error moves on by the same Φ.
    """
    T = s[SUM_T]
    if T <= 0.0:
        return True
    n = lay[L_N]
    P = s[P_OFFSET : P_OFFSET + n * n].reshape((n, n))
    i_sa, i_sg = lay[L_ACCEL_SCALE], lay[L_GYRO_SCALE]
    transition_blocks(s, B)
    X, Y = W[:n], W[n : n + 9]
    for i in range(n):
        for j in range(n):
            X[i, j] = P[i, j]
    # Whole vectors of four: what is in the columns behind is never looked at.
    wide = (n + 3) // 4 * 4
    _apply(B, i_sa, i_sg, W[:n].reshape(-1), wide, wide, wide, W[n:].reshape(-1))
    for i in range(9):
        for j in range(9, n):
            P[i, j] = Y[i, j]
            P[j, i] = Y[i, j]
    # Φ (Φ P)ᵀ, the lower half of it, with the carried error in the first column.
    for k in range(n):
        X[k, 0] = s[DX + k]
        for j in range(9):
            X[k, 1 + j] = Y[j, k]
    _apply(B, i_sa, i_sg, W[:n].reshape(-1), 4, 8, 12, W[n:].reshape(-1))
    for i in range(9):
        s[DX + i] = Y[i, 0]
        for j in range(i + 1):
            P[i, j] = Y[i, 1 + j]
            P[j, i] = Y[i, 1 + j]
    _decay_and_noise(s, lay, par)
    for i in range(SUM_T, SUM_XA + 1):
        s[i] = 0.0
    healthy = True
    for i in range(n):
        healthy &= P[i, i] >= 0.0 and P[i, i] < 1e30 and abs(s[DX + i]) < 1e30
    for i in range(LAST_GYRO):
        healthy &= abs(s[i]) < 1e30
    return healthy
