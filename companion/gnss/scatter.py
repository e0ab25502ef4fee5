"""How far the satellites of each system scatter about an epoch's own solution.

    v_c = 1/M Σ r² / (σ² ∓ h (HᵀWH)⁻¹ hᵀ),   ν_c = Σ (1 − h (HᵀWH)⁻¹ hᵀ / σ²)

over the M satellites of a system: 1 where its ranges are as good as they are taken to be. ν is its
share of the redundancy (variance components by groups of observations: Förstner 1979). The minus
is of satellites in the solution, the plus of those left out of it, which count as well: a system
that has become noisy loses satellites to the test of faults. The largest term counts as the second
largest does, so that a single satellite at fault makes no system noisy; what that takes off on
average is put back. No inertial unit is in it: a manoeuvre is not taken for noise.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from companion._jit import njit
from companion.gnss.corrected import (
    S_RANGE,
    S_RANGE_VAR,
    S_RATE,
    S_RATE_VAR,
    S_SYSTEM,
    expected_range,
    line_of_sight,
    range_rate,
)
from companion.gnss.geometry import geodetic, invert_spd
from companion.gnss.single_point import P_CLOCK, P_POS, P_RATE, P_VEL
from companion.gnss.systems import SYSTEMS
from companion.types import F64, I64, SATELLITES

LEAST_REDUNDANCY = 0.05
"""Of a measurement that is to say something of its own error."""
SUSPECT = 9.0
"""Normalised square from which on the worst satellite is left out of what the rest is judged by."""
_STEP = 0.02


@cache
def trimmed_mean() -> F64:
    """(SATELLITES + 1,) mean of M squared deviates, the largest counting as the second largest.

    1 − ∫ F^(M−1) (1 − F) dx with F the distribution of χ² with one degree of freedom.
    """
    x = _STEP * (np.arange(2000) + 0.5)
    F = np.array([math.erf(math.sqrt(0.5 * one)) for one in x.tolist()])
    powers = np.arange(SATELLITES + 1)[:, None] - 1
    powers[0] = 0
    return np.asarray(1.0 - (F**powers * (1.0 - F)).sum(axis=1) * _STEP)


@njit("b1(f8[::1], b1, f8[::1], f8[::1], i8[::1], f8[::1], f8[::1])", cache=True)
def _line(
    row: F64, rate: bool, point: F64, here: F64, column: I64, h: F64, y_var: F64
) -> bool:  # fmt: skip
    """One row's residual and variance ``y_var`` (2,), line ``h`` (8,); False where it has none."""
    u = np.empty(3)
    x, v = point[P_POS : P_POS + 3], point[P_VEL : P_VEL + 3]
    k = column[int(row[S_SYSTEM])]
    if k < 0:
        return False
    if rate:
        line_of_sight(row, x[0], x[1], x[2], u)
        y_var[0] = row[S_RATE] - range_rate(row, u, x, v) - point[P_RATE]
        y_var[1] = row[S_RATE_VAR]
    else:
        clock = point[P_CLOCK + int(row[S_SYSTEM])]
        y_var[0] = row[S_RANGE] - expected_range(row, x, here, u) - clock
        y_var[1] = row[S_RANGE_VAR]
    for i in range(8):
        h[i] = -u[i] if i < 3 else 0.0
    h[k] = 1.0
    return bool(y_var[0] == y_var[0])


@njit("f8(f8[::1], i8, f8[:, ::1], f8[::1], f8[::1], b1)", cache=True)
def _share(h: F64, n: int, N: F64, y_var: F64, lean: F64, inside: bool) -> float:
    """Variance of a residual in that of its measurement; the residual moves by ``lean``."""
    leverage = 0.0
    for i in range(n):
        y_var[0] -= h[i] * lean[i]
        for j in range(n):
            leverage += h[i] * N[i, j] * h[j]
    return float(1.0 - leverage / y_var[1] if inside else 1.0 + leverage / y_var[1])


