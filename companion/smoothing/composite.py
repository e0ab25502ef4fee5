"""Λ over several steps at once: their transitions are multiplied, then Λ is taken through.

    Ψ = Φ_m … Φ_1 ,   Λ̂ = Ψᵀ Λ̃ Ψ

Nothing between two events (updates, output rows) asks for Λ. To multiply a Φ by its blocks costs a
fourth of taking the symmetric matrix through it. Ψ is the identity but for its rows p, v, φ and the
decays on the diagonal, so of Ψᵀ nine columns are kept; the vector λ rides along as the tenth; a
receiver's clock has two columns of its own.

Everything is flat with constant row lengths: with distances that it knows, the compiler makes
vector code of the inner loops.
"""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.estimation.covariance import STRIDE
from companion.estimation.tape import F_GAIN, F_R, F_Y, FADE, TURN, UPDATE, read_h
from companion.navigation.layout import (
    ACCEL_BIAS,
    ATT,
    BIAS,
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
)
from companion.types import F64, I64

WIDTH = 12
"""Columns of ``X``: nine of Ψᵀ, two for a receiver's clock, and λ, which fill a vector."""
OF_PSI = 9
OF_BIAS, OF_DRIFT = 9, 10
"""Columns of Ψᵀ for the receiver's clock, where there is one."""
LAM = 11
"""Column of λ."""

# --- entries of the scratch that the smoothers' kernels are given, which make no arrays themselves:
# blocks of Φ, lines, Φ as phi.py has it, X, matrices in rows of STRIDE
S_BLOCKS, S_D, S_H, S_DECAY, S_DX = 0, 216, 216 + STRIDE, 216 + 2 * STRIDE, 216 + 3 * STRIDE
S_K = S_DX + STRIDE
S_X = S_K + K_SIZE
S_P, S_LAM, S_U, S_V = (S_X + STRIDE * WIDTH + i * STRIDE * STRIDE for i in range(4))
SCRATCH = S_V + STRIDE * STRIDE


def scratch() -> F64:
    """Room for one smoother: zeros, as leftovers that are not numbers would be slow."""
    return np.zeros(SCRATCH)


@njit("void(f8[::1], i8[::1])", cache=True, counted=False)
def begin(X: F64, lay: I64) -> None:
    """``X`` (n · WIDTH,) ← Ψ = I; λ stays."""
    n, clock = lay[L_N], lay[L_CLOCK]
    for i in range(n):
        for j in range(OF_PSI):
            X[i * WIDTH + j] = 0.0
    for i in range(OF_PSI):
        X[i * WIDTH + i] = 1.0
    if clock >= 0:
        for i in range(9, n):
            X[i * WIDTH + OF_BIAS] = X[i * WIDTH + OF_DRIFT] = 0.0
        X[(clock + BIAS) * WIDTH + OF_BIAS] = 1.0
        X[(clock + DRIFT) * WIDTH + OF_DRIFT] = 1.0


