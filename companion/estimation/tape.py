"""The tape: what a smoother needs of a forward run, written by the walk in order.

A run of records, one kind code each, with their numbers in two columns: ``fine`` (float64), and
``coarse`` (float32) for what needs no more than seven digits. The kind tells how long a record is,
so the tape reads in both directions.

==========  =========================================  ==================================
kind        fine                                       coarse
==========  =========================================  ==================================
STEP        T and the sums behind Φ of one covariance  velocity, latitude, height, noise,
            interval                                   factor on the biases' noise, clock let go,
                                                       factors on its noise
TURN        correction of φ (3)                        –
FADE        α² that P was multiplied by                –
ROW         –                                          upper triangle of P, where nothing but
                                                       rows is recorded
UPDATE + m  1/√S, y, which m of H are not zero, P Hᵀ   –
            /√S (n), those of H (m)
==========  =========================================  ==================================

At 50 Hz the steps are 30 MB an hour; a scalar update takes about 180 bytes with sixteen states.

A tape for smoothing on line is read while it is written, goes back with the filter, and is soon
forgotten. So its rows hold all that they stand for, and it says where an update interval ends:

==========  =========================================  ==================================
FIX         time of an accepted fix (2)                –
PLAIN_ROW   time (2), output row                       –
FULL_ROW    time (2), output row, upper triangle of P  –
==========  =========================================  ==================================
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion._jit import njit
from companion.estimation.process_noise import attitude_noise, bias_noise, velocity_noise
from companion.navigation.layout import (
    ATT,
    CLOCK_SCALE,
    HEIGHT,
    L_ACCEL_SCALE,
    L_N,
    LAT,
    SUM_T,
    SUM_XC,
    VEL_N,
)
from companion.navigation.layout import P as P_OFFSET
from companion.types import F64, I64

F32 = NDArray[np.float32]
I8 = NDArray[np.int8]
Recorder = tuple[I8, F32, F64, I64]

SECOND = 1_000_000_000
STEP, TURN, ROW, FADE, UPDATE = 0, 1, 2, 3, 4
FIX, PLAIN_ROW, FULL_ROW = -1, -2, -3

# --- columns of a step in `coarse`
C_VEL, C_LAT, C_HEIGHT, C_NOISE_V, C_NOISE_A, C_NOISE_B = 0, 3, 4, 5, 6, 12
C_LET_GO, C_CLOCK, C_STEP = 13, 14, 17
# --- and in `fine`: T, ∫f (3), ∫∫f (3), ∫C (9), with scale states ∫C diag(f) (9), ∫C diag(ω) (9)
F_STEP, F_STEP_WITH_SCALE = 16, 34
# --- columns of an update in `fine`; H behind the gain
F_R, F_Y, F_MASK, F_GAIN = 0, 1, 2, 3
F_TURN = 3
F_FADE = 1
# --- a time in `fine`: whole seconds and the nanoseconds beyond, both exact
F_TIME = 2

# --- entries of a position on the tape
KIND, COARSE, FINE, ROWS, EVERY_NS, CELL = 0, 1, 2, 3, 4, 5
POSITION = 6
# --- what becomes of an output row: marked; put down with P where nothing but rows is recorded; on
# line those to be smoothed, or all
MARKED, ROWS_ONLY, TO_SMOOTH, ALL = 0, 2, 3, 4

RECORDER = "Tuple((i1[::1], f4[::1], f8[::1], i8[::1]))"
"""Numba type of (kinds, coarse, fine, position), as the kernels take a tape. Empty: not recorded.

