"""The forward run's optional states and covariances at the output rows, of its tape."""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.estimation.recording import Chunk
from companion.estimation.tape import (
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
from companion.navigation import layout as lo
from companion.smoothing.correction import square
from companion.smoothing.covariances import covariances
from companion.smoothing.phi import step_size
from companion.smoothing.transition import decay_factors
from companion.types import F64, I64


@njit(
    "void(i1[::1], f8[::1], i8[::1], f8[::1], f8[::1], f8[:, ::1])",
    cache=True,
    entry=True,
)
def _read(
    kinds: I8,
    fine: F64,
    lay: I64,
    par: F64,
    x: F64,
    rows: F64,
) -> None:
    """Follow the estimates ``x`` (n,) through a chunk; fill ``rows`` (rows, n)."""
    n = lay[lo.L_N]
    size = step_size(lay)
    d = np.empty(n)
    f, row = 0, 0
    for i in range(kinds.shape[0]):
        kind = kinds[i]
        if kind == STEP:
            decay_factors(float(fine[f]), lay, par, d)
            for j in range(n):
                x[j] *= d[j]
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
            row += 1


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


def states_at_rows(chunk: Chunk, lay: I64, par: F64) -> F64:
    """Optional states (rows, n), zero for the core."""
    n = int(lay[lo.L_N])
    x = optional(chunk.s, lay)
    # In feedforward mode the estimate is the INS's, which never moves, and the carried error.
    x[lo.CORE_STATES :] += chunk.s[lo.DX + lo.CORE_STATES : lo.DX + n]
    rows = np.empty((len(chunk.t_ns), n))
    _read(chunk.kinds, chunk.fine, lay, par, x, rows)
    rows[:, : lo.CORE_STATES] = 0.0
    return rows


def covariance_at_rows(chunk: Chunk, lay: I64, par: F64) -> F64:
    """Covariances (rows, n, n), from a tape of rows alone or walked again over a whole one."""
    n = int(lay[lo.L_N])
    if len(chunk.fine) == 0:  # rows are all there is
        return square(chunk.coarse.reshape(-1, n * (n + 1) // 2), n)
    none, rows = np.zeros((0, n, n)), np.empty((len(chunk.t_ns), n, n))
    P, s = chunk.s[lo.P :].reshape(n, n).copy(), chunk.s.copy()
    covariances(chunk.kinds, chunk.coarse, chunk.fine, lay, par, s, P, none, none, rows)
    return rows
