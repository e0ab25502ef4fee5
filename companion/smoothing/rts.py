"""The Rauch-Tung-Striebel smoother over a recorded tape: the reference for the one without inverse.

    C = P Φᵀ (P⁻)⁻¹ ,  δx = C δx⁻ ,  P_s = P + C (P_s⁻ − P⁻) Cᵀ        over a step
    δx⁻ = δx + K y                                                      over an update

around the recorded nominal trajectory (Rauch, Tung and Striebel 1965). P and P⁻ are had again by
walking a chunk of the tape forward from its P. Where P was multiplied by α² (FLAC), the gain over
the step is α² P Φᵀ (P⁻)⁻¹: δx passes the weighting, and P_s is that much smaller before. Steps
with nothing between them are taken as one, by the product of their transitions.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.covariance import apply_transition
from companion.estimation.receiver_clock import carry_clock
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
    read_step,
)
from companion.estimation.update import reset_covariance
from companion.navigation.error_model import transition_blocks
from companion.navigation.layout import (
    ATT,
    CLOCK_STATES,
    L_ACCEL_SCALE,
    L_CLOCK,
    L_GYRO_SCALE,
    L_N,
)
from companion.smoothing.transition import add_noise, decay_factors, noise_diagonal
from companion.types import F64, I64


@njit("b1(f8[:, ::1], f8[:, ::1], i8)", cache=True)
def factor(A: F64, L: F64, n: int) -> bool:
    """Lower Cholesky factor of ``A`` in ``L``; False where ``A`` is not positive definite.

    A state without any variance is known: its row and column of ``L`` are zero.
    """
    for i in range(n):
        for j in range(i + 1):
            x = A[i, j]
            for k in range(j):
                x -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = x / L[j, j] if L[j, j] > 0.0 else 0.0
            elif A[i, i] == 0.0:
                L[i, i] = 0.0
            elif x > 0.0:
                L[i, i] = math.sqrt(x)
            else:
                return False
    return True


@njit("void(f8[:, ::1], f8[:, ::1], i8)", cache=True)
def solve(L: F64, X: F64, n: int) -> None:
    """``X`` (n, n) ← (L Lᵀ)⁻¹ X in place, zero for states that are known."""
    for i in range(n):
        for k in range(i):
            g = L[i, k]
            for j in range(n):
                X[i, j] -= g * X[k, j]
        for j in range(n):
            X[i, j] = X[i, j] / L[i, i] if L[i, i] > 0.0 else 0.0
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            g = L[k, i]
            for j in range(n):
                X[i, j] -= g * X[k, j]
        for j in range(n):
            X[i, j] = X[i, j] / L[i, i] if L[i, i] > 0.0 else 0.0


@njit("b1(i1[::1], i8)", cache=True)
def last_of_run(kinds: I8, i: int) -> bool:
    """Whether the step ``i`` is the last one before something else, or of all."""
    return bool(i + 1 == kinds.shape[0] or kinds[i + 1] != STEP)


@njit("i8(i1[::1])", cache=True)
def count_runs(kinds: I8) -> int:
    """How many runs of steps there are."""
    count = 0
    for i in range(kinds.shape[0]):
        count += kinds[i] == STEP and last_of_run(kinds, i)
    return int(count)


@njit("void(f8[:, :, ::1], i8[::1], f8, f8[:, ::1], f8[:, ::1])", cache=True)
def _transit(B: F64, lay: I64, T: float, X: F64, Y: F64) -> None:
    """``X`` (n, n) ← Φ ``X`` over ``T`` [s]; ``Y`` (9, n) is scratch."""
    n, clock = lay[L_N], lay[L_CLOCK]
    apply_transition(B, lay[L_ACCEL_SCALE], lay[L_GYRO_SCALE], X, n, Y)
    for j in range(9):
        for k in range(n):
            X[j, k] = Y[j, k]
    if clock >= 0:
        own = np.empty(CLOCK_STATES)
        for k in range(n):
            for j in range(CLOCK_STATES):
                own[j] = X[clock + j, k]
            carry_clock(T, 1.0, own)
            for j in range(CLOCK_STATES):
                X[clock + j, k] = own[j]


@njit("void(f8[:, :, ::1], i8[::1], f8, f8[::1], f8[:, ::1], f8[:, ::1])", cache=True)
def _carry(B: F64, lay: I64, T: float, d: F64, X: F64, Y: F64) -> None:
    """``X`` (n, n) ← D Φ ``X`` over ``T`` [s]; ``Y`` (9, n) is scratch."""
    n = lay[L_N]
    _transit(B, lay, T, X, Y)
    for j in range(9, n):
        if d[j] != 1.0:
            for k in range(n):
                X[j, k] *= d[j]


@njit(
    "void(i1[::1], f4[::1], f8[::1], i8, i8[::1], f8[::1], f8[::1], f8[:, ::1], f8[:, :, ::1],"
    "f8[:, :, ::1], f8[:, :, ::1])",
    cache=True,
)
def covariances(
    kinds: I8,
    coarse: F32,
    fine: F64,
    triangle: int,
    lay: I64,
    par: F64,
    s: F64,
    P: F64,
    before: F64,
    foreseen: F64,
    gains: F64,
) -> None:
    """Walk ``P`` (n, n) over a chunk, in place.

    For each run of steps without anything between them, ``before`` gets P (n, n), ``foreseen`` P⁻
    and ``gains`` Ψ P with Ψ = D_m Φ_m … D_1 Φ_1, of which Cᵀ is (P⁻)⁻¹ Ψ P.
    """
    n = lay[L_N]
    size = F_STEP_WITH_SCALE if lay[L_ACCEL_SCALE] >= 0 else F_STEP
    B = np.empty((24, 3, 3))
    d, q, dx = np.empty(n), np.empty(n), np.zeros(n)
    X, Y = np.empty((n, n)), np.empty((9, n))
    c, f, m = 0, 0, 0
    inside = False
    for i in range(kinds.shape[0]):
        kind = kinds[i]
        if kind == STEP:
            numbers, T = coarse[c : c + C_STEP], fine[f]
            read_step(numbers, fine[f : f + size], s)
            transition_blocks(s, B)
            decay_factors(T, lay, par, d)
            noise_diagonal(numbers, T, lay, par, d, q)
            G = gains[m]
            if inside:
                _carry(B, lay, T, d, G, Y)
            else:
                for j in range(n):
                    for k in range(n):
                        before[m, j, k] = P[j, k]
            _carry(B, lay, T, d, P, Y)
            if not inside:
                for j in range(n):
                    for k in range(n):
                        G[j, k] = P[j, k]
            inside = True
            for j in range(n):
                for k in range(n):
                    X[k, j] = P[j, k]
            _transit(B, lay, T, X, Y)
            for j in range(n):
                for k in range(j, n):
                    P[j, k] = P[k, j] = X[j, k] * d[j]
            add_noise(numbers, T, lay, par, q, P)
            if last_of_run(kinds, i):
                for j in range(n):
                    for k in range(n):
                        foreseen[m, j, k] = P[j, k]
                m += 1
                inside = False
            c += C_STEP
            f += size
        elif kind >= UPDATE:
            gain = fine[f + F_GAIN : f + F_GAIN + n]
            for j in range(n):
                for k in range(n):
                    P[j, k] -= gain[j] * gain[k]
            f += F_GAIN + n + kind - UPDATE
        elif kind == TURN:
            for j in range(3):
                dx[ATT + j] = fine[f + j]
            reset_covariance(P, dx, n)
            f += F_TURN
        elif kind == FADE:
            for j in range(n):
                for k in range(n):
                    P[j, k] *= fine[f]
            f += F_FADE
        else:
            c += triangle


@njit("void(f8[::1], f8[:, ::1], f8[::1], i8)", cache=True)
def _turn_back(dx: F64, Ps: F64, g: F64, n: int) -> None:
    """``dx`` ← G⁻¹ dx and ``Ps`` ← G⁻¹ Ps G⁻ᵀ, by Cramer's rule on the attitude block."""
    x, y, z = 0.5 * g[0], 0.5 * g[1], g[2]
    G = np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]])
    A = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            p, q = (j + 1) % 3, (j + 2) % 3
            u, v = (i + 1) % 3, (i + 2) % 3
            A[i, j] = G[p, u] * G[q, v] - G[p, v] * G[q, u]
    det = G[0, 0] * A[0, 0] + G[0, 1] * A[1, 0] + G[0, 2] * A[2, 0]
    t = np.empty(3)
    for i in range(3):
        t[i] = (A[i, 0] * dx[ATT] + A[i, 1] * dx[ATT + 1] + A[i, 2] * dx[ATT + 2]) / det
    for i in range(3):
        dx[ATT + i] = t[i]
    for side in range(2):
        for j in range(n):
            for i in range(3):
                t[i] = 0.0
                for k in range(3):
                    t[i] += A[i, k] * (Ps[ATT + k, j] if side == 0 else Ps[j, ATT + k]) / det
            for i in range(3):
                if side == 0:
                    Ps[ATT + i, j] = t[i]
                else:
                    Ps[j, ATT + i] = t[i]


