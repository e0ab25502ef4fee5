"""Φ of a recorded step and its transpose, applied by the blocks that exist.

The whole transition of a step is D Φ: strapdown error over the interval, then the Gauss-Markov
decay D of the slow states. The noise Q is laid out as in covariance.py.
"""

from __future__ import annotations

import math

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
from companion.estimation.receiver_clock import (
    carry_clock,
    carry_clock_back,
    clock_cross_noise,
    clock_noise,
)
from companion.estimation.tape import C_CLOCK, C_LET_GO, C_NOISE_A, C_NOISE_B, C_NOISE_V, F32
from companion.navigation.layout import (
    ACCEL_BIAS,
    ATT,
    DRIFT,
    GYRO_BIAS,
    L_ACCEL_SCALE,
    L_BARO,
    L_CLOCK,
    L_GNSS,
    L_GYRO_SCALE,
    L_N,
    POS,
    RAMP,
    VEL,
)
from companion.smoothing.phi import (
    K_AA,
    K_AV,
    K_C,
    K_D,
    K_PA,
    K_PP,
    K_Q,
    K_R,
    K_S,
    K_T,
    K_VA,
    K_VP,
    K_VV,
)
from companion.types import F64, I64


@njit("f8(f8[::1], i8, i8, f8[::1], i8)", cache=True, counted=False)
def _row(K: F64, block: int, i: int, x: F64, at: int) -> float:
    """Row ``i`` of the nine coefficients from ``block`` on, times three elements of ``x``."""
    b = block + 3 * i
    return float(K[b] * x[at] + K[b + 1] * x[at + 1] + K[b + 2] * x[at + 2])


@njit("f8(f8[::1], i8, i8, f8[::1], i8)", cache=True, counted=False)
def _column(K: F64, block: int, i: int, x: F64, at: int) -> float:
    """Column ``i`` of the nine coefficients from ``block`` on, times three elements of ``x``."""
    b = block + i
    return float(K[b] * x[at] + K[b + 3] * x[at + 1] + K[b + 6] * x[at + 2])


@njit("void(f8[::1], i8[::1], f8[::1], f8[::1])", cache=True, counted=False)
def carry(K: F64, lay: I64, d: F64, x: F64) -> None:
    """``x`` (n,) ← diag(d) Φ ``x`` in place, ``K`` as phi.py has Φ."""
    n, i_sa, i_sg, clock = lay[L_N], lay[L_ACCEL_SCALE], lay[L_GYRO_SCALE], lay[L_CLOCK]
    T = K[K_T]
    half, third = 0.5 * T, T / 3.0
    p0, p1, p2 = x[0], x[1], x[2]
    v0, v1, v2 = x[3], x[4], x[5]
    a0, a1, a2 = x[6], x[7], x[8]
    px, py, pz = K[K_PA], K[K_PA + 1], K[K_PA + 2]
    x[0] = K[K_PP] * p0 + K[K_PP + 1] * p2 + T * v0 + (pz * a1 - py * a2)
    x[1] = K[K_PP + 2] * p0 + K[K_PP + 3] * p1 + K[K_PP + 4] * p2 + T * v1 + (px * a2 - pz * a0)
    x[2] = p2 + T * v2 + (py * a0 - px * a1)
    vx, vy, vz = K[K_VA], K[K_VA + 1], K[K_VA + 2]
    x[3] = K[K_VV] * v0 + K[K_VV + 1] * v1 + K[K_VV + 2] * v2 + (vz * a1 - vy * a2)
    x[4] = K[K_VV + 3] * v0 + K[K_VV + 4] * v1 + K[K_VV + 5] * v2 + (vx * a2 - vz * a0)
    x[5] = K[K_VV + 6] * v0 + K[K_VV + 7] * v1 + v2 + K[K_VP] * p2 + (vy * a0 - vx * a1)
    wx, wy, wz = K[K_AA], K[K_AA + 1], K[K_AA + 2]
    x[6] = a0 + (wz * a1 - wy * a2) + K[K_AV] * v1
    x[7] = a1 + (wx * a2 - wz * a0) + K[K_AV + 1] * v0
    x[8] = a2 + (wy * a0 - wx * a1) + K[K_AV + 2] * v1
    for i in range(3):
        u, t = _row(K, K_C, i, x, ACCEL_BIAS), _row(K, K_D, i, x, GYRO_BIAS)
        w = _row(K, K_C, i, x, GYRO_BIAS)
        if i_sa >= 0:
            u += _row(K, K_S, i, x, i_sa)
            t += _row(K, K_R, i, x, i_sg)
            w += _row(K, K_Q, i, x, i_sg)
        x[i] += half * u + third * t
        x[3 + i] += u + t
        x[6 + i] += w
    if clock >= 0:
        carry_clock(T, 1.0, x[clock:])
    for j in range(9, n):
        x[j] *= d[j]


