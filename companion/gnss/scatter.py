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


@njit(
    "void(f8[:, ::1], i8, b1, f8[::1], i8[::1], f8[:, ::1], f8[:, ::1])",
    cache=True,
)
def _lines(
    rows: F64, m: int, rate: bool, point: F64, column: I64, h: F64, y_var: F64
) -> None:  # fmt: skip
    """Lines ``h`` (m, 8), residuals and variances ``y_var`` (m, 2); NaN where a row has none."""
    u, here = np.empty(3), np.empty(3)
    x, v = point[P_POS : P_POS + 3], point[P_VEL : P_VEL + 3]
    geodetic(x[0], x[1], x[2], here)
    for s in range(m):
        row = rows[s]
        system = int(row[S_SYSTEM])
        y_var[s, 0] = np.nan
        if column[system] < 0:
            continue
        if rate:
            line_of_sight(row, x[0], x[1], x[2], u)
            y_var[s, 0] = row[S_RATE] - range_rate(row, u, x, v) - point[P_RATE]
            y_var[s, 1] = row[S_RATE_VAR]
        else:
            y_var[s, 0] = row[S_RANGE] - expected_range(row, x, here, u) - point[P_CLOCK + system]
            y_var[s, 1] = row[S_RANGE_VAR]
        for i in range(8):
            h[s, i] = -u[i] if i < 3 else 0.0
        h[s, column[system]] = 1.0


@njit("f8(f8[::1], i8, f8[:, ::1], f8, b1)", cache=True)
def _share(h: F64, n: int, N: F64, var: float, inside: bool) -> float:
    """Variance of a residual in that of its measurement."""
    leverage = 0.0
    for i in range(n):
        for j in range(n):
            leverage += h[i] * N[i, j] * h[j]
    return float(1.0 - leverage / var if inside else 1.0 + leverage / var)


@njit("i8(i8, i8[::1], f8[:, ::1], f8[:, ::1], i8, f8[:, ::1])", cache=True)
def _leave_out_worst(m: int, used: I64, h: F64, y_var: F64, n: int, N: F64) -> int:
    """Take the satellite that fits worst out of the solution, if it fits badly; its row, or −1.

    ``N`` becomes the covariance without it, and residuals those about the solution without it: what
    it pulled the others by is no noise of theirs.
    """
    worst, least = -1, SUSPECT
    for s in range(m):
        y, var = y_var[s, 0], y_var[s, 1]
        # Fits well whatever its leverage: most are cleared by this.
        if used[s] == 1 and y * y > SUSPECT * LEAST_REDUNDANCY * var:
            share = _share(h[s], n, N, var, True)
            if share >= LEAST_REDUNDANCY and y * y > least * share * var:
                worst, least = s, y * y / (share * var)
    if worst < 0:
        return worst
    gain, left = np.zeros(8), y_var[worst, 1]
    for i in range(n):
        for j in range(n):
            gain[i] += N[i, j] * h[worst, j]
        left -= h[worst, i] * gain[i]
    pull = y_var[worst, 0] / left
    for s in range(m):
        for i in range(n):
            y_var[s, 0] += h[s, i] * gain[i] * pull
    for i in range(n):
        for j in range(n):
            N[i, j] += gain[i] * gain[j] / left
    return worst


@njit("void(f8[:, ::1], i8, i8[::1], f8[::1], f8[::1], f8[:, :, ::1])", cache=True, entry=True)
def scatter(rows: F64, m: int, used: I64, point: F64, expected: F64, found: F64) -> None:
    """Fill ``found`` (2, SYSTEMS, 2) of range and rate: v·ν and ν of each system, zeros without.

    ``rows``, ``m``, ``used``, ``point`` as :func:`companion.gnss.single_point.solve` left them;
    ``expected``: of :func:`trimmed_mean`.
    """
    h, y_var = np.empty((m, 8)), np.empty((m, 2))
    N, column = np.empty((8, 8)), np.empty(SYSTEMS, np.int64)
    found[:, :, :] = 0.0
    for kind in range(2):
        rate = kind == 1
        n = 4 if rate else 3
        for c in range(SYSTEMS):
            column[c] = 3 if rate else -1
            if not rate and point[P_CLOCK + c] == point[P_CLOCK + c]:
                column[c] = n
                n += 1
        _lines(rows, m, rate, point, column, h, y_var)
        N[:, :] = 0.0
        for s in range(m):
            if used[s] == 1 and y_var[s, 0] == y_var[s, 0]:
                for i in range(n):
                    for j in range(n):
                        N[i, j] += h[s, i] * h[s, j] / y_var[s, 1]
        if not invert_spd(N, n):
            continue
        out = _leave_out_worst(m, used, h, y_var, n, N)
        for c in range(SYSTEMS):
            total, largest, second, dof, count = 0.0, 0.0, 0.0, 0.0, 0
            for s in range(m):
                if int(rows[s, S_SYSTEM]) != c or y_var[s, 0] != y_var[s, 0]:
                    continue
                share = _share(h[s], n, N, y_var[s, 1], used[s] == 1 and s != out)
                if share < LEAST_REDUNDANCY:
                    continue
                e = y_var[s, 0] * y_var[s, 0] / (share * y_var[s, 1])
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