@njit("void(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], i8)", cache=True)
def _smooth_covariance(A: F64, D: F64, P: F64, Ps: F64, W: F64, n: int) -> None:
    """``Ps`` ← P + C (Ps − P⁻) Cᵀ with ``A`` = Cᵀ and ``D`` = P⁻ Cᵀ; ``W`` (n, n) is scratch."""
    for j in range(n):
        for k in range(n):
            W[j, k] = -D[j, k]
        for q in range(n):
            g = Ps[j, q]
            for k in range(n):
                W[j, k] += g * A[q, k]
    for j in range(n):
        for k in range(n):
            Ps[j, k] = P[j, k]
    for q in range(n):
        for j in range(n):
            g = A[q, j]
            for k in range(n):
                Ps[j, k] += g * W[q, k]
    for j in range(n):
        for k in range(j):
            Ps[j, k] = Ps[k, j] = 0.5 * (Ps[j, k] + Ps[k, j])


@njit(
    "b1(i1[::1], f4[::1], f8[::1], i8, i8[::1], f8[:, :, ::1], f8[:, :, ::1],"
    "f8[:, :, ::1], f8[::1], f8[:, ::1], f8[:, ::1], f8[:, :, ::1])",
    cache=True,
)
def backward(
    kinds: I8,
    coarse: F32,
    fine: F64,
    triangle: int,
    lay: I64,
    before: F64,
    foreseen: F64,
    gains: F64,
    dx: F64,
    Ps: F64,
    rows: F64,
    cov_rows: F64,
) -> bool:
    """Take the smoothed error and its covariance from a chunk's end to its start, in place.

    ``dx`` (n,), ``Ps`` (n, n); ``before``, ``foreseen``, ``gains`` come from :func:`covariances`,
    and the last is spoilt. ``rows`` (rows, n) and ``cov_rows`` (rows, n, n) are filled at output
    rows. False where a P⁻ is not positive definite.
    """
    n = lay[L_N]
    size = F_STEP_WITH_SCALE if lay[L_ACCEL_SCALE] >= 0 else F_STEP
    L, D = np.empty((n, n)), np.empty((n, n))
    t = np.empty(n)
    c, f = coarse.shape[0], fine.shape[0]
    row = rows.shape[0]
    m = count_runs(kinds)
    for i in range(kinds.shape[0] - 1, -1, -1):
        kind = kinds[i]
        if kind == STEP:
            c -= C_STEP
            f -= size
            if not last_of_run(kinds, i):
                continue
            m -= 1
            if not factor(foreseen[m], L, n):
                return False
            A = gains[m]  # D Φ P, becomes Cᵀ
            for j in range(n):
                for k in range(n):
                    D[j, k] = A[j, k]
            solve(L, A, n)
            for j in range(n):
                t[j] = 0.0
            for k in range(n):
                for j in range(n):
                    t[j] += A[k, j] * dx[k]
            for j in range(n):
                dx[j] = t[j]
            _smooth_covariance(A, D, before[m], Ps, L, n)
        elif kind >= UPDATE:
            f -= F_GAIN + n + kind - UPDATE
            y = fine[f + F_R] * fine[f + F_Y]
            for j in range(n):
                dx[j] += fine[f + F_GAIN + j] * y
        elif kind == TURN:
            f -= F_TURN
            _turn_back(dx, Ps, fine[f : f + F_TURN], n)
        elif kind == FADE:
            f -= F_FADE
            for j in range(n):
                for k in range(n):
                    Ps[j, k] /= fine[f]
        else:
            row -= 1
            c -= triangle
            for j in range(n):
                rows[row, j] = dx[j]
                for k in range(n):
                    cov_rows[row, j, k] = Ps[j, k]
    return True
