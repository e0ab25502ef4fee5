"""The tape: what a smoother needs of a forward run, written by the walk in order.

A run of records, one kind code each, with their numbers in two columns: ``fine`` (float64), and
``coarse`` (float32) for what needs no more than seven digits. The kind tells how long a record is,
so the tape reads in both directions.

==========  =========================================  ==================================
kind        fine                                       coarse
==========  =========================================  ==================================
STEP        T and the sums behind Φ of one covariance  velocity, latitude, height, noise,
            interval                                   factor on the biases' noise
TURN        correction of φ (3)                        –
FADE        α² that P was multiplied by                –
ROW         –                                          upper triangle of P, where wanted
UPDATE + m  1/√S, y, which m of H are not zero, P Hᵀ   –
            /√S (n), those of H (m)
==========  =========================================  ==================================

At 50 Hz the steps are 28 MB an hour; a scalar update takes about 180 bytes with sixteen states.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.estimation.process_noise import attitude_noise, velocity_noise
from companion.navigation.layout import (
    ATT,
    HEIGHT,
    L_ACCEL_SCALE,
    L_N,
    LAT,
    Q_SCALE,
    SUM_T,
    VEL_N,
)
from companion.navigation.layout import P as P_OFFSET
from companion.types import F64, I64

F32 = NDArray[np.float32]
I8 = NDArray[np.int8]
Recorder = tuple[I8, F32, F64, I64]

STEP, TURN, ROW, FADE, UPDATE = 0, 1, 2, 3, 4

# --- columns of a step in `coarse`
C_VEL, C_LAT, C_HEIGHT, C_NOISE_V, C_NOISE_A, C_NOISE_B, C_STEP = 0, 3, 4, 5, 6, 12, 13
# --- and in `fine`: T, ∫f (3), ∫∫f (3), ∫C (9), with scale states ∫C diag(f) (9), ∫C diag(ω) (9)
F_STEP, F_STEP_WITH_SCALE = 16, 34
# --- columns of an update in `fine`; H behind the gain
F_R, F_Y, F_MASK, F_GAIN = 0, 1, 2, 3
F_TURN = 3
F_FADE = 1

# --- entries of a position on the tape
KIND, COARSE, FINE, WITH_COVARIANCE = 0, 1, 2, 3

RECORDER = "Tuple((i1[::1], f4[::1], f8[::1], i8[::1]))"
"""Numba type of (kinds, coarse, fine, position), as the kernels take a tape. Empty: not recorded.

``position`` (4,) is where the next record goes, and what ROW keeps: 0 nothing, 1 P, 2 P where
nothing but rows is recorded.
"""
ROWS_ONLY = 2


@njit(f"void({RECORDER}, f8[::1], i8[::1], f8[::1])", cache=True)
def record_step(tape: Recorder, s: F64, lay: I64, par: F64) -> None:
    """Put down the running covariance interval of ``s``, before it is closed."""
    kinds, coarse, fine, at = tape
    T = s[SUM_T]
    if kinds.shape[0] == 0 or T <= 0.0 or at[WITH_COVARIANCE] == ROWS_ONLY:
        return
    kinds[at[KIND]] = STEP
    at[KIND] += 1
    c = coarse[at[COARSE] :]
    c[C_LAT], c[C_HEIGHT] = s[LAT], s[HEIGHT]
    for i in range(3):
        c[C_VEL + i] = s[VEL_N + i]
    c[C_NOISE_V] = velocity_noise(s, par)
    q = np.empty(6)
    attitude_noise(s, par, q)
    for i in range(6):
        c[C_NOISE_A + i] = q[i]
    c[C_NOISE_B] = s[Q_SCALE]
    size = F_STEP_WITH_SCALE if lay[L_ACCEL_SCALE] >= 0 else F_STEP
    for i in range(size):
        fine[at[FINE] + i] = s[SUM_T + i]
    at[COARSE] += C_STEP
    at[FINE] += size


@njit(f"void({RECORDER}, f8[::1], f8[::1], f8, f8, i8)", cache=True)
def record_update(tape: Recorder, H: F64, gain: F64, r: float, y: float, n: int) -> None:
    """Put down a scalar update: ``H`` (n,), ``gain`` = P Hᵀ r, ``r`` = 1/√S, innovation ``y``."""
    kinds, _, fine, at = tape
    if kinds.shape[0] == 0 or at[WITH_COVARIANCE] == ROWS_ONLY:
        return
    f = at[FINE]
    fine[f + F_R], fine[f + F_Y] = r, y
    mask, count = 0, 0
    for j in range(n):
        fine[f + F_GAIN + j] = gain[j]
        if H[j] != 0.0:
            mask |= 1 << j
            fine[f + F_GAIN + n + count] = H[j]
            count += 1
    fine[f + F_MASK] = mask  # at most 28 bits: exact
    kinds[at[KIND]] = UPDATE + count
    at[KIND] += 1
    at[FINE] = f + F_GAIN + n + count


@njit("void(f8[::1], i8, f8[::1])", cache=True)
def read_h(update: F64, n: int, H: F64) -> None:
    """``H`` (n,) of a recorded update."""
    mask = int(update[F_MASK])
    at = F_GAIN + n
    for j in range(n):
        H[j] = 0.0
        if mask >> j & 1:
            H[j] = update[at]
            at += 1


@njit(f"void({RECORDER}, f8[::1])", cache=True)
def record_turn(tape: Recorder, dx: F64) -> None:
    """Put down the reset of the attitude error by the correction ``dx`` (n,)."""
    kinds, _, fine, at = tape
    if kinds.shape[0] == 0 or at[WITH_COVARIANCE] == ROWS_ONLY:
        return
    kinds[at[KIND]] = TURN
    at[KIND] += 1
    for i in range(3):
        fine[at[FINE] + i] = dx[ATT + i]
    at[FINE] += F_TURN


@njit(f"void({RECORDER}, f8)", cache=True)
def record_fade(tape: Recorder, square: float) -> None:
    """Put down that P was multiplied by ``square``.

    It is a weighting of data, not noise: the smoothed error is the same on both sides, and its
    covariance is P_s / ``square`` before (Sasiadek and Wang's P^α; λ and Λ grow by ``square``).
    """
    kinds, _, fine, at = tape
    if kinds.shape[0] == 0 or at[WITH_COVARIANCE] == ROWS_ONLY:
        return
    kinds[at[KIND]] = FADE
    at[KIND] += 1
    fine[at[FINE]] = square
    at[FINE] += F_FADE


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


@njit("void(f4[::1], f8[::1], f8[::1])", cache=True)
def read_step(c: F32, f: F64, s: F64) -> None:
    """Lay a step's numbers into ``s`` where the transition looks for them."""
    s[LAT], s[HEIGHT] = c[C_LAT], c[C_HEIGHT]
    for i in range(3):
        s[VEL_N + i] = c[C_VEL + i]
    for i in range(f.shape[0]):
        s[SUM_T + i] = f[i]
