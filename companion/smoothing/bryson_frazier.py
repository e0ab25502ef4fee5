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
    CORE_STATES,
    L_ACCEL_SCALE,
    L_GYRO_SCALE,
    L_N,
)
from companion.smoothing.transition import (
    carry,
    carry_back,
    carry_back_matrix,
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
    i_sa, i_sg = lay[L_ACCEL_SCALE], lay[L_GYRO_SCALE]
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
    i_sa, i_sg = lay[L_ACCEL_SCALE], lay[L_GYRO_SCALE]
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
            for j in range(9):
                x[j] = out[j]
            for j in range(9, n):
                x[j] *= d[j]
            subtract_noise(numbers, T, q, steps[m], x)
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


@njit("void(f8[:, ::1], f8[::1], f8[::1], f8[::1], f8, i8)", cache=True)
def _information_of_update(Lam: F64, w: F64, H: F64, gain: F64, r: float, n: int) -> None:
    """``Lam`` ← Hᵀ r² H + (I − K H)ᵀ Lam (I − K H) with K = ``gain`` r; ``w`` (n,) is scratch."""
    kwk = r * r
    for i in range(n):
        x = 0.0
        for j in range(n):
            x += Lam[i, j] * gain[j]
        w[i] = x * r
        kwk += w[i] * gain[i] * r
    for i in range(n):
        h = H[i]
        if h != 0.0:
            for j in range(n):
                Lam[i, j] += h * (0.5 * kwk * H[j] - w[j])
                Lam[j, i] += h * (0.5 * kwk * H[j] - w[j])


@njit("void(f4[::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], i8)", cache=True)
def _smoothed_blocks(triangle: F32, Lam: F64, P: F64, M: F64, out: F64, n: int) -> None:
    """``out`` (5, 6): the published blocks of P − P Λ P. ``P``, ``M`` (n, n) are scratch."""
    c = 0
    for i in range(n):
        for j in range(i, n):
            P[i, j] = P[j, i] = triangle[c]
            c += 1
    for i in range(n):
        for j in range(CORE_STATES):
            x = 0.0
            for k in range(n):
                x += Lam[i, k] * P[k, j]
            M[i, j] = x
    for block in range(5):
        at = 0
        for i in range(3 * block, 3 * block + 3):
            for j in range(i, 3 * block + 3):
                x = P[i, j]
                for k in range(n):
                    x -= P[i, k] * M[k, j]
                out[block, at] = x
                at += 1


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
    i_sa, i_sg = lay[L_ACCEL_SCALE], lay[L_GYRO_SCALE]
    size = F_STEP_WITH_SCALE if i_sa >= 0 else F_STEP
    B = np.empty((24, 3, 3))
    d, w = np.empty(n), np.empty(n)
    X, Y = np.empty((n, n)), np.empty((n, n))
    c, f, row = coarse.shape[0], fine.shape[0], rows.shape[0]
    for i in range(kinds.shape[0] - 1, -1, -1):
        kind = kinds[i]
        if kind == STEP:
            c -= C_STEP
            f -= size
            read_step(coarse[c : c + C_STEP], fine[f : f + size], s)
            transition_blocks(s, B)
            decay_factors(float(fine[f]), lay, par, d)
            for j in range(n):
                g = d[j]
                for k in range(n):
                    Lam[j, k] *= g * d[k]
            carry_back_matrix(B, i_sa, i_sg, Lam, Y)
            for j in range(n):
                for k in range(n):
                    X[j, k] = Y[k, j]
            carry_back_matrix(B, i_sa, i_sg, X, Lam)
            for j in range(n):
                for k in range(j):
                    Lam[j, k] = Lam[k, j]
        elif kind >= UPDATE:
            f -= F_GAIN + n + kind - UPDATE
            read_h(fine[f:], n, d)
            _information_of_update(Lam, w, d, fine[f + F_GAIN : f + F_GAIN + n], fine[f + F_R], n)
        elif kind == TURN:
            f -= F_TURN
            turn_transposed(Lam, fine[f : f + F_TURN], ATT, n)
            for j in range(n):
                for k in range(n):
                    X[j, k] = Lam[k, j]
            turn_transposed(X, fine[f : f + F_TURN], ATT, n)
            for j in range(n):
                for k in range(n):
                    Lam[j, k] = X[k, j]
        elif kind == FADE:
            f -= F_FADE
            for j in range(n):
                for k in range(n):
                    Lam[j, k] *= fine[f]
        else:
            row -= 1
            c -= triangle
            _smoothed_blocks(coarse[c : c + triangle], Lam, X, Y, rows[row], n)
