"""The Rauch-Tung-Striebel smoother over a recorded tape: the reference for the one without inverse.

    C = P Ψᵀ (P⁻)⁻¹ ,  δx = C δx⁻ ,  P_s = P + C (P_s⁻ − P⁻) Cᵀ        over a run of steps
    δx⁻ = δx + K y                                                      over an update

around the recorded nominal trajectory (Rauch, Tung and Striebel 1965). Steps with nothing between
them are taken as one, by the product Ψ of their transitions (composite.py). P and P⁻ are had again
by walking a chunk of the tape forward from its P (covariances.py). Where P was multiplied by α²
(FLAC), the gain over the step is α² P Φᵀ (P⁻)⁻¹: δx passes the weighting, and P_s is that much
smaller before.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.covariance import STRIDE
from companion.estimation.tape import (
    C_STEP,
    F32,
    F_FADE,
    F_GAIN,
    F_R,
    F_TURN,
    F_Y,
    FADE,
    I8,
    STEP,
    TURN,
    UPDATE,
)
from companion.navigation.layout import (
    ATT,
    DRIFT,
    L_CLOCK,
    L_N,
    RAMP,
)
from companion.smoothing.composite import OF_BIAS, OF_DRIFT, WIDTH, begin, step_back
from companion.smoothing.covariances import count_runs
from companion.smoothing.phi import K_SIZE, coefficients, step_size
from companion.smoothing.transition import decay_factors
from companion.types import F64, I64


@njit("b1(f8[:, ::1], i8)", cache=True, counted=False)
def factor(A: F64, n: int) -> bool:
    """``A`` (n, ≥ n) ← Lᵀ with A = L Lᵀ, in its upper half; False where not positive definite.

    A state without any variance is known: its row of Lᵀ is zero.
    """
    for k in range(n):
        if A[k, k] > 0.0:
            g = 1.0 / math.sqrt(A[k, k])
            for j in range(k, n):
                A[k, j] *= g
        elif A[k, k] == 0.0:
            for j in range(k, n):
                A[k, j] = 0.0
        else:
            return False
        for i in range(k + 1, n):
            # A known state stays at its zero, whatever rounding says of what it has with others.
            g = A[k, i] if A[i, i] != 0.0 else 0.0
            for j in range(i, n):
                A[i, j] -= g * A[k, j]
    return True


@njit("void(f8[:, ::1], f8[:, ::1], i8)", cache=True, counted=False)
def solve(U: F64, X: F64, n: int) -> None:
    """``X`` (n, n) ← (Uᵀ U)⁻¹ X in place, zero for states that are known."""
    for i in range(n):
        g = 1.0 / U[i, i] if U[i, i] > 0.0 else 0.0
        for j in range(n):
            X[i, j] *= g
        for k in range(i + 1, n):
            g = U[i, k]
            for j in range(n):
                X[k, j] -= g * X[i, j]
    for i in range(n - 1, -1, -1):
        g = 1.0 / U[i, i] if U[i, i] > 0.0 else 0.0
        for j in range(n):
            X[i, j] *= g
        for k in range(i):
            g = U[k, i]
            for j in range(n):
                X[k, j] -= g * X[i, j]


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


@njit("void(f8[::1], f8[::1], i8[::1], f8[:, ::1], f8[:, ::1])", cache=True, counted=False)
def _predicted(X: F64, D: F64, lay: I64, P: F64, A: F64) -> None:
    """``A`` ← Ψ ``P``, both (n, STRIDE); ``X`` and ``D`` as composite.py has Ψᵀ."""
    n, clock = lay[L_N], lay[L_CLOCK]
    wide = (n + 3) // 4 * 4
    for i in range(9, n):
        for j in range(wide):
            A[i, j] = D[i] * P[i, j]
    for i in range(9):
        for j in range(wide):
            A[i, j] = 0.0
        for k in range(n):
            g = X[k * WIDTH + i]
            for j in range(wide):
                A[i, j] += g * P[k, j]
    if clock >= 0:
        drift, ramp = clock + DRIFT, clock + RAMP
        for j in range(wide):
            A[clock, j] += X[drift * WIDTH + OF_BIAS] * P[drift, j]
            A[clock, j] += X[ramp * WIDTH + OF_BIAS] * P[ramp, j]
            A[drift, j] += X[ramp * WIDTH + OF_DRIFT] * P[ramp, j]


@njit(
    "void(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], i8)",
    cache=True,
    counted=False,
)
def _smooth_covariance(A: F64, D: F64, P: F64, Ps: F64, W: F64, n: int) -> None:
    """``Ps`` ← P + C (Ps − P⁻) Cᵀ with ``A`` = Cᵀ and ``D`` = P⁻ Cᵀ; ``W`` is scratch.

    All (n, STRIDE).
    """
    wide = (n + 3) // 4 * 4
    for j in range(n):
        for k in range(wide):
            W[j, k] = -D[j, k]
        for q in range(n):
            g = Ps[j, q]
            for k in range(wide):
                W[j, k] += g * A[q, k]
    for j in range(n):
        for k in range(wide):
            Ps[j, k] = P[j, k]
    for q in range(n):
        for j in range(n):
            g = A[q, j]
            for k in range(wide):
                Ps[j, k] += g * W[q, k]
    for j in range(n):
        for k in range(j):
            Ps[j, k] = Ps[k, j] = 0.5 * (Ps[j, k] + Ps[k, j])


@njit(
    "b1(i1[::1], f4[::1], f8[::1], i8[::1], f8[::1], f8[::1], f8[:, :, ::1], f8[:, :, ::1],"
    "f8[::1], f8[:, ::1], f8[:, ::1], f8[:, :, ::1])",
    cache=True,
    entry=True,
)
def backward(
    kinds: I8,
    coarse: F32,
    fine: F64,
    lay: I64,
    par: F64,
    s: F64,
    before: F64,
    foreseen: F64,
    dx: F64,
    Ps: F64,
    rows: F64,
    cov_rows: F64,
) -> bool:
    """Take the smoothed error and its covariance from a chunk's end to its start, in place.

    ``dx`` (n,), ``Ps`` (n, n); ``before`` and ``foreseen`` come from covariances.py. ``rows``
    (rows, n) and ``cov_rows`` (rows, n, n) are filled at output rows. False where a P⁻ is not
    positive definite.
    """
    n = lay[L_N]
    size = step_size(lay)
    B = np.empty((24, 3, 3))
    d, t, decay, K = np.empty(n), np.empty(n), np.ones(n), np.empty(K_SIZE)
    X = np.zeros(n * WIDTH)
    A, D, U = np.zeros((n, STRIDE)), np.zeros((n, STRIDE)), np.zeros((n, STRIDE))
    S, P = np.zeros((n, STRIDE)), np.zeros((n, STRIDE))
    S[:, :n] = Ps
    begin(X, lay)
    c, f, row = coarse.shape[0], fine.shape[0], rows.shape[0]
    m = count_runs(kinds)
    for i in range(kinds.shape[0] - 1, -1, -1):
        kind = kinds[i]
        if kind == STEP:
            c -= C_STEP
            f -= size
            T = float(fine[f])
            coefficients(coarse[c : c + C_STEP], fine[f : f + size], lay, s, B, K)
            decay_factors(T, lay, par, d)
            step_back(K, lay, d, X, decay)
            if i > 0 and kinds[i - 1] == STEP:
                continue
            m -= 1
            P[:, :n] = before[m]
            U[:, :n] = foreseen[m]
            if not factor(U, n):
                return False
            _predicted(X, decay, lay, P, A)
            begin(X, lay)
            decay[:] = 1.0
            D[:] = A
            solve(U, A, n)  # is Cᵀ now
            for j in range(n):
                t[j] = 0.0
            for k in range(n):
                for j in range(n):
                    t[j] += A[k, j] * dx[k]
            for j in range(n):
                dx[j] = t[j]
            _smooth_covariance(A, D, P, S, U, n)
        elif kind >= UPDATE:
            f -= F_GAIN + n + kind - UPDATE
            y = fine[f + F_R] * fine[f + F_Y]
            for j in range(n):
                dx[j] += fine[f + F_GAIN + j] * y
        elif kind == TURN:
            f -= F_TURN
            _turn_back(dx, S, fine[f:], n)
        elif kind == FADE:
            f -= F_FADE
            S /= fine[f]
        else:
            row -= 1
            rows[row] = dx
            cov_rows[row] = S[:, :n]
    Ps[:] = S[:, :n]
    return True