``position`` (6,) is where the next record goes, what rows keep, and on line the grid of the rows to
be smoothed with the cell of the last one.
"""


@njit(f"void({RECORDER}, f8[::1], i8[::1], f8[::1])", cache=True, counted=False)
def record_step(tape: Recorder, s: F64, lay: I64, par: F64) -> None:
    """Put down the running covariance interval of ``s``, before it is closed."""
    kinds, coarse, fine, at = tape
    T = s[SUM_T]
    if kinds.shape[0] == 0 or T <= 0.0 or at[ROWS] == ROWS_ONLY:
        return
    kinds[at[KIND]] = STEP
    at[KIND] += 1
    c = coarse[at[COARSE] :]
    c[C_LAT], c[C_HEIGHT] = s[LAT], s[HEIGHT]
    for i in range(3):
        c[C_VEL + i] = s[VEL_N + i]
    c[C_NOISE_V] = velocity_noise(s, par)
    q = fine[at[FINE] :]  # scratch until the sums are put there
    attitude_noise(s, par, q)
    for i in range(6):
        c[C_NOISE_A + i] = q[i]
    c[C_NOISE_B] = bias_noise(s)
    c[C_LET_GO] = s[SUM_XC]
    for i in range(3):
        c[C_CLOCK + i] = s[CLOCK_SCALE + i]
    size = F_STEP_WITH_SCALE if lay[L_ACCEL_SCALE] >= 0 else F_STEP
    for i in range(size):
        fine[at[FINE] + i] = s[SUM_T + i]
    at[COARSE] += C_STEP
    at[FINE] += size


@njit(f"void({RECORDER}, f8[::1], f8[::1], f8, f8, i8)", cache=True, counted=False)
def record_update(tape: Recorder, H: F64, gain: F64, r: float, y: float, n: int) -> None:
    """Put down a scalar update: ``H`` (n,), ``gain`` = P Hᵀ r, ``r`` = 1/√S, innovation ``y``."""
    kinds, _, fine, at = tape
    if kinds.shape[0] == 0 or at[ROWS] == ROWS_ONLY:
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
    fine[f + F_MASK] = mask  # at most 32 bits: exact
    kinds[at[KIND]] = UPDATE + count
    at[KIND] += 1
    at[FINE] = f + F_GAIN + n + count


@njit("void(f8[::1], i8, f8[::1])", cache=True, counted=False)
def read_h(update: F64, n: int, H: F64) -> None:
    """``H`` (n,) of a recorded update."""
    mask = int(update[F_MASK])
    at = F_GAIN + n
    for j in range(n):
        H[j] = 0.0
        if mask >> j & 1:
            H[j] = update[at]
            at += 1


@njit(f"void({RECORDER}, f8[::1])", cache=True, counted=False)
def record_turn(tape: Recorder, dx: F64) -> None:
    """Put down the reset of the attitude error by the correction ``dx`` (n,)."""
    kinds, _, fine, at = tape
    if kinds.shape[0] == 0 or at[ROWS] == ROWS_ONLY:
        return
    kinds[at[KIND]] = TURN
    at[KIND] += 1
    for i in range(3):
        fine[at[FINE] + i] = dx[ATT + i]
    at[FINE] += F_TURN


@njit(f"void({RECORDER}, f8)", cache=True, counted=False)
def record_fade(tape: Recorder, square: float) -> None:
    """Put down that P was multiplied by ``square``.

    It is a weighting of data, not noise: the smoothed error is the same on both sides, and its
    covariance is P_s / ``square`` before (Sasiadek and Wang's P^α; λ and Λ grow by ``square``).
    """
    kinds, _, fine, at = tape
    if kinds.shape[0] == 0 or at[ROWS] == ROWS_ONLY:
        return
    kinds[at[KIND]] = FADE
    at[KIND] += 1
    fine[at[FINE]] = square
    at[FINE] += F_FADE


@njit("void(f8[::1], i8)", cache=True, counted=False)
def write_time(f: F64, t: int) -> None:
    """A time [ns] as two numbers that hold it exactly."""
    f[0], f[1] = t // SECOND, t % SECOND


@njit("i8(f8[::1])", cache=True, counted=False)
def read_time(f: F64) -> int:
    """The time [ns] behind two numbers."""
    return int(f[0]) * SECOND + int(f[1])


@njit(f"void({RECORDER}, i8)", cache=True, counted=False)
def record_fix(tape: Recorder, t: int) -> None:
    """On line: mark that a fix valid at ``t`` was taken in, the end of an update interval."""
    kinds, _, fine, at = tape
    if kinds.shape[0] == 0 or at[ROWS] < TO_SMOOTH:
        return
    kinds[at[KIND]] = FIX
    at[KIND] += 1
    write_time(fine[at[FINE] :], t)
    at[FINE] += F_TIME


@njit(f"void({RECORDER}, f8[::1], i8[::1], i8, f8[::1])", cache=True, counted=False)
def record_row(tape: Recorder, s: F64, lay: I64, t: int, row: F64) -> None:
    """Mark an output row at ``t``, with the upper triangle of P where it is wanted.

    On line with ``row`` itself, and P once in each cell of the grid of smoothed epochs.
    """
    kinds, coarse, fine, at = tape
    if kinds.shape[0] == 0:
        return
    n = lay[L_N]
    if at[ROWS] < TO_SMOOTH:
        kinds[at[KIND]] = ROW
        at[KIND] += 1
        if at[ROWS] != MARKED:
            c = at[COARSE]
            for i in range(n):
                for j in range(i, n):
                    coarse[c] = s[P_OFFSET + i * n + j]
                    c += 1
            at[COARSE] = c
        return
    full = t // at[EVERY_NS] != at[CELL]
    if not full and at[ROWS] == TO_SMOOTH:
        return
    kinds[at[KIND]] = FULL_ROW if full else PLAIN_ROW
    at[KIND] += 1
    f = at[FINE]
    write_time(fine[f:], t)
    f += F_TIME
    for i in range(row.shape[0]):
        fine[f + i] = row[i]
    f += row.shape[0]
    if full:
        at[CELL] = t // at[EVERY_NS]
        for i in range(n):
            for j in range(i, n):
                fine[f] = s[P_OFFSET + i * n + j]
                f += 1
    at[FINE] = f


@njit("void(f4[::1], f8[::1], f8[::1])", cache=True, counted=False)
def read_step(c: F32, f: F64, s: F64) -> None:
    """Lay a step's numbers into ``s`` where the transition looks for them."""
    s[LAT], s[HEIGHT] = c[C_LAT], c[C_HEIGHT]
    for i in range(3):
        s[VEL_N + i] = c[C_VEL + i]
    for i in range(f.shape[0]):
        s[SUM_T + i] = f[i]
