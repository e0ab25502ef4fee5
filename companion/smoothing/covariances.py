"""P over a recorded tape: walked again from the start of a chunk, as the filter walked it.

    over a step  P ← D Φ P Φᵀ D + Q ,   at an update  P ← P − (P Hᵀ)(P Hᵀ)ᵀ / S

The steps and gains are on the tape anyway, so that a covariance need not be: with fifteen states it
would be half a kilobyte an output row.
"""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.estimation.covariance import STRIDE
from companion.estimation.tape import (
    C_STEP,
    F32,
    F_FADE,
    F_GAIN,
    F_TURN,
    FADE,
    I8,
    STEP,
    TURN,
    UPDATE,
)
from companion.estimation.update import reset_covariance
from companion.navigation.layout import (
    ACCEL_BIAS,
    ATT,
    DRIFT,
    GYRO_BIAS,
    L_ACCEL_SCALE,
    L_CLOCK,
    L_GYRO_SCALE,
    L_N,
    RAMP,
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
    K_SIZE,
    K_T,
    K_VA,
    K_VP,
    K_VV,
    coefficients,
    step_size,
)
from companion.smoothing.transition import add_noise, decay_factors, noise_diagonal
from companion.types import F64, I64


@njit("b1(i1[::1], i8)", cache=True)
def last_of_run(kinds: I8, i: int) -> bool:
    """Whether the step ``i`` is the last one before something else, or of all."""
    return bool(i + 1 == kinds.shape[0] or kinds[i + 1] != STEP)


@njit("i8(i1[::1])", cache=True, entry=True)
def count_runs(kinds: I8) -> int:
    """How many runs of steps there are."""
    count = 0
    for i in range(kinds.shape[0]):
        count += kinds[i] == STEP and last_of_run(kinds, i)
    return int(count)


@njit("void(f8[::1], i8[::1], f8[::1], i8, f8[::1])", cache=True, counted=False)
def _rows_of_phi(K: F64, lay: I64, X: F64, cols: int, Y: F64) -> None:
    """Rows p, v, φ of Φ, ``K`` as phi.py has it, times ``cols`` columns of ``X``, into ``Y``.

    Both flat in rows of STRIDE, for the sake of vector code.
    """
    i_sa, i_sg = lay[L_ACCEL_SCALE], lay[L_GYRO_SCALE]
    T = K[K_T]
    half, third = 0.5 * T, T / 3.0
    pa, pb, pc, pd, pe = K[K_PP], K[K_PP + 1], K[K_PP + 2], K[K_PP + 3], K[K_PP + 4]
    px, py, pz = K[K_PA], K[K_PA + 1], K[K_PA + 2]
    vx, vy, vz = K[K_VA], K[K_VA + 1], K[K_VA + 2]
    wx, wy, wz = K[K_AA], K[K_AA + 1], K[K_AA + 2]
    va, vb, vc, vd = K[K_VV], K[K_VV + 1], K[K_VV + 2], K[K_VV + 3]
    ve, vf, vg, vh = K[K_VV + 4], K[K_VV + 5], K[K_VV + 6], K[K_VV + 7]
    g, ha, hb, hc = K[K_VP], K[K_AV], K[K_AV + 1], K[K_AV + 2]
    for j in range(cols):
        p0, p1, p2 = X[j], X[STRIDE + j], X[2 * STRIDE + j]
        v0, v1, v2 = X[3 * STRIDE + j], X[4 * STRIDE + j], X[5 * STRIDE + j]
        a0, a1, a2 = X[6 * STRIDE + j], X[7 * STRIDE + j], X[8 * STRIDE + j]
        Y[j] = (pa * p0 + pb * p2 + T * v0) + (pz * a1 - py * a2)
        Y[STRIDE + j] = (pc * p0 + pd * p1 + pe * p2 + T * v1) + (px * a2 - pz * a0)
        Y[2 * STRIDE + j] = (p2 + T * v2) + (py * a0 - px * a1)
        Y[3 * STRIDE + j] = (va * v0 + vb * v1 + vc * v2) + (vz * a1 - vy * a2)
        Y[4 * STRIDE + j] = (vd * v0 + ve * v1 + vf * v2) + (vx * a2 - vz * a0)
        Y[5 * STRIDE + j] = (g * p2 + vg * v0 + vh * v1 + v2) + (vy * a0 - vx * a1)
        Y[6 * STRIDE + j] = a0 + wz * a1 - wy * a2 + ha * v1
        Y[7 * STRIDE + j] = a1 + wx * a2 - wz * a0 + hb * v0
        Y[8 * STRIDE + j] = a2 + wy * a0 - wx * a1 + hc * v1
    for at, block, to_pos, to_vel, to_att in (
        (ACCEL_BIAS, K_C, half, 1.0, 0.0),
        (GYRO_BIAS, K_D, third, 1.0, 0.0),
        (GYRO_BIAS, K_C, 0.0, 0.0, 1.0),
        (i_sa, K_S, half, 1.0, 0.0),
        (i_sg, K_R, third, 1.0, 0.0),
        (i_sg, K_Q, 0.0, 0.0, 1.0),
    ):
        if at < 0:
            continue
        for i in range(3):
            k0, k1, k2 = K[block + 3 * i], K[block + 3 * i + 1], K[block + 3 * i + 2]
            pos, vel, att = Y[i * STRIDE :], Y[(3 + i) * STRIDE :], Y[(6 + i) * STRIDE :]
            x0, x1, x2 = X[at * STRIDE :], X[(at + 1) * STRIDE :], X[(at + 2) * STRIDE :]
            if to_att == 0.0:
                for j in range(cols):
                    u = k0 * x0[j] + k1 * x1[j] + k2 * x2[j]
                    pos[j] += to_pos * u
                    vel[j] += to_vel * u
            else:
                for j in range(cols):
                    att[j] += k0 * x0[j] + k1 * x1[j] + k2 * x2[j]


