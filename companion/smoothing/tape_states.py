"""The forward run's optional states and covariances at the output rows, read off its tape."""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.estimation.recording import Chunk
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
)
from companion.navigation import layout as lo
from companion.smoothing.transition import decay_factors
from companion.types import F64, I64


@njit(
    "void(i1[::1], f4[::1], f8[::1], i8, i8[::1], f8[::1], f8[::1], f8[:, ::1], f4[:, ::1])",
    cache=True,
    entry=True,
)
def _read(
    kinds: I8,
    coarse: F32,
    fine: F64,
    triangle: int,
    lay: I64,
    par: F64,
    x: F64,
    rows: F64,
    P: F32,
) -> None:
    """Follow the estimates ``x`` (n,) through a chunk; fill ``rows`` (rows, n) and ``P``."""
    n = lay[lo.L_N]
    size = F_STEP_WITH_SCALE if lay[lo.L_ACCEL_SCALE] >= 0 else F_STEP
    d = np.empty(n)
    c, f, row = 0, 0, 0
    for i in range(kinds.shape[0]):
        kind = kinds[i]
        if kind == STEP:
            decay_factors(float(fine[f]), lay, par, d)
            for j in range(n):
                x[j] *= d[j]
            c += C_STEP
            f += size
        elif kind >= UPDATE:
            y = fine[f + F_R] * fine[f + F_Y]
            for j in range(n):
                x[j] += fine[f + F_GAIN + j] * y
            f += F_GAIN + n + kind - UPDATE
        elif kind == TURN:
            f += F_TURN
        elif kind == FADE:
            f += F_FADE
        else:
            for j in range(n):
                rows[row, j] = x[j]
            for j in range(triangle):
                P[row, j] = coarse[c + j]
            row += 1
            c += triangle


def optional(s: F64, lay: I64) -> F64:
    """(..., n) the optional states of filter states (..., ≥ GNSS_BIAS + 3); zero for the core."""
    x = np.zeros((*s.shape[:-1], int(lay[lo.L_N])))
    for index, start, size in (
        (lo.L_ACCEL_SCALE, lo.ACCEL_SCALE_B, 3),
        (lo.L_GYRO_SCALE, lo.GYRO_SCALE_B, 3),
        (lo.L_LEVER, lo.LEVER_B, 3),
        (lo.L_BARO, lo.BARO_BIAS, 1),
        (lo.L_GNSS, lo.GNSS_BIAS, 3),
    ):
        at = int(lay[index])
        if at >= 0:
            x[..., at : at + size] = s[..., start : start + size]
    return x


def states_at_rows(chunk: Chunk, lay: I64, par: F64) -> tuple[F64, F32]:
    """Optional states (rows, n), zero for the core, and upper triangles of P (rows, …).

    The tape must carry P with its rows.
    """
    n = int(lay[lo.L_N])
    triangle = n * (n + 1) // 2
    x = optional(chunk.s, lay)
    # In feedforward mode the estimate is the INS's, which never moves, and the carried error.
    x[lo.CORE_STATES :] += chunk.s[lo.DX + lo.CORE_STATES : lo.DX + n]
    rows = np.empty((len(chunk.t_ns), n))
    P = np.empty((len(rows), triangle), np.float32)
    _read(chunk.kinds, chunk.coarse, chunk.fine, triangle, lay, par, x, rows, P)
    rows[:, : lo.CORE_STATES] = 0.0
    return rows, P


def covariance_at_rows(chunk: Chunk, lay: I64, par: F64) -> F32:
    """Upper triangles of P (rows, n (n + 1) / 2) on a tape that carries them, whole or not."""
    n = int(lay[lo.L_N])
    if len(chunk.fine) == 0:  # rows are all there is
        return chunk.coarse.reshape(-1, n * (n + 1) // 2)
    return states_at_rows(chunk, lay, par)[1]