@njit(
    "void(f8[:, ::1], i8, i8[::1], b1, f8[::1], f8[::1], i8[::1], i8, f8[:, ::1], f8[::1])",
    cache=True,
)
def _leave_out_worst(
    rows: F64, m: int, used: I64, rate: bool, point: F64, here: F64, column: I64, n: int, N: F64,
    lean: F64,
) -> None:  # fmt: skip
    """Take the satellite that fits worst out of the solution, if it fits badly.

    ``N`` becomes the covariance without it, ``lean`` (9,) the way of the solution, and whose row it
    is, −1 for none. What it pulled the others by is no noise of theirs.
    """
    h, y_var, worst, least = np.empty(8), np.empty(2), -1, SUSPECT
    lean[:] = 0.0
    for s in range(m):
        if used[s] == 1 and _line(rows[s], rate, point, here, column, h, y_var):
            share = _share(h, n, N, y_var, lean, True)
            if share >= LEAST_REDUNDANCY and y_var[0] * y_var[0] / (share * y_var[1]) > least:
                worst, least = s, y_var[0] * y_var[0] / (share * y_var[1])
    lean[8] = worst
    if worst < 0:
        return
    _line(rows[worst], rate, point, here, column, h, y_var)
    gain = np.zeros(8)
    for i in range(n):
        for j in range(n):
            gain[i] += N[i, j] * h[j]
    left = y_var[1]
    for i in range(n):
        left -= h[i] * gain[i]
    for i in range(n):
        lean[i] = -gain[i] * y_var[0] / left
        for j in range(n):
            N[i, j] += gain[i] * gain[j] / left


@njit("void(f8[:, ::1], i8, i8[::1], f8[::1], f8[::1], f8[:, :, ::1])", cache=True, entry=True)
def scatter(rows: F64, m: int, used: I64, point: F64, expected: F64, found: F64) -> None:
    """Fill ``found`` (2, SYSTEMS, 2) of range and rate: v·ν and ν of each system, zeros without.

    ``rows``, ``m``, ``used``, ``point`` as :func:`companion.gnss.single_point.solve` left them;
    ``expected``: of :func:`trimmed_mean`.
    """
    here, h, y_var, lean = np.empty(3), np.empty(8), np.empty(2), np.empty(9)
    N, column = np.empty((8, 8)), np.empty(SYSTEMS, np.int64)
    geodetic(point[P_POS], point[P_POS + 1], point[P_POS + 2], here)
    found[:, :, :] = 0.0
    for kind in range(2):
        rate = kind == 1
        n = 4 if rate else 3
        for c in range(SYSTEMS):
            column[c] = 3 if rate else -1
            if not rate and point[P_CLOCK + c] == point[P_CLOCK + c]:
                column[c] = n
                n += 1
        N[:, :] = 0.0
        for s in range(m):
            if used[s] == 1 and _line(rows[s], rate, point, here, column, h, y_var):
                for i in range(n):
                    for j in range(n):
                        N[i, j] += h[i] * h[j] / y_var[1]
        if not invert_spd(N, n):
            continue
        _leave_out_worst(rows, m, used, rate, point, here, column, n, N, lean)
        for c in range(SYSTEMS):
            total, largest, second, dof, count = 0.0, 0.0, 0.0, 0.0, 0
            for s in range(m):
                if int(rows[s, S_SYSTEM]) != c:
                    continue
                if not _line(rows[s], rate, point, here, column, h, y_var):
                    continue
                share = _share(h, n, N, y_var, lean, used[s] == 1 and s != int(lean[8]))
                if share < LEAST_REDUNDANCY:
                    continue
                e = y_var[0] * y_var[0] / (share * y_var[1])
                total += e
                count += 1
                dof += min(share, 1.0)
                if e > largest:
                    largest, second = e, largest
                elif e > second:
                    second = e
            if count >= 2:
                mean = (total - largest + second) / (count * expected[count])
                found[kind, c, 0], found[kind, c, 1] = mean * dof, dof