@njit("void(f8[::1], i8[::1], f8[::1], f8[::1])", cache=True, counted=False)
def carry_back(K: F64, lay: I64, d: F64, x: F64) -> None:
    """``x`` (n,) ← Φᵀ diag(d) ``x`` in place: what does not need p, v, φ as they were goes last."""
    n, i_sa, i_sg, clock = lay[L_N], lay[L_ACCEL_SCALE], lay[L_GYRO_SCALE], lay[L_CLOCK]
    T = K[K_T]
    for j in range(9, n):
        x[j] *= d[j]
    if clock >= 0:
        carry_clock_back(T, x[clock:])
    half, third = 0.5 * T, T / 3.0
    p0, p1, p2 = x[0], x[1], x[2]
    v0, v1, v2 = x[3], x[4], x[5]
    a0, a1, a2 = x[6], x[7], x[8]
    t0, t1, t2 = v0 + half * p0, v1 + half * p1, v2 + half * p2
    u0, u1, u2 = v0 + third * p0, v1 + third * p1, v2 + third * p2
    for i in range(3):
        c0, c1, c2 = K[K_C + i], K[K_C + 3 + i], K[K_C + 6 + i]
        x[9 + i] += c0 * t0 + c1 * t1 + c2 * t2
        x[12 + i] += c0 * a0 + c1 * a1 + c2 * a2
        x[12 + i] += K[K_D + i] * u0 + K[K_D + 3 + i] * u1 + K[K_D + 6 + i] * u2
        if i_sa >= 0:
            x[i_sa + i] += K[K_S + i] * t0 + K[K_S + 3 + i] * t1 + K[K_S + 6 + i] * t2
            x[i_sg + i] += K[K_R + i] * u0 + K[K_R + 3 + i] * u1 + K[K_R + 6 + i] * u2
            x[i_sg + i] += _column(K, K_Q, i, x, 6)
    px, py, pz = K[K_PA], K[K_PA + 1], K[K_PA + 2]
    vx, vy, vz = K[K_VA], K[K_VA + 1], K[K_VA + 2]
    wx, wy, wz = K[K_AA], K[K_AA + 1], K[K_AA + 2]
    x[0] = K[K_PP] * p0 + K[K_PP + 2] * p1
    x[1] = K[K_PP + 3] * p1
    x[2] = K[K_PP + 1] * p0 + K[K_PP + 4] * p1 + p2 + K[K_VP] * v2
    x[3] = T * p0 + K[K_VV] * v0 + K[K_VV + 3] * v1 + K[K_VV + 6] * v2 + K[K_AV + 1] * a1
    x[4] = T * p1 + K[K_VV + 1] * v0 + K[K_VV + 4] * v1 + K[K_VV + 7] * v2
    x[4] += K[K_AV] * a0 + K[K_AV + 2] * a2
    x[5] = T * p2 + K[K_VV + 2] * v0 + K[K_VV + 5] * v1 + v2
    x[6] = (py * p2 - pz * p1) + (vy * v2 - vz * v1) + (a0 + wy * a2 - wz * a1)
    x[7] = (pz * p0 - px * p2) + (vz * v0 - vx * v2) + (a1 + wz * a0 - wx * a2)
    x[8] = (px * p1 - py * p0) + (vx * v1 - vy * v0) + (a2 + wx * a1 - wy * a0)


@njit("void(f8, i8[::1], f8[::1], f8[::1])", cache=True, counted=False)
def decay_factors(T: float, lay: I64, par: F64, d: F64) -> None:
    """``d`` (n,): diagonal of D over an interval ``T`` [s]."""
    d[:] = 1.0
    for start, tau in (
        (ACCEL_BIAS, par[ACCEL_BIAS_TAU]),
        (GYRO_BIAS, par[GYRO_BIAS_TAU]),
        (lay[L_GNSS], par[GNSS_TAU]),
    ):
        if start >= 0 and tau > 0.0:
            d[start] = d[start + 1] = d[start + 2] = math.exp(-T / tau)
    if lay[L_CLOCK] >= 0:
        d[lay[L_CLOCK] + RAMP] = math.exp(-T / par[CLOCK_RAMP_TAU])


@njit("void(f4[::1], f8, i8[::1], f8[::1], f8[::1], f8[::1])", cache=True, counted=False)
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
        clock_noise(
            T, float(c[C_LET_GO]), float(c[C_CLOCK]), float(c[C_CLOCK + 1]), float(c[C_CLOCK + 2]),
            par, d[clock + RAMP], q[clock:],
        )  # fmt: skip
    for i in range(3):
        q[POS + i] = c[C_NOISE_V] * T * T / 3.0
        q[VEL + i] = c[C_NOISE_V]


@njit("void(f4[::1], f8, i8[::1], f8[::1], f8[::1], f8[::1], f8[::1])", cache=True, counted=False)
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
        cross = clock_cross_noise(T, float(c[C_CLOCK + 1]), par)
        x[b] -= cross * lam[b + DRIFT]
        x[b + DRIFT] -= cross * lam[b]


@njit("void(f4[::1], f8, i8[::1], f8[::1], f8[::1], f8[:, ::1])", cache=True, counted=False)
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
        cross = clock_cross_noise(T, float(c[C_CLOCK + 1]), par)
        P[b, b + DRIFT] += cross
        P[b + DRIFT, b] += cross
