"""Bryson-Frazier over the last few update intervals of a running tape.

    δx = −P λ̂ ,   P_s = P − P Λ̂ P

with λ and Λ zero at the newest fix, taken back to the oldest interval (see bryson_frazier.py for
the recursions). The rows of that interval hold P, so nothing else has to be walked. Λ is a product
of columns as long as these are few (factor.py).

Duong & Chiang 2012, section 3 (there with RTS): smoothing from each update back over ``n_up``
intervals, given out in forward order of time.
"""

from __future__ import annotations

from companion._jit import njit
from companion.estimation.covariance import STRIDE
from companion.estimation.output_row import O_COV, ROW_SIZE
from companion.estimation.tape import (
    C_STEP,
    COARSE,
    F32,
    F_FADE,
    F_GAIN,
    F_TIME,
    F_TURN,
    FADE,
    FINE,
    FIX,
    FULL_ROW,
    I8,
    KIND,
    PLAIN_ROW,
    STEP,
    TURN,
    UPDATE,
    read_time,
)
from companion.navigation.layout import L_N
from companion.smoothing.composite import (
    LAM,
    S_D,
    S_DECAY,
    S_DX,
    S_H,
    S_K,
    S_LAM,
    S_P,
    S_U,
    S_V,
    S_X,
    WIDTH,
    begin,
    flush,
    smoothed_blocks,
    step_back,
    take_back,
)
from companion.smoothing.correction import correct
from companion.smoothing.factor import (
    MOST,
    multiply_out,
    smoothed_by_columns,
    take_columns_back,
)
from companion.smoothing.phi import K_SIZE, coefficients, step_size
from companion.smoothing.transition import decay_factors
from companion.types import F64, I64, Flags

BROKEN = -1


@njit("i8(i8, i8, i8)", cache=True, counted=False)
def numbers_of(kind: int, n: int, step: int) -> int:
    """How many numbers a record has in ``fine``; ``step`` those of a step."""
    if kind == STEP:
        return step
    if kind >= UPDATE:
        return int(F_GAIN + n + kind - UPDATE)
    if kind == TURN:
        return F_TURN
    if kind == FADE:
        return F_FADE
    if kind == FIX:
        return F_TIME
    return int(F_TIME + ROW_SIZE + (n * (n + 1) // 2 if kind == FULL_ROW else 0))


@njit("void(f8[::1], i8, i8, f8[:, ::1], i8[::1], i8)", cache=True, counted=False)
def copy_row(record: F64, at: int, row: int, rows: F64, t: I64, size: int) -> None:
    """Row number ``row`` of the output from a record that lies at ``at``."""
    t[row] = read_time(record[at:])
    for j in range(size):
        rows[row, j] = record[at + F_TIME + j]


@njit("b1(f8[::1])", cache=True, counted=False)
def _sound(row: F64) -> bool:
    """Whether everything in an output row is finite and no variance negative."""
    for i in range(O_COV + 30):
        if not abs(row[i]) < 1e30:
            return False
    for block in range(5):
        at = O_COV + 6 * block
        if not (row[at] >= 0.0 and row[at + 3] >= 0.0 and row[at + 5] >= 0.0):
            return False
    return True


@njit(
    "i8(i1[::1], f4[::1], f8[::1], i8[::1], i8[::1], i8[::1], i8[::1], f8[::1], f8[::1], f8[::1],"
    "i8[::1], f8[:, ::1], b1[::1])",
    cache=True,
    counted=False,
)
def smooth_window(
    kinds: I8,
    coarse: F32,
    fine: F64,
    a: I64,
    b: I64,
    c: I64,
    lay: I64,
    par: F64,
    s: F64,
    scratch: F64,
    t: I64,
    rows: F64,
    smoothed: Flags,
) -> int:
    """Smooth the rows between ``a`` and ``b`` from everything up to ``c``, positions on the tape.

    Exactly the rows there are filled: times ``t`` (N,), output ``rows`` (N, ROW_SIZE), and which of
    them are ``smoothed`` (N,), the others being the filter's. ``s`` and ``scratch`` (composite.py)
    are scratch, the first with the Earth's rate in place. :data:`BROKEN` where something is not
    finite or a variance not positive: then the rows are of no use.
    """
    n = lay[L_N]
    step = step_size(lay)
    B = scratch[:S_D].reshape((24, 3, 3))
    d, w, D = scratch[S_D : S_D + n], scratch[S_H : S_H + n], scratch[S_DECAY : S_DECAY + n]
    dx = scratch[S_DX : S_DX + n].reshape((1, n))
    K, X = scratch[S_K : S_K + K_SIZE], scratch[S_X : S_X + n * WIDTH]
    P, Lam = scratch[S_P : S_P + n * STRIDE], scratch[S_LAM : S_LAM + n * STRIDE]
    U, V = scratch[S_U : S_U + n * STRIDE], scratch[S_V : S_V + n * STRIDE]
    X[:] = 0.0
    D[:] = 1.0
    columns, whole, pending = 0, False, False
    at_c, f, row = c[COARSE], c[FINE], t.shape[0]
    for i in range(c[KIND] - 1, a[KIND] - 1, -1):
        kind = kinds[i]
        f -= numbers_of(kind, n, step)
        if kind == STEP:
            at_c -= C_STEP
            coefficients(coarse[at_c : at_c + C_STEP], fine[f : f + step], lay, s, B, K)
            decay_factors(fine[f], lay, par, d)
            step_back(K, lay, d, X, D)
            pending = whole
            continue
        if kind == FIX or (kind < 0 and i >= b[KIND]):
            continue
        if kind == PLAIN_ROW:
            row -= 1
            copy_row(fine, f, row, rows, t, ROW_SIZE)
            smoothed[row] = False
            continue
        if pending:
            flush(X, D, Lam, lay, U, V)
            pending = False
        if kind >= UPDATE and columns == MOST and not whole:
            multiply_out(X, n, Lam)
            begin(X, lay)
            D[:] = 1.0
            whole = True
        if kind >= 0 and whole:
            take_back(kind, fine[f:], n, X, Lam, d, w)
        elif kind >= 0:
            take_columns_back(kind, fine[f:], n, X, columns, d, w)
            columns += kind >= UPDATE
        else:
            row -= 1
            copy_row(fine, f, row, rows, t, ROW_SIZE)
            at = f + F_TIME + ROW_SIZE
            for j in range(n):
                for k in range(j, n):
                    P[j * STRIDE + k] = P[k * STRIDE + j] = fine[at + k - j]
                at += n - j
            blocks = rows[row, O_COV : O_COV + 30]
            if whole:
                for j in range(n):
                    dx[0, j] = 0.0
                for k in range(n):
                    g = X[k * WIDTH + LAM]
                    for j in range(n):
                        dx[0, j] -= g * P[k * STRIDE + j]
                smoothed_blocks(P, Lam, n, V, blocks)
            else:
                smoothed_by_columns(P, X, n, V, dx[0], blocks)
            correct(rows[row : row + 1], dx, lay)
            smoothed[row] = True
            if not _sound(rows[row]):
                return BROKEN
    return int(row)
