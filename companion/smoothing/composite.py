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

from companion._jit import njit
from companion.estimation.covariance import STRIDE
from companion.navigation.layout import (
    ATT,
    BIAS,
    DRIFT,
    L_ACCEL_SCALE,
    L_CLOCK,
    L_GYRO_SCALE,
    L_N,
    RAMP,
)
from companion.types import F64, I64

WIDTH = 12
"""Columns of ``X``: nine of Ψᵀ, λ, and two for a receiver's clock, which fill a vector."""
LAM = 9
"""Column of λ."""
OF_BIAS, OF_DRIFT = 10, 11
"""Columns of Ψᵀ for the receiver's clock, where there is one."""


@njit("void(f8[::1], i8[::1])", cache=True)
def begin(X: F64, lay: I64) -> None:
    """``X`` (n · WIDTH,) ← Ψ = I; λ stays."""
    n, clock = lay[L_N], lay[L_CLOCK]
    for i in range(n):
        for j in range(LAM):
            X[i * WIDTH + j] = 0.0
    for i in range(LAM):
        X[i * WIDTH + i] = 1.0
    if clock >= 0:
        for i in range(9, n):
            X[i * WIDTH + OF_BIAS] = X[i * WIDTH + OF_DRIFT] = 0.0
        X[(clock + BIAS) * WIDTH + OF_BIAS] = 1.0
        X[(clock + DRIFT) * WIDTH + OF_DRIFT] = 1.0


@njit("void(f8[:, :, ::1], i8[::1], f8, f8[::1], f8[::1], f8[::1], f8[::1])", cache=True)
def step_back(B: F64, lay: I64, T: float, d: F64, X: F64, D: F64, Y: F64) -> None:
    """``X`` ← Φᵀ diag(d) ``X`` and ``D`` ← ``D`` ∘ d: one step further back.

    ``B``: blocks of Φ over ``T`` [s]; ``D`` (n,): the decays so far; ``Y`` (9 · WIDTH,) is scratch.
    """
    n, i_sa, i_sg = lay[L_N], lay[L_ACCEL_SCALE], lay[L_GYRO_SCALE]
    for i in range(9 * WIDTH):
        Y[i] = X[i]
    for i in range(9, n):
        g = d[i]
        if g != 1.0:
            D[i] *= g
            row = X[i * WIDTH :]
            for j in range(WIDTH):
                row[j] *= g
    for i in range(3):
        a0, a1, a2 = B[3, 0, i], B[3, 1, i], B[3, 2, i]
        b0, b1, b2 = B[11, 0, i], B[11, 1, i], B[11, 2, i]
        row = X[(9 + i) * WIDTH :]
        for j in range(WIDTH):
            row[j] += (a0 * Y[j] + a1 * Y[WIDTH + j] + a2 * Y[2 * WIDTH + j]) + (
                b0 * Y[3 * WIDTH + j] + b1 * Y[4 * WIDTH + j] + b2 * Y[5 * WIDTH + j]
            )
        a0, a1, a2 = B[4, 0, i], B[4, 1, i], B[4, 2, i]
        b0, b1, b2 = B[12, 0, i], B[12, 1, i], B[12, 2, i]
        c0, c1, c2 = B[20, 0, i], B[20, 1, i], B[20, 2, i]
        row = X[(12 + i) * WIDTH :]
        for j in range(WIDTH):
            row[j] += (
                (a0 * Y[j] + a1 * Y[WIDTH + j] + a2 * Y[2 * WIDTH + j])
                + (b0 * Y[3 * WIDTH + j] + b1 * Y[4 * WIDTH + j] + b2 * Y[5 * WIDTH + j])
                + (c0 * Y[6 * WIDTH + j] + c1 * Y[7 * WIDTH + j] + c2 * Y[8 * WIDTH + j])
            )
        b0, b1, b2 = B[9, 0, i], B[9, 1, i], B[9, 2, i]
        c0, c1, c2 = B[17, 0, i], B[17, 1, i], B[17, 2, i]
        row, own = X[(3 + i) * WIDTH :], Y[i * WIDTH :]
        for j in range(WIDTH):
            row[j] = (
                T * own[j]
                + (b0 * Y[3 * WIDTH + j] + b1 * Y[4 * WIDTH + j] + b2 * Y[5 * WIDTH + j])
                + (c0 * Y[6 * WIDTH + j] + c1 * Y[7 * WIDTH + j] + c2 * Y[8 * WIDTH + j])
            )
        a0, a1, a2 = B[2, 0, i], B[2, 1, i], B[2, 2, i]
        b0, b1, b2 = B[10, 0, i], B[10, 1, i], B[10, 2, i]
        c0, c1, c2 = B[18, 0, i], B[18, 1, i], B[18, 2, i]
        row = X[(6 + i) * WIDTH :]
        for j in range(WIDTH):
            row[j] = (
                (a0 * Y[j] + a1 * Y[WIDTH + j] + a2 * Y[2 * WIDTH + j])
                + (b0 * Y[3 * WIDTH + j] + b1 * Y[4 * WIDTH + j] + b2 * Y[5 * WIDTH + j])
                + (c0 * Y[6 * WIDTH + j] + c1 * Y[7 * WIDTH + j] + c2 * Y[8 * WIDTH + j])
            )
        a0, a1, a2 = B[0, 0, i], B[0, 1, i], B[0, 2, i]
        g = B[8, 2, i]
        row = X[i * WIDTH :]
        for j in range(WIDTH):
            row[j] = a0 * Y[j] + a1 * Y[WIDTH + j] + a2 * Y[2 * WIDTH + j] + g * Y[5 * WIDTH + j]
    if i_sa >= 0:
        for at, block, up in (
            (i_sa, 5, 0), (i_sa, 13, 3), (i_sg, 6, 0), (i_sg, 14, 3), (i_sg, 22, 6),
        ):  # fmt: skip
            for i in range(3):
                row = X[(at + i) * WIDTH :]
                for k in range(3):
                    g = B[block, k, i]
                    own = Y[(up + k) * WIDTH :]
                    for j in range(WIDTH):
                        row[j] += g * own[j]
    if lay[L_CLOCK] >= 0:
        # As receiver_clock.carry_clock_back, on all columns.
        bias = X[(lay[L_CLOCK] + BIAS) * WIDTH :]
        drift, ramp = X[(lay[L_CLOCK] + DRIFT) * WIDTH :], X[(lay[L_CLOCK] + RAMP) * WIDTH :]
        for j in range(WIDTH):
            ramp[j] += 0.5 * T * T * bias[j] + T * drift[j]
            drift[j] += T * bias[j]


@njit("void(f8[::1], f8[::1], f8[::1], i8[::1], b1, f8[::1])", cache=True)
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


@njit("void(f8[::1], f8[::1], f8[::1], i8[::1], f8[::1], f8[::1])", cache=True)
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


@njit("void(f8[::1], f8[::1], f8[::1], f8, i8, f8[::1])", cache=True)
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


@njit("void(f8[::1], f8[::1], f8[::1], i8)", cache=True)
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


@njit("void(f8[::1], f8[::1], i8, f8[::1], f8[::1])", cache=True)
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
