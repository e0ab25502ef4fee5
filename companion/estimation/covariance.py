"""Covariance propagation over one interval, by the 3×3 blocks of Φ that are not zero.

    P ← Φ P Φᵀ + Q

The inertial sums of the interval (see mechanisation.py) make Φ exact to second order, so the
interval may span several samples. Nothing here multiplies by a zero block, 92 of 225 coefficients
of Φ are walked for fifteen states, and of Φ P Φᵀ only the lower half is worked out.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
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
from companion.estimation.process_noise import attitude_noise, bias_noise, velocity_noise
from companion.estimation.receiver_clock import step_clock
from companion.navigation.error_model import core_blocks, scale_blocks
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
    SUM_T,
    SUM_XC,
    VEL,
)
from companion.navigation.layout import P as P_OFFSET
from companion.types import F64, I64

STRIDE = (MAX_STATES + 7) // 8 * 8
"""Columns of the scratch that covariances are worked on in."""


@njit("void(f8[:, :, ::1], i8, i8, f8[::1], i8, f8[::1])", cache=True, counted=False)
def _apply(B: F64, i_sa: int, i_sg: int, X: F64, cols: int, Y: F64) -> None:
    """Rows p, v, φ of Φ times the first ``cols`` columns of ``X``, into ``Y``.

    Both are flat with rows of :data:`STRIDE`: with distances that it knows, the compiler makes
    vector code of the loop, once for all nine rows. Coefficients are in locals for the same reason.
    What the biases do to position, velocity and attitude is one product each: by the way it comes
    about, p ← b_a is T/2 of v ← b_a, p ← b_g is T/3 of v ← b_g, and φ ← b_g is v ← b_a.
    """
    T = B[1, 0, 0]
    half, third = 0.5 * T, T / 3.0
    pa, pb, pc = B[0, 0, 0], B[0, 0, 2], B[0, 1, 0]
    pd, pe = B[0, 1, 1], B[0, 1, 2]
    px, py, pz = B[2, 1, 2], B[2, 2, 0], B[2, 0, 1]
    g = B[8, 2, 2]
    va, vb, vc = B[9, 0, 0], B[9, 0, 1], B[9, 0, 2]
    vd, ve, vf = B[9, 1, 0], B[9, 1, 1], B[9, 1, 2]
    vg, vh = B[9, 2, 0], B[9, 2, 1]
    vx, vy, vz = B[10, 1, 2], B[10, 2, 0], B[10, 0, 1]
    c0, c1, c2 = B[11, 0, 0], B[11, 0, 1], B[11, 0, 2]
    c3, c4, c5 = B[11, 1, 0], B[11, 1, 1], B[11, 1, 2]
    c6, c7, c8 = B[11, 2, 0], B[11, 2, 1], B[11, 2, 2]
    d0, d1, d2 = B[12, 0, 0], B[12, 0, 1], B[12, 0, 2]
    d3, d4, d5 = B[12, 1, 0], B[12, 1, 1], B[12, 1, 2]
    d6, d7, d8 = B[12, 2, 0], B[12, 2, 1], B[12, 2, 2]
    ha, hb, hc = B[17, 0, 1], B[17, 1, 0], B[17, 2, 1]
    wx, wy, wz = B[18, 1, 2], B[18, 2, 0], B[18, 0, 1]
    for j in range(cols):
        v0, v1, v2 = X[3 * STRIDE + j], X[4 * STRIDE + j], X[5 * STRIDE + j]
        a0, a1, a2 = X[6 * STRIDE + j], X[7 * STRIDE + j], X[8 * STRIDE + j]
        b0, b1, b2 = X[9 * STRIDE + j], X[10 * STRIDE + j], X[11 * STRIDE + j]
        u0 = c0 * b0 + c1 * b1 + c2 * b2
        u1 = c3 * b0 + c4 * b1 + c5 * b2
        u2 = c6 * b0 + c7 * b1 + c8 * b2
        b0, b1, b2 = X[12 * STRIDE + j], X[13 * STRIDE + j], X[14 * STRIDE + j]
        t0 = d0 * b0 + d1 * b1 + d2 * b2
        t1 = d3 * b0 + d4 * b1 + d5 * b2
        t2 = d6 * b0 + d7 * b1 + d8 * b2
        p0, p1, p2 = X[j], X[STRIDE + j], X[2 * STRIDE + j]
        Y[j] = (pa * p0 + pb * p2 + T * v0) + (pz * a1 - py * a2) + (half * u0 + third * t0)
        Y[STRIDE + j] = (
            (pc * p0 + pd * p1 + pe * p2 + T * v1) + (px * a2 - pz * a0) + (half * u1 + third * t1)
        )
        Y[2 * STRIDE + j] = (p2 + T * v2) + (py * a0 - px * a1) + (half * u2 + third * t2)
        Y[3 * STRIDE + j] = (va * v0 + vb * v1 + vc * v2) + (vz * a1 - vy * a2) + (u0 + t0)
        Y[4 * STRIDE + j] = (vd * v0 + ve * v1 + vf * v2) + (vx * a2 - vz * a0) + (u1 + t1)
        Y[5 * STRIDE + j] = (g * p2 + vg * v0 + vh * v1 + v2) + (vy * a0 - vx * a1) + (u2 + t2)
        Y[6 * STRIDE + j] = (a0 + wz * a1 - wy * a2 + ha * v1) + (c0 * b0 + c1 * b1 + c2 * b2)
        Y[7 * STRIDE + j] = (a1 + wx * a2 - wz * a0 + hb * v0) + (c3 * b0 + c4 * b1 + c5 * b2)
        Y[8 * STRIDE + j] = (a2 + wy * a0 - wx * a1 + hc * v1) + (c6 * b0 + c7 * b1 + c8 * b2)
    for at, row, block in (
        (i_sa, 0, 5),
        (i_sa, 3, 13),
        (i_sg, 0, 6),
        (i_sg, 3, 14),
        (i_sg, 6, 22),
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
    _apply(B, i_sa, i_sg, flat, cols, flat[n * STRIDE :])
    for i in range(9):
        for j in range(cols):
            Y[i, j] = W[n + i, j]


@njit("f8(f8[::1], f8[:, ::1], i8, i8, f8)", cache=True, counted=False)
def _decay(s: F64, P: F64, start: int, nominal: int, tau: float) -> float:
    """Gauss-Markov decay of three slow states, in state and covariance.

    Returns the time [s] over which their driving noise is to be counted.
    """
    n = P.shape[0]
    d = math.exp(-s[SUM_T] / tau)
    for i in range(start, start + 3):
        s[nominal + i - start] *= d
        s[DX + i] *= d
        for j in range(n):
            P[i, j] *= d
        for j in range(n):
            P[j, i] *= d
    return 0.5 * tau * (1.0 - d * d)


@njit("void(f8[::1], f8[:, ::1], i8[::1], f8[::1], f8[::1])", cache=True, counted=False)
def _decay_and_noise(s: F64, P: F64, lay: I64, par: F64, q: F64) -> None:
    """Decay of the slow states, and all process noise; ``q`` (≥ 6,) is scratch."""
    T = s[SUM_T]
    accel = gyro = T
    if par[ACCEL_BIAS_TAU] > 0.0:
        accel = _decay(s, P, ACCEL_BIAS, ACCEL_BIAS_B, par[ACCEL_BIAS_TAU])
    if par[GYRO_BIAS_TAU] > 0.0:
        gyro = _decay(s, P, GYRO_BIAS, GYRO_BIAS_B, par[GYRO_BIAS_TAU])
    factor = bias_noise(s)
    for i in range(3):
        P[ACCEL_BIAS + i, ACCEL_BIAS + i] += par[ACCEL_BIAS_PSD] * factor * accel
        P[GYRO_BIAS + i, GYRO_BIAS + i] += par[GYRO_BIAS_PSD] * factor * gyro
    if lay[L_GNSS] >= 0:
        at = lay[L_GNSS]
        span = _decay(s, P, at, GNSS_BIAS, par[GNSS_TAU])
        P[at, at] += par[GNSS_PSD] * span
        P[at + 1, at + 1] += par[GNSS_PSD] * span
        P[at + 2, at + 2] += par[GNSS_PSD_DOWN] * span
    if lay[L_BARO] >= 0:
        P[lay[L_BARO], lay[L_BARO]] += par[BARO_PSD] * T
    step_clock(s, lay, par, T, q)
    qv = velocity_noise(s, par)
    attitude_noise(s, par, q)
    at = 0
    for i in range(3):
        P[POS + i, POS + i] += qv * T * T / 3.0
        P[POS + i, VEL + i] += 0.5 * qv * T
        P[VEL + i, POS + i] += 0.5 * qv * T
        P[VEL + i, VEL + i] += qv
        for j in range(i, 3):
            P[ATT + i, ATT + j] += q[at]
            if i != j:
                P[ATT + j, ATT + i] += q[at]
            at += 1


@njit("b1(f8[::1], i8[::1], f8[::1], f8[:, :, ::1], f8[:, ::1])", cache=True, counted=False)
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
    core_blocks(s, B)
    if i_sa >= 0 or i_sg >= 0:
        scale_blocks(s, B)
    X, Y = W[:n], W[n : n + 9]
    for i in range(n):
        for j in range(n):
            X[i, j] = P[i, j]
    # Whole vectors of four: what is in the columns behind is never looked at.
    wide = (n + 3) // 4 * 4
    _apply(B, i_sa, i_sg, W[:n].reshape(-1), wide, W[n:].reshape(-1))
    for i in range(9):
        for j in range(9, n):
            P[i, j] = Y[i, j]
            P[j, i] = Y[i, j]
    # Φ (Φ P)ᵀ, the lower half of it, with the carried error in the first column.
    for k in range(n):
        X[k, 0] = s[DX + k]
        for j in range(9):
            X[k, 1 + j] = Y[j, k]
    _apply(B, i_sa, i_sg, W[:n].reshape(-1), 12, W[n:].reshape(-1))
    for i in range(9):
        s[DX + i] = Y[i, 0]
        for j in range(i + 1):
            P[i, j] = Y[i, 1 + j]
            P[j, i] = Y[i, 1 + j]
    _decay_and_noise(s, P, lay, par, W[0])
    for i in range(SUM_T, SUM_XC + 1):
        s[i] = 0.0
    # Counted, not asked one by one: the compiler makes vector code of it.
    broken = 0
    for i in range(LAST_GYRO):
        broken += 0 if abs(s[i]) < 1e30 else 1
    for i in range(n):
        broken += 0 if abs(s[DX + i]) < 1e30 else 1
    for i in range(n):
        broken += 0 if 0.0 <= P[i, i] < 1e30 else 1
    return broken == 0
