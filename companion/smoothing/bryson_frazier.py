"""The modified Bryson-Frazier smoother over a recorded tape: no inverse of P anywhere.

    at an update:   λ̃ = −Hᵀ S⁻¹ y + (I − K H)ᵀ λ̂ ,  Λ̃ = Hᵀ S⁻¹ H + (I − K H)ᵀ Λ̂ (I − K H)
    between:        λ̂ = Φᵀ λ̃ ,                      Λ̂ = Φᵀ Λ̃ Φ
    smoothed:       δx = −P λ̂ ,                      P_s = P − P Λ̂ P

both zero at the end (Bierman 1973; ALGORITHMS: Kamil et al. 2014 name the aim). P is needed at the
start of a chunk only: inside it the smoothed error moves forward by its own recursion,

    over a step:    δx⁻ = Φ δx − Q λ̃ ,               at an update: δx = δx⁻ − K y

so the history grows with the rate of the covariance, not with states², and not with the IMU's rate.
Feedback changes nothing but the turn G of the attitude error at a reset: λ ← Gᵀ λ, δx ← G δx.
Where P was multiplied by α² (FLAC), λ and Λ are too, going back, and δx stays.
"""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.estimation.covariance import STRIDE
from companion.estimation.receiver_clock import carry_clock, carry_clock_back
from companion.estimation.tape import (
    C_STEP,
    F32,
    F_FADE,
    F_GAIN,
    F_R,
    F_STEP,
    F_STEP_WITH_SCALE,
    F_TURN,
    F_Y,
    FADE,
    I8,
    STEP,
    TURN,
    UPDATE,
    read_h,
    read_step,
)
from companion.navigation.error_model import transition_blocks
from companion.navigation.layout import (
    ATT,
    L_ACCEL_SCALE,
    L_CLOCK,
    L_GYRO_SCALE,
    L_N,
)
from companion.smoothing.composite import (
    WIDTH,
    begin,
    flush,
    smoothed_blocks,
    step_back,
    turn_back,
    update_back,
)
from companion.smoothing.transition import (
    carry,
    carry_back,
    decay_factors,
    noise_diagonal,
    subtract_noise,
)
from companion.types import F64, I64


@njit("void(f8[:, ::1], f8[::1], i8, i8)", cache=True)
def turn_transposed(X: F64, g: F64, at: int, cols: int) -> None:
    """``X`` ← Gᵀ X on the attitude rows from ``at`` on; ``g`` corrects φ, see update.py."""
    x, y, z = 0.5 * g[0], 0.5 * g[1], g[2]
    for j in range(cols):
        a, b, c = X[at, j], X[at + 1, j], X[at + 2, j]
        X[at, j] = a + z * b - y * c
        X[at + 1, j] = b - z * a + x * c
        X[at + 2, j] = c + y * a - x * b


@njit("void(f8[::1], f8[::1], i8)", cache=True)
def turn(dx: F64, g: F64, at: int) -> None:
    """``dx`` ← G dx on the attitude rows from ``at`` on."""
    x, y, z = 0.5 * g[0], 0.5 * g[1], g[2]
    a, b, c = dx[at], dx[at + 1], dx[at + 2]
    dx[at] = a - z * b + y * c
    dx[at + 1] = b + z * a - x * c
    dx[at + 2] = c - y * a + x * b


@njit(
    "void(i1[::1], f4[::1], f8[::1], i8, i8[::1], f8[::1], f8[::1], f8[:, ::1], f8[:, ::1])",
    cache=True,
)
def backward(
    kinds: I8,
    coarse: F32,
    fine: F64,
    triangle: int,
    lay: I64,
    par: F64,
    s: F64,
    lam: F64,
    steps: F64,
) -> None:
    """Take λ, ``lam`` (n, 1), from the end of a chunk to its start, in place.

    The slices hold exactly the chunk, and ``triangle`` numbers of P with each row. ``s`` is scratch
    with the Earth's rate in place; ``steps`` (≥ steps of the chunk, n) keeps λ̃ after each step, for
    :func:`forward`.
    """
    n = lay[L_N]
    i_sa, i_sg, clock = lay[L_ACCEL_SCALE], lay[L_GYRO_SCALE], lay[L_CLOCK]
    size = F_STEP_WITH_SCALE if i_sa >= 0 else F_STEP
    B = np.empty((24, 3, 3))
    d = np.empty(n)
    x = lam.reshape(n)
    c, f = coarse.shape[0], fine.shape[0]
    m = 0
    for i in range(kinds.shape[0]):
        m += kinds[i] == STEP
    for i in range(kinds.shape[0] - 1, -1, -1):
        kind = kinds[i]
        if kind == STEP:
            m -= 1
            c -= C_STEP
            f -= size
            read_step(coarse[c : c + C_STEP], fine[f : f + size], s)
            transition_blocks(s, B)
            decay_factors(float(fine[f]), lay, par, d)
            for j in range(n):
                steps[m, j] = x[j]
                x[j] *= d[j]
            carry_back(B, i_sa, i_sg, x)
            if clock >= 0:
                carry_clock_back(float(fine[f]), x[clock:])
        elif kind >= UPDATE:
            f -= F_GAIN + n + kind - UPDATE
            r = fine[f + F_R]
            g = r * fine[f + F_Y]
            for j in range(n):
                g += fine[f + F_GAIN + j] * x[j]
            g *= r
            read_h(fine[f:], n, d)
            for j in range(n):
                x[j] -= d[j] * g
        elif kind == TURN:
            f -= F_TURN
            turn_transposed(lam, fine[f : f + F_TURN], ATT, 1)
        elif kind == FADE:
            f -= F_FADE
            for j in range(n):
                x[j] *= fine[f]
        else:
            c -= triangle