@njit("void(f8[::1], i8[::1], f8[::1], f8[::1], f8[::1])", cache=True, counted=False)
def step_back(K: F64, lay: I64, d: F64, X: F64, D: F64) -> None:
    """``X`` ← Φᵀ diag(d) ``X`` and ``D`` ← ``D`` ∘ d: one step further back.

    ``K``: Φ as phi.py has it; ``D`` (n,): the decays so far.
    """
    n, i_sa, i_sg = lay[L_N], lay[L_ACCEL_SCALE], lay[L_GYRO_SCALE]
    T = K[K_T]
    half, third = 0.5 * T, T / 3.0
    for i in range(15, n):
        if d[i] != 1.0:
            D[i] *= d[i]
            row = X[i * WIDTH :]
            for j in range(WIDTH):
                row[j] *= d[i]
    if i_sa >= 0:
        for at, block, up, part in (
            (i_sa, K_S, 0, half), (i_sa, K_S, 3, 1.0),
            (i_sg, K_R, 0, third), (i_sg, K_R, 3, 1.0), (i_sg, K_Q, 6, 1.0),
        ):  # fmt: skip
            for i in range(3):
                row = X[(at + i) * WIDTH :]
                for k in range(3):
                    g = part * K[block + 3 * k + i]
                    own = X[(up + k) * WIDTH :]
                    for j in range(WIDTH):
                        row[j] += g * own[j]
    if lay[L_CLOCK] >= 0:
        # As receiver_clock.carry_clock_back, on all columns.
        bias = X[(lay[L_CLOCK] + BIAS) * WIDTH :]
        drift, ramp = X[(lay[L_CLOCK] + DRIFT) * WIDTH :], X[(lay[L_CLOCK] + RAMP) * WIDTH :]
        for j in range(WIDTH):
            ramp[j] += 0.5 * T * T * bias[j] + T * drift[j]
            drift[j] += T * bias[j]
    for i in range(ACCEL_BIAS, GYRO_BIAS + 3):
        D[i] *= d[i]
    da, dg = d[ACCEL_BIAS], d[GYRO_BIAS]
    pa, pb, pc = K[K_PP], K[K_PP + 1], K[K_PP + 2]
    pd, pe, g = K[K_PP + 3], K[K_PP + 4], K[K_VP]
    px, py, pz = K[K_PA], K[K_PA + 1], K[K_PA + 2]
    va, vb, vc = K[K_VV], K[K_VV + 1], K[K_VV + 2]
    vd, ve, vf = K[K_VV + 3], K[K_VV + 4], K[K_VV + 5]
    vg, vh = K[K_VV + 6], K[K_VV + 7]
    vx, vy, vz = K[K_VA], K[K_VA + 1], K[K_VA + 2]
    c0, c1, c2 = K[K_C], K[K_C + 1], K[K_C + 2]
    c3, c4, c5 = K[K_C + 3], K[K_C + 4], K[K_C + 5]
    c6, c7, c8 = K[K_C + 6], K[K_C + 7], K[K_C + 8]
    d0, d1, d2 = K[K_D], K[K_D + 1], K[K_D + 2]
    d3, d4, d5 = K[K_D + 3], K[K_D + 4], K[K_D + 5]
    d6, d7, d8 = K[K_D + 6], K[K_D + 7], K[K_D + 8]
    ha, hb, hc = K[K_AV], K[K_AV + 1], K[K_AV + 2]
    wx, wy, wz = K[K_AA], K[K_AA + 1], K[K_AA + 2]
    for j in range(WIDTH):
        p0, p1, p2 = X[j], X[WIDTH + j], X[2 * WIDTH + j]
        v0, v1, v2 = X[3 * WIDTH + j], X[4 * WIDTH + j], X[5 * WIDTH + j]
        a0, a1, a2 = X[6 * WIDTH + j], X[7 * WIDTH + j], X[8 * WIDTH + j]
        u0, u1, u2 = v0 + half * p0, v1 + half * p1, v2 + half * p2
        X[9 * WIDTH + j] = da * X[9 * WIDTH + j] + (c0 * u0 + c3 * u1 + c6 * u2)
        X[10 * WIDTH + j] = da * X[10 * WIDTH + j] + (c1 * u0 + c4 * u1 + c7 * u2)
        X[11 * WIDTH + j] = da * X[11 * WIDTH + j] + (c2 * u0 + c5 * u1 + c8 * u2)
        u0, u1, u2 = v0 + third * p0, v1 + third * p1, v2 + third * p2
        X[12 * WIDTH + j] = dg * X[12 * WIDTH + j] + (
            (d0 * u0 + d3 * u1 + d6 * u2) + (c0 * a0 + c3 * a1 + c6 * a2)
        )
        X[13 * WIDTH + j] = dg * X[13 * WIDTH + j] + (
            (d1 * u0 + d4 * u1 + d7 * u2) + (c1 * a0 + c4 * a1 + c7 * a2)
        )
        X[14 * WIDTH + j] = dg * X[14 * WIDTH + j] + (
            (d2 * u0 + d5 * u1 + d8 * u2) + (c2 * a0 + c5 * a1 + c8 * a2)
        )
        X[j] = pa * p0 + pc * p1
        X[WIDTH + j] = pd * p1
        X[2 * WIDTH + j] = pb * p0 + pe * p1 + p2 + g * v2
        X[3 * WIDTH + j] = (T * p0 + va * v0 + vd * v1 + vg * v2) + hb * a1
        X[4 * WIDTH + j] = (T * p1 + vb * v0 + ve * v1 + vh * v2) + (ha * a0 + hc * a2)
        X[5 * WIDTH + j] = T * p2 + vc * v0 + vf * v1 + v2
        X[6 * WIDTH + j] = (py * p2 - pz * p1) + (vy * v2 - vz * v1) + (a0 + wy * a2 - wz * a1)
        X[7 * WIDTH + j] = (pz * p0 - px * p2) + (vz * v0 - vx * v2) + (a1 + wz * a0 - wx * a2)
        X[8 * WIDTH + j] = (px * p1 - py * p0) + (vx * v1 - vy * v0) + (a2 + wx * a1 - wy * a0)


