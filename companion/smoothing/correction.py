"""A solution in the rows of the walk, and those rows moved by an error: solution ⊞ δx."""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.estimation.output_row import O_ACCEL_BIAS, O_COV, O_GYRO_BIAS, O_LAT, O_Q, O_VEL
from companion.estimation.tape import F32
from companion.navigation import layout as lo
from companion.navigation.earth import ned_difference
from companion.navigation.error_model import box_plus
from companion.navigation.rotation import attitude_error_n
from companion.types import F64, I64, Solution

NOMINAL = O_COV
"""Columns of an output row that a smoother corrects: all before the covariance."""


@njit("void(f8[:, ::1], f8[:, ::1], i8[::1])", cache=True, entry=True)
def correct(rows: F64, dx: F64, lay: I64) -> None:
    """``rows`` (N, ≥ 16), by the ``O_`` columns of walk.py, ← rows ⊞ ``dx`` (N, n), in place."""
    s = np.zeros(lo.DX)
    for i in range(rows.shape[0]):
        for j in range(3):
            s[lo.LAT + j] = rows[i, O_LAT + j]
            s[lo.VEL_N + j] = rows[i, O_VEL + j]
            s[lo.ACCEL_BIAS_B + j] = rows[i, O_ACCEL_BIAS + j]
            s[lo.GYRO_BIAS_B + j] = rows[i, O_GYRO_BIAS + j]
        for j in range(4):
            s[lo.Q + j] = rows[i, O_Q + j]
        box_plus(s, lay, dx[i])
        for j in range(3):
            rows[i, O_LAT + j] = s[lo.LAT + j]
            rows[i, O_VEL + j] = s[lo.VEL_N + j]
            rows[i, O_ACCEL_BIAS + j] = s[lo.ACCEL_BIAS_B + j]
            rows[i, O_GYRO_BIAS + j] = s[lo.GYRO_BIAS_B + j]
        for j in range(4):
            rows[i, O_Q + j] = s[lo.Q + j]


def from_rows(rows: F64, t_ns: I64, cov: F64, mode: I64, resets: I64) -> Solution:
    """Rows (N, ≥ NOMINAL) as a solution, with columns that are views of them."""
    return Solution(
        t_ns=t_ns,
        lat=rows[:, O_LAT],
        lon=rows[:, O_LAT + 1],
        height=rows[:, O_LAT + 2],
        vel_n=rows[:, O_VEL : O_VEL + 3],
        q_nb=rows[:, O_Q : O_Q + 4],
        accel_bias_b=rows[:, O_ACCEL_BIAS : O_ACCEL_BIAS + 3],
        gyro_bias_b=rows[:, O_GYRO_BIAS : O_GYRO_BIAS + 3],
        cov=cov,
        mode=mode,
        resets=resets,
    )


def to_rows(solution: Solution) -> F64:
    """Rows (N, NOMINAL) of a solution: a copy."""
    s = solution
    return np.column_stack([s.lat, s.lon, s.height, s.vel_n, s.q_nb, s.accel_bias_b, s.gyro_bias_b])


def state_rows(nominal: F64) -> F64:
    """Rows (N, NOMINAL) of filter states (N, ≥ GYRO_BIAS_B + 3): a copy."""
    order = [
        *range(lo.LAT, lo.LAT + 3),
        *range(lo.VEL_N, lo.VEL_N + 3),
        *range(lo.Q, lo.Q + 4),
        *range(lo.ACCEL_BIAS_B, lo.GYRO_BIAS_B + 3),
    ]
    return np.ascontiguousarray(nominal[:, order])


def apart(rows: F64, origin: F64) -> F64:
    """(N, CORE_STATES) error that leads from ``origin`` to ``rows``, both (N, NOMINAL): ⊟."""
    dx = np.empty((len(rows), lo.CORE_STATES))
    place, place0 = rows[:, O_LAT : O_LAT + 3], origin[:, O_LAT : O_LAT + 3]
    dx[:, lo.POS : lo.POS + 3] = ned_difference(*place.T, *place0.T)
    dx[:, lo.ATT : lo.ATT + 3] = attitude_error_n(rows[:, O_Q : O_Q + 4], origin[:, O_Q : O_Q + 4])
    for at, column, size in ((lo.VEL, O_VEL, 3), (lo.ACCEL_BIAS, O_ACCEL_BIAS, 6)):
        part = slice(column, column + size)
        dx[:, at : at + size] = rows[:, part] - origin[:, part]
    return dx


def published_blocks(cov: F64) -> F64:
    """(N, 5, 6) as :attr:`companion.types.Solution.cov`, of whole covariances (N, n, n)."""
    blocks = [cov[:, 3 * b : 3 * b + 3, 3 * b : 3 * b + 3] for b in range(5)]
    return triangles(np.stack(blocks, axis=1))


def triangles(blocks: F64) -> F64:
    """(N, 5, 6) upper triangles of blocks (N, 5, 3, 3)."""
    i, j = np.triu_indices(3)
    return np.ascontiguousarray(blocks[:, :, i, j])


def square(triangle: F32, n: int) -> F64:
    """Covariances (N, n, n) from their upper triangles (N, n (n + 1) / 2)."""
    place = np.zeros((n, n), np.int64)
    i, j = np.triu_indices(n)
    place[i, j] = place[j, i] = np.arange(len(i))
    return np.take(triangle, place, axis=1).astype(np.float64)