@njit(
    "void(i1[::1], f4[::1], f8[::1], i8, i8[::1], f8[::1], f8[::1], f8[:, ::1], f8[:, ::1],"
    "f8[:, ::1])",
    cache=True,
)
def forward(
    kinds: I8,
    coarse: F32,
    fine: F64,
    triangle: int,
    lay: I64,
    par: F64,
    s: F64,
    dx: F64,
    steps: F64,
    rows: F64,
) -> None:
    """Take the smoothed error, ``dx`` (n, 1), from the start of a chunk to its end, in place.

    At a chunk's start it is −P λ̂. ``rows`` (rows of the chunk, n) is filled with the error to add
    to the forward solution at each output row.
    """
    n = lay[L_N]
    i_sa, i_sg, clock = lay[L_ACCEL_SCALE], lay[L_GYRO_SCALE], lay[L_CLOCK]
    size = F_STEP_WITH_SCALE if i_sa >= 0 else F_STEP
    B = np.empty((24, 3, 3))
    d, q = np.empty(n), np.empty(n)
    out = np.empty(9)
    x = dx.reshape(n)
    c, f, m, row = 0, 0, 0, 0
    for i in range(kinds.shape[0]):
        kind = kinds[i]
        if kind == STEP:
            numbers, T = coarse[c : c + C_STEP], fine[f]
            read_step(numbers, fine[f : f + size], s)
            transition_blocks(s, B)
            decay_factors(T, lay, par, d)
            noise_diagonal(numbers, T, lay, par, d, q)
            carry(B, i_sa, i_sg, x, out)
            if clock >= 0:
                carry_clock(T, 1.0, x[clock:])
            for j in range(9):
                x[j] = out[j]
            for j in range(9, n):
                x[j] *= d[j]
            subtract_noise(numbers, T, lay, par, q, steps[m], x)
            c += C_STEP
            f += size
            m += 1
        elif kind >= UPDATE:
            y = fine[f + F_R] * fine[f + F_Y]
            for j in range(n):
                x[j] -= fine[f + F_GAIN + j] * y
            f += F_GAIN + n + kind - UPDATE
        elif kind == TURN:
            turn(x, fine[f : f + F_TURN], ATT)
            f += F_TURN
        elif kind == FADE:
            f += F_FADE
        else:
            for j in range(n):
                rows[row, j] = x[j]
            row += 1
            c += triangle


@njit(
    "void(i1[::1], f4[::1], f8[::1], i8, i8[::1], f8[::1], f8[::1], f8[:, ::1], f8[:, :, ::1])",
    cache=True,
)
def backward_covariance(
    kinds: I8,
    coarse: F32,
    fine: F64,
    triangle: int,
    lay: I64,
    par: F64,
    s: F64,
    Lam: F64,
    rows: F64,
) -> None:
    """Take Λ, ``Lam`` (n, n), from the end of a chunk to its start, in place.

    ``rows`` (rows of the chunk, 5, 6) is filled with the covariance blocks of the smoothed errors,
    as :attr:`companion.types.Solution.cov`. The tape must carry P with its rows.
    """
    n = lay[L_N]
    size = F_STEP_WITH_SCALE if lay[L_ACCEL_SCALE] >= 0 else F_STEP
    B = np.empty((24, 3, 3))
    d, w, D = np.empty(n), np.empty(n), np.ones(n)
    X, Z = np.zeros(n * WIDTH), np.empty(9 * WIDTH)
    L, U = np.zeros(n * STRIDE), np.zeros(n * STRIDE)
    V, P = np.zeros(n * STRIDE), np.zeros(n * STRIDE)
    for j in range(n):
        for k in range(n):
            L[j * STRIDE + k] = Lam[j, k]
    begin(X, lay)
    pending = False
    c, f, row = coarse.shape[0], fine.shape[0], rows.shape[0]
    for i in range(kinds.shape[0] - 1, -1, -1):
        kind = kinds[i]
        if kind == STEP:
            c -= C_STEP
            f -= size
            read_step(coarse[c : c + C_STEP], fine[f : f + size], s)
            transition_blocks(s, B)
            decay_factors(float(fine[f]), lay, par, d)
            step_back(B, lay, float(fine[f]), d, X, D, Z)
            pending = True
            continue
        if pending:
            flush(X, D, L, lay, U, V)
            pending = False
        if kind >= UPDATE:
            f -= F_GAIN + n + kind - UPDATE
            read_h(fine[f:], n, d)
            update_back(L, d, fine[f + F_GAIN : f + F_GAIN + n], fine[f + F_R], n, w)
        elif kind == TURN:
            f -= F_TURN
            turn_back(L, X, fine[f : f + F_TURN], n)
        elif kind == FADE:
            f -= F_FADE
            for j in range(n * STRIDE):
                L[j] *= fine[f]
        else:
            row -= 1
            c -= triangle
            at = c
            for j in range(n):
                for k in range(j, n):
                    P[j * STRIDE + k] = P[k * STRIDE + j] = coarse[at]
                    at += 1
            smoothed_blocks(P, L, n, V, rows[row].reshape(30))
    if pending:
        flush(X, D, L, lay, U, V)
    for j in range(n):
        for k in range(n):
            Lam[j, k] = L[j * STRIDE + k]