@njit("void(f8[::1], f8[::1], f8[::1], i8[::1], b1, f8[::1])", cache=True, counted=False)
def _apply(X: F64, D: F64, L: F64, lay: I64, lower: bool, U: F64) -> None:
    """``U`` ← Ψᵀ ``L``, both (n · STRIDE,); with ``lower`` at least the lower half."""
    n, clock = lay[L_N], lay[L_CLOCK]
    # Whole vectors of four: what is in the columns behind is never looked at.
    wide = (n + 3) // 4 * 4
    for i in range(n):
        cols = min(wide, (i + 4) // 4 * 4) if lower else wide
        out, own = U[i * STRIDE :], L[i * STRIDE :]
        g = D[i] if i >= 9 else 0.0
        x0, x1, x2 = X[i * WIDTH], X[i * WIDTH + 1], X[i * WIDTH + 2]
        x3, x4, x5 = X[i * WIDTH + 3], X[i * WIDTH + 4], X[i * WIDTH + 5]
        x6, x7, x8 = X[i * WIDTH + 6], X[i * WIDTH + 7], X[i * WIDTH + 8]
        for j in range(cols):
            out[j] = (
                g * own[j]
                + (x0 * L[j] + x1 * L[STRIDE + j] + x2 * L[2 * STRIDE + j])
                + (x3 * L[3 * STRIDE + j] + x4 * L[4 * STRIDE + j] + x5 * L[5 * STRIDE + j])
                + (x6 * L[6 * STRIDE + j] + x7 * L[7 * STRIDE + j] + x8 * L[8 * STRIDE + j])
            )
    if clock >= 0:
        # Rows of drift and ramp; their own part, and the row of the bias, are done.
        bias, drift = L[(clock + BIAS) * STRIDE :], L[(clock + DRIFT) * STRIDE :]
        for i in (clock + DRIFT, clock + RAMP):
            of_bias = X[i * WIDTH + OF_BIAS]
            of_drift = X[i * WIDTH + OF_DRIFT] if i == clock + RAMP else 0.0
            out = U[i * STRIDE :]
            for j in range(wide):
                out[j] += of_bias * bias[j] + of_drift * drift[j]


@njit("void(f8[::1], f8[::1], f8[::1], i8[::1], f8[::1], f8[::1])", cache=True, counted=False)
def flush(X: F64, D: F64, Lam: F64, lay: I64, U: F64, V: F64) -> None:
    """``Lam`` ← Ψᵀ ``Lam`` Ψ, symmetric to the bit; then Ψ = I again.

    ``U``, ``V`` (n · STRIDE,) are scratch.
    """
    n = lay[L_N]
    _apply(X, D, Lam, lay, False, U)
    for i in range(n):
        for j in range(n):
            V[j * STRIDE + i] = U[i * STRIDE + j]
    _apply(X, D, V, lay, True, Lam)
    for i in range(n):
        for j in range(i):
            Lam[j * STRIDE + i] = Lam[i * STRIDE + j]
    begin(X, lay)
    D[:] = 1.0


@njit("void(f8[::1], f8[::1], f8[::1], f8, i8, f8[::1])", cache=True, counted=False)
def update_back(Lam: F64, H: F64, gain: F64, r: float, n: int, w: F64) -> None:
    """``Lam`` ← Hᵀ r² H + (I − K H)ᵀ Lam (I − K H) with K = ``gain`` r; ``w`` (n,) is scratch.

    λ is not touched here: its update needs the innovation.
    """
    for j in range(n):
        w[j] = 0.0
    for k in range(n):
        g = gain[k] * r
        row = Lam[k * STRIDE :]
        for j in range(n):
            w[j] += g * row[j]
    half = r * r
    for i in range(n):
        half += w[i] * gain[i] * r
    half *= 0.5
    for j in range(n):
        w[j] = half * H[j] - w[j]
    for i in range(n):
        h = H[i]
        if h != 0.0:
            row = Lam[i * STRIDE :]
            for j in range(n):
                row[j] += h * w[j]
            for j in range(n):
                Lam[j * STRIDE + i] += h * w[j]


@njit("void(f8[::1], f8[::1], f8[::1], i8)", cache=True, counted=False)
def turn_back(Lam: F64, X: F64, g: F64, n: int) -> None:
    """``Lam`` ← Gᵀ ``Lam`` G and λ ← Gᵀ λ; ``g`` corrects φ, see update.py."""
    x, y, z = 0.5 * g[0], 0.5 * g[1], g[2]
    a, b, c = X[ATT * WIDTH + LAM], X[(ATT + 1) * WIDTH + LAM], X[(ATT + 2) * WIDTH + LAM]
    X[ATT * WIDTH + LAM] = a + z * b - y * c
    X[(ATT + 1) * WIDTH + LAM] = b - z * a + x * c
    X[(ATT + 2) * WIDTH + LAM] = c + y * a - x * b
    r0, r1, r2 = Lam[ATT * STRIDE :], Lam[(ATT + 1) * STRIDE :], Lam[(ATT + 2) * STRIDE :]
    for j in range(n):
        a, b, c = r0[j], r1[j], r2[j]
        r0[j] = a + z * b - y * c
        r1[j] = b - z * a + x * c
        r2[j] = c + y * a - x * b
    for j in range(n):
        row = Lam[j * STRIDE + ATT :]
        a, b, c = row[0], row[1], row[2]
        row[0] = a + z * b - y * c
        row[1] = b - z * a + x * c
        row[2] = c + y * a - x * b
    for i in range(ATT, ATT + 3):
        for j in range(n):
            if j < ATT or j > i:
                Lam[j * STRIDE + i] = Lam[i * STRIDE + j]


@njit("void(i8, f8[::1], i8, f8[::1], f8[::1], f8[::1], f8[::1])", cache=True, counted=False)
def take_back(kind: int, record: F64, n: int, X: F64, Lam: F64, H: F64, w: F64) -> None:
    """λ, in ``X``, and ``Lam`` back over an update, turn or fade on the tape.

    ``H``, ``w`` (n,) are scratch.
    """
    if kind >= UPDATE:
        r = record[F_R]
        gain = record[F_GAIN : F_GAIN + n]
        g = r * record[F_Y]
        for j in range(n):
            g += gain[j] * X[j * WIDTH + LAM]
        g *= r
        read_h(record, n, H)
        for j in range(n):
            X[j * WIDTH + LAM] -= H[j] * g
        update_back(Lam, H, gain, r, n, w)
    elif kind == TURN:
        turn_back(Lam, X, record, n)
    elif kind == FADE:
        for j in range(n):
            X[j * WIDTH + LAM] *= record[0]
        for j in range(n * STRIDE):
            Lam[j] *= record[0]


@njit("void(f8[::1], f8[::1], i8, f8[::1], f8[::1])", cache=True, counted=False)
def smoothed_blocks(P: F64, Lam: F64, n: int, M: F64, out: F64) -> None:
    """``out`` (30,): the published blocks of P − P Λ P, upper triangles one after the other.

    ``P`` (n · STRIDE,); ``M`` (3 · STRIDE,) is scratch.
    """
    wide = (n + 3) // 4 * 4
    at = 0
    for block in range(5):
        for i in range(3):
            own, m = P[(3 * block + i) * STRIDE :], M[i * STRIDE :]
            for j in range(wide):
                m[j] = 0.0
            for k in range(n):
                g = own[k]
                row = Lam[k * STRIDE :]
                for j in range(wide):
                    m[j] += g * row[j]
        for i in range(3):
            for j in range(i, 3):
                other = P[(3 * block + j) * STRIDE :]
                x = P[(3 * block + i) * STRIDE + 3 * block + j]
                for k in range(n):
                    x -= M[i * STRIDE + k] * other[k]
                out[at] = x
                at += 1