@njit("void(f8[::1], i8[::1], f8, f8[::1], f8[:, ::1], f8[:, ::1])", cache=True, counted=False)
def _carry(K: F64, lay: I64, T: float, d: F64, P: F64, W: F64) -> None:
    """``P`` (n, STRIDE) ← D Φ P Φᵀ D over ``T`` [s]; ``W`` (n + 9, STRIDE) is scratch."""
    n = lay[L_N]
    X, Y = W[:n], W[n:]
    # Whole vectors of four: what is in the columns behind is never looked at.
    _rows_of_phi(K, lay, P.reshape(-1), (n + 3) // 4 * 4, Y.reshape(-1))
    for k in range(n):
        for j in range(9):
            X[k, j] = Y[j, k]
    for i in range(9):
        for j in range(9, n):
            P[i, j] = P[j, i] = Y[i, j]
    _rows_of_phi(K, lay, X.reshape(-1), 12, Y.reshape(-1))
    for i in range(9):
        for j in range(i + 1):
            P[i, j] = P[j, i] = Y[i, j]
    clock = lay[L_CLOCK]
    if clock >= 0:
        # Φ of the clock from both sides, as receiver_clock.carry_clock.
        half = 0.5 * T * T
        for j in range(n):
            P[clock, j] += T * P[clock + DRIFT, j] + half * P[clock + RAMP, j]
            P[clock + DRIFT, j] += T * P[clock + RAMP, j]
        for j in range(n):
            P[j, clock] += T * P[j, clock + DRIFT] + half * P[j, clock + RAMP]
            P[j, clock + DRIFT] += T * P[j, clock + RAMP]
    for i in range(9, n):
        if d[i] != 1.0:
            for j in range(n):
                P[i, j] *= d[i]
            for j in range(n):
                P[j, i] *= d[i]


@njit("void(f8[::1], f8[::1], i8)", cache=True, counted=False)
def _less(P: F64, gain: F64, n: int) -> None:
    """``P`` (n · STRIDE,) ← P − ``gain`` ``gain``ᵀ."""
    for j in range(n):
        g = gain[j]
        row = P[j * STRIDE :]
        for k in range(n):
            row[k] -= g * gain[k]


@njit(
    "void(i1[::1], f4[::1], f8[::1], i8[::1], f8[::1], f8[::1], f8[:, ::1], f8[:, :, ::1],"
    "f8[:, :, ::1], f8[:, :, ::1])",
    cache=True,
    entry=True,
)
def covariances(
    kinds: I8,
    coarse: F32,
    fine: F64,
    lay: I64,
    par: F64,
    s: F64,
    P: F64,
    before: F64,
    foreseen: F64,
    at_rows: F64,
) -> None:
    """Walk ``P`` (n, n) over a chunk, in place.

    For each run of steps without anything between them, ``before`` gets P (n, n) in front of it and
    ``foreseen`` P⁻ behind it; ``at_rows`` gets P at each output row. Any may be without room, and
    stays so. ``s`` is scratch with the Earth's rate in place.
    """
    n = lay[L_N]
    size = step_size(lay)
    B, K = np.zeros((24, 3, 3)), np.zeros(K_SIZE)
    d, q, dx = np.empty(n), np.empty(n), np.zeros(n)
    A, W = np.zeros((n, STRIDE)), np.zeros((n + 9, STRIDE))
    A[:, :n] = P
    c, f, m, row = 0, 0, 0, 0
    inside = False
    runs, rows = before.shape[0] > 0, at_rows.shape[0] > 0
    for i in range(kinds.shape[0]):
        kind = kinds[i]
        if kind == STEP:
            if runs and not inside:
                before[m] = A[:, :n]
            inside = not last_of_run(kinds, i)
            numbers, T = coarse[c : c + C_STEP], float(fine[f])
            coefficients(numbers, fine[f : f + size], lay, s, B, K)
            decay_factors(T, lay, par, d)
            _carry(K, lay, T, d, A, W)
            noise_diagonal(numbers, T, lay, par, d, q)
            add_noise(numbers, T, lay, par, q, A)
            c += C_STEP
            f += size
            if runs and not inside:
                foreseen[m] = A[:, :n]
                m += 1
        elif kind >= UPDATE:
            _less(A.reshape(-1), fine[f + F_GAIN : f + F_GAIN + n], n)
            f += F_GAIN + n + kind - UPDATE
        elif kind == TURN:
            for j in range(3):
                dx[ATT + j] = fine[f + j]
            reset_covariance(A, dx, n)
            f += F_TURN
        elif kind == FADE:
            A *= fine[f]
            f += F_FADE
        elif rows:
            at_rows[row] = A[:, :n]
            row += 1
    P[:] = A[:, :n]
