"""The tape: what a smoother needs of a forward run, written by the walk in order.

A run of records, one kind code each, with their numbers in two columns: ``coarse`` (float32) for
coefficients of which seven digits are plenty, ``fine`` (float64) for gains and innovations. Every
kind has a fixed size for a given layout, so the tape reads in both directions.

========  ==========================================================  ====================
kind      coarse                                                      fine
========  ==========================================================  ====================
STEP      sums behind Φ of one covariance interval, and its noise     –
UPDATE    H (n)                                                       K√S (n), 1/√S, y
TURN      –                                                           correction of φ (3)
ROW       upper triangle of P where covariance is wanted              –
========  ==========================================================  ====================

At 50 Hz the steps are 17 MB an hour; a scalar update is 220 bytes with sixteen states.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.estimation.parameters import ACCEL_PSD, GYRO_PSD, VIBRATION_GAIN
from companion.navigation.layout import (
    ATT,
    HEIGHT,
    L_ACCEL_SCALE,
    L_N,
    LAT,
    SUM_T,
    SUM_V,
    SUM_XA,
    SUM_XV,
    VEL_N,
    VIBRATION,
)
from companion.navigation.layout import P as P_OFFSET
from companion.types import F64, I64

F32 = NDArray[np.float32]
I8 = NDArray[np.int8]
Recorder = tuple[I8, F32, F64, I64]

STEP, UPDATE, TURN, ROW = 0, 1, 2, 3

# --- columns of a step in `coarse`
C_T, C_VEL, C_LAT, C_HEIGHT, C_NOISE_V, C_NOISE_A, C_SUMS = 0, 1, 4, 5, 6, 7, 8
SUMS = 15  # ∫f (3), ∫∫f (3), ∫C (9)
SUMS_WITH_SCALE = 33  # and ∫C diag(f) (9), ∫C diag(ω) (9)

# --- entries of a position on the tape
KIND, COARSE, FINE = 0, 1, 2

RECORDER = "Tuple((i1[::1], f4[::1], f8[::1], i8[::1]))"
"""Numba type of (kinds, coarse, fine, position), as the kernels take a tape. Empty: not recorded.

``position`` (4,) is where the next record goes, and 1 where ROW keeps P.
"""
WITH_COVARIANCE = 3


@njit(f"void({RECORDER}, f8[::1], i8[::1], f8[::1])", cache=True)
def record_step(tape: Recorder, s: F64, lay: I64, par: F64) -> None:
    """Put down the running covariance interval of ``s``, before it is closed."""
    kinds, coarse, _, at = tape
    T = s[SUM_T]
    if kinds.shape[0] == 0 or T <= 0.0:
        return
    kinds[at[KIND]] = STEP
    at[KIND] += 1
    c = coarse[at[COARSE] :]
    c[C_T], c[C_LAT], c[C_HEIGHT] = T, s[LAT], s[HEIGHT]
    for i in range(3):
        c[C_VEL + i] = s[VEL_N + i]
    c[C_NOISE_V] = (par[ACCEL_PSD] + par[VIBRATION_GAIN] * s[VIBRATION]) * T + s[SUM_XV]
    c[C_NOISE_A] = par[GYRO_PSD] * T + s[SUM_XA]
    size = SUMS_WITH_SCALE if lay[L_ACCEL_SCALE] >= 0 else SUMS
    for i in range(size):
        c[C_SUMS + i] = s[SUM_V + i]
    at[COARSE] += C_SUMS + size


@njit(f"void({RECORDER}, f8[::1], f8[::1], f8, f8, i8)", cache=True)
def record_update(tape: Recorder, H: F64, gain: F64, r: float, y: float, n: int) -> None:
    """Put down a scalar update: ``H`` (n,), ``gain`` = P Hᵀ r, ``r`` = 1/√S, innovation ``y``."""
    kinds, coarse, fine, at = tape
    if kinds.shape[0] == 0:
        return
    kinds[at[KIND]] = UPDATE
    at[KIND] += 1
    for j in range(n):
        coarse[at[COARSE] + j] = H[j]
        fine[at[FINE] + j] = gain[j]
    fine[at[FINE] + n] = r
    fine[at[FINE] + n + 1] = y
    at[COARSE] += n
    at[FINE] += n + 2


@njit(f"void({RECORDER}, f8[::1])", cache=True)
def record_turn(tape: Recorder, dx: F64) -> None:
    """Put down the reset of the attitude error by the correction ``dx`` (n,)."""
    kinds, _, fine, at = tape
    if kinds.shape[0] == 0:
        return
    kinds[at[KIND]] = TURN
    at[KIND] += 1
    for i in range(3):
        fine[at[FINE] + i] = dx[ATT + i]
    at[FINE] += 3


@njit(f"void({RECORDER}, f8[::1], i8[::1])", cache=True)
def record_row(tape: Recorder, s: F64, lay: I64) -> None:
    """Mark an output row, with the upper triangle of P where it is wanted."""
    kinds, coarse, _, at = tape
    if kinds.shape[0] == 0:
        return
    kinds[at[KIND]] = ROW
    at[KIND] += 1
    if at[WITH_COVARIANCE] == 0:
        return
    n = lay[L_N]
    c = at[COARSE]
    for i in range(n):
        for j in range(i, n):
            coarse[c] = s[P_OFFSET + i * n + j]
            c += 1
    at[COARSE] = c


@njit("void(f4[::1], i8[::1], f8[::1])", cache=True)
def read_step(c: F32, lay: I64, s: F64) -> None:
    """Lay a step's numbers into ``s`` where the transition looks for them."""
    s[SUM_T], s[LAT], s[HEIGHT] = c[C_T], c[C_LAT], c[C_HEIGHT]
    for i in range(3):
        s[VEL_N + i] = c[C_VEL + i]
    size = SUMS_WITH_SCALE if lay[L_ACCEL_SCALE] >= 0 else SUMS
    for i in range(size):
        s[SUM_V + i] = c[C_SUMS + i]
