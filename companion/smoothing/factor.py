"""Λ as the product of the few columns that the last updates made, before there are many.

    Λ = A Aᵀ :   at an update  A ← [ (I − K H)ᵀ A , Hᵀ/√S ] ,   between  A ← Φᵀ A

An update adds a column, and nothing but columns is carried back: a window of one update interval
holds a handful. P − (P A)(P A)ᵀ is never above P. With more of them than there is room for, Λ
itself is shorter (composite.py, whose ``X`` holds the columns of A here, and λ in its own).
"""

from __future__ import annotations

import math

from companion._jit import njit
from companion.estimation.covariance import STRIDE
from companion.estimation.tape import F_GAIN, F_R, F_Y, TURN, UPDATE, read_h
from companion.navigation.layout import ATT
from companion.smoothing.composite import LAM, WIDTH
from companion.types import F64

MOST = LAM
"""Columns that there is room for."""


@njit("void(i8, f8[::1], i8, f8[::1], i8, f8[::1], f8[::1])", cache=True, counted=False)
def take_columns_back(kind: int, record: F64, n: int, X: F64, count: int, H: F64, g: F64) -> None:
    """λ and ``count`` columns, fewer than MOST, back over an update, turn or fade on the tape.

    An update puts its own into the column behind them. ``H`` (n,), ``g`` (≥ WIDTH,) are scratch.
    """
    if kind >= UPDATE:
        r = record[F_R]
        for j in range(WIDTH):
            g[j] = 0.0
        for i in range(n):
            gain = r * record[F_GAIN + i]
            row = X[i * WIDTH :]
            for j in range(WIDTH):
                g[j] += gain * row[j]
        g[LAM] += r * r * record[F_Y]
        read_h(record, n, H)
        for i in range(n):
            h = H[i]
            if h != 0.0:
                row = X[i * WIDTH :]
                for j in range(WIDTH):
                    row[j] -= h * g[j]
            X[i * WIDTH + count] = r * h
    elif kind == TURN:
        # As bryson_frazier.turn_transposed, on all columns.
        x, y, z = 0.5 * record[0], 0.5 * record[1], record[2]
        r0, r1, r2 = X[ATT * WIDTH :], X[(ATT + 1) * WIDTH :], X[(ATT + 2) * WIDTH :]
        for j in range(WIDTH):
            a, b, c = r0[j], r1[j], r2[j]
            r0[j] = a + z * b - y * c
            r1[j] = b - z * a + x * c
            r2[j] = c + y * a - x * b
    else:
        root = math.sqrt(record[0])
        for i in range(n):
            for j in range(MOST):
                X[i * WIDTH + j] *= root
            X[i * WIDTH + LAM] *= record[0]


@njit("void(f8[::1], i8, f8[::1])", cache=True, counted=False)
def multiply_out(X: F64, n: int, Lam: F64) -> None:
    """``Lam`` (n · STRIDE,) ← A Aᵀ, and no columns any more."""
    Lam[:] = 0.0
    for i in range(n):
        for j in range(i + 1):
            x = 0.0
            for k in range(MOST):
                x += X[i * WIDTH + k] * X[j * WIDTH + k]
            Lam[i * STRIDE + j] = Lam[j * STRIDE + i] = x
    for i in range(n):
        for k in range(MOST):
            X[i * WIDTH + k] = 0.0


@njit("void(f8[::1], f8[::1], i8, f8[::1], f8[::1], f8[::1])", cache=True, counted=False)
def smoothed_by_columns(P: F64, X: F64, n: int, M: F64, dx: F64, out: F64) -> None:
    """``dx`` (n,) ← −P λ and ``out`` (30,) the published blocks of P − (P A)(P A)ᵀ.

    ``P`` (n · STRIDE,); ``M`` (≥ n · WIDTH,) is scratch.
    """
    for i in range(n):
        m = M[i * WIDTH :]
        for j in range(WIDTH):
            m[j] = 0.0
        for k in range(n):
            g = P[i * STRIDE + k]
            row = X[k * WIDTH :]
            for j in range(WIDTH):
                m[j] += g * row[j]
        dx[i] = -m[LAM]
    at = 0
    for block in range(5):
        for i in range(3 * block, 3 * block + 3):
            for j in range(i, 3 * block + 3):
                x = P[i * STRIDE + j]
                for k in range(MOST):
                    x -= M[i * WIDTH + k] * M[j * WIDTH + k]
                out[at] = x
                at += 1
