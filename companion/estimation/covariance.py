"""Covariance propagation over one interval, by the 3×3 blocks of Φ that are not zero.

    P ← Φ P Φᵀ + Q

The inertial sums of the interval (see mechanisation.py) make Φ exact to second order, so the
interval may span several samples. Nothing here multiplies by a zero block: 92 of 225 coefficients
of Φ are walked for fifteen states.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from companion.estimation.parameters import (
    ACCEL_BIAS_PSD,
    ACCEL_BIAS_TAU,
    ACCEL_PSD,
    BARO_PSD,
    GNSS_PSD,
    GNSS_PSD_DOWN,
    GNSS_TAU,
    GYRO_BIAS_PSD,
    GYRO_BIAS_TAU,
    GYRO_PSD,
    VIBRATION_GAIN,
)
from companion.navigation.error_model import COLUMNS, transition_blocks
from companion.navigation.layout import (
    ACCEL_BIAS,
    ACCEL_BIAS_B,
    ATT,
    BARO_BIAS,
    DX,
    GNSS_BIAS,
    GYRO_BIAS,
    GYRO_BIAS_B,
    L_ACCEL_SCALE,
    L_BARO,
    L_GNSS,
    L_GYRO_SCALE,
    L_N,
    POS,
    SUM_T,
    SUM_XA,
    SUM_XV,
    VEL,
    VIBRATION,
)
from companion.navigation.layout import P as P_OFFSET
from companion.types import F64, I64

USED = np.array(
    [[1, 1, 1, 1, 1, 1, 1, 0], [1, 1, 1, 1, 1, 1, 1, 0], [0, 1, 1, 0, 1, 0, 1, 0]], np.int64
)
"""Which blocks of Φ's rows p, v, φ exist."""


@njit("void(i8[::1], i8[::1])", cache=True)
def _column_offsets(lay: I64, off: I64) -> None:
    """Error-state index of each block column; −1 where the layout has none."""
    off[0], off[1], off[2], off[3], off[4] = POS, VEL, ATT, ACCEL_BIAS, GYRO_BIAS
    off[5], off[6], off[7] = lay[L_ACCEL_SCALE], lay[L_GYRO_SCALE], -1


@njit("void(f8[::1], i8[::1], f8[::1])", cache=True)
def _decay_and_noise(s: F64, lay: I64, par: F64) -> None:
    """Gauss-Markov decay of the slow states, in state and covariance, and all process noise."""
    n = lay[L_N]
    P = s[P_OFFSET : P_OFFSET + n * n].reshape((n, n))
    T = s[SUM_T]
    for start, tau, psd, psd_down, nominal in (
        (ACCEL_BIAS, par[ACCEL_BIAS_TAU], par[ACCEL_BIAS_PSD], par[ACCEL_BIAS_PSD], ACCEL_BIAS_B),
        (GYRO_BIAS, par[GYRO_BIAS_TAU], par[GYRO_BIAS_PSD], par[GYRO_BIAS_PSD], GYRO_BIAS_B),
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
    # Vibration is rectified and aliased by every accelerometer, in proportion to its strength.
    qv = (par[ACCEL_PSD] + par[VIBRATION_GAIN] * s[VIBRATION]) * T + s[SUM_XV]
    qa = par[GYRO_PSD] * T + s[SUM_XA]
    for i in range(3):
        P[POS + i, POS + i] += qv * T * T / 3.0
        P[POS + i, VEL + i] += 0.5 * qv * T
        P[VEL + i, POS + i] += 0.5 * qv * T
        P[VEL + i, VEL + i] += qv
        P[ATT + i, ATT + i] += qa


@njit("b1(f8[::1], i8[::1], f8[::1], f8[:, :, ::1], f8[:, ::1])", cache=True)
def propagate(s: F64, lay: I64, par: F64, B: F64, W: F64) -> bool:
    """Close the running interval: P ← Φ P Φᵀ + Q in ``s``, and clear the sums.

    ``B`` (24, 3, 3) and ``W`` (2 n, n) are scratch. False when the state or a variance is no longer
    finite and positive. In feedforward mode the carried error moves on by the same Φ.
    """
    T = s[SUM_T]
    if T <= 0.0:
        return True
    n = lay[L_N]
    P = s[P_OFFSET : P_OFFSET + n * n].reshape((n, n))
    off = np.empty(8, np.int64)
    _column_offsets(lay, off)
    transition_blocks(s, B)
    A = W[:9]
    At = W[9 : 9 + n]
    A[:, :] = 0.0
    for r in range(3):
        for c in range(7):
            if USED[r, c] == 0 or off[c] < 0:
                continue
            b = B[COLUMNS * r + c]
            for i in range(3):
                for k in range(3):
                    x = b[i, k]
                    if x != 0.0:
                        row = off[c] + k
                        for j in range(n):
                            A[3 * r + i, j] += x * P[row, j]
    for i in range(9):
        for j in range(n):
            At[j, i] = A[i, j]
    for i in range(9):
        for j in range(9, n):
            P[i, j] = A[i, j]
            P[j, i] = A[i, j]
        for j in range(9):
            P[i, j] = 0.0
    for r in range(3):
        for c in range(7):
            if USED[r, c] == 0 or off[c] < 0:
                continue
            b = B[COLUMNS * r + c]
            for i in range(3):
                for k in range(3):
                    x = b[i, k]
                    if x != 0.0:
                        row = off[c] + k
                        for j in range(9):
                            P[3 * r + i, j] += x * At[row, j]
    # Both halves were summed in different orders: one of them is kept, so P is symmetric to the bit.
    for i in range(9):
        for j in range(i):
            P[i, j] = P[j, i]
    dx = A[0]
    for i in range(9):
        dx[i] = 0.0
    for r in range(3):
        for c in range(7):
            if USED[r, c] == 1 and off[c] >= 0:
                for i in range(3):
                    for k in range(3):
                        dx[3 * r + i] += B[COLUMNS * r + c, i, k] * s[DX + off[c] + k]
    for i in range(9):
        s[DX + i] = dx[i]
    _decay_and_noise(s, lay, par)
    for i in range(SUM_T, SUM_XA + 1):
        s[i] = 0.0
    healthy = True
    for i in range(n):
        if not (P[i, i] >= 0.0 and P[i, i] < 1e30):
            healthy = False
    for i in range(DX + n):
        if not abs(s[i]) < 1e30:
            healthy = False
    return healthy
