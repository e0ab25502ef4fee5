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
from companion.gnss.corrected import S_RANGE_VAR, S_RATE_VAR, S_SYSTEM
from companion.gnss.sight import G_LEVER, G_RATE_LEVER, G_RATE_RESIDUAL, G_RESIDUAL
from companion.gnss.systems import SYSTEMS
from companion.types import F64, I64, SATELLITES

LEAST_REDUNDANCY = 0.05
"""Of a measurement that is to say something of its own error."""
SUSPECT = 9.0
"""Normalised square from which on the worst satellite is left out of what the rest is judged by. By
the variance as configured: one that was learned of a satellite at fault must not hide it."""
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


@njit("f8(f8, f8, b1)", cache=True, counted=False)
def _share(lever: float, var: float, inside: bool) -> float:
    """Variance of a residual in that of its measurement."""
    return 1.0 - lever / var if inside else 1.0 + lever / var


@njit(
    "i8(f8[:, ::1], i8, i8[::1], f8[:, ::1], b1, i8[::1], f8[::1], f8[:, ::1], f8[::1])",
    cache=True,
    counted=False,
)
def _leave_out_worst(
    rows: F64, m: int, used: I64, sight: F64, rate: bool, column: I64, factors: F64, N: F64,
    gain: F64,
) -> int:  # fmt: skip
    """Take the satellite that fits worst out of the solution, if it fits badly; its row, or −1.

    Leverages become those without it, and residuals those about the solution without it: what it
    pulled the others by is no noise of theirs.
    """
    y_at, lever_at = (G_RATE_RESIDUAL, G_RATE_LEVER) if rate else (G_RESIDUAL, G_LEVER)
    var_at = S_RATE_VAR if rate else S_RANGE_VAR
    worst, largest = -1, 0.0
    for s in range(m):
        y, var = sight[s, y_at], rows[s, var_at]
        limit = SUSPECT / max(factors[int(rows[s, S_SYSTEM])], 1.0)
        # Fits well whatever its leverage: most are cleared by this.
        if used[s] == 1 and y * y > limit * LEAST_REDUNDANCY * var:
            share = _share(sight[s, lever_at], var, True)
            if share >= LEAST_REDUNDANCY and y * y > max(limit, largest) * share * var:
                worst, largest = s, y * y / (share * var)
    if worst < 0:
        return worst
    k = 3 if rate else column[int(rows[worst, S_SYSTEM])]
    u = sight[worst]
    for i in range(3 + SYSTEMS):
        gain[i] = N[i, k] - N[i, 0] * u[0] - N[i, 1] * u[1] - N[i, 2] * u[2]
    left = rows[worst, var_at] - u[lever_at]
    pull = u[y_at] / left
    for s in range(m):
        k = 3 if rate else column[int(rows[s, S_SYSTEM])]
        if k >= 0:
            u = sight[s]
            share = gain[k] - gain[0] * u[0] - gain[1] * u[1] - gain[2] * u[2]
            u[y_at] += share * pull
            u[lever_at] += share * share / left
    return worst


@njit(
    "void(f8[:, ::1], i8, i8[::1], i8[::1], f8[:, ::1], f8[:, ::1], f8[:, :, ::1], f8[::1],"
    "f8[:, :, ::1])",
    cache=True,
    counted=False,
)
def scatter(
    rows: F64, m: int, used: I64, column: I64, sight: F64, factors: F64, work: F64, expected: F64,
    found: F64,
) -> None:  # fmt: skip
    """Fill ``found`` (2, SYSTEMS, 2) of range and rate: v·ν and ν of each system, zeros without.

    ``rows``, ``m``, ``used``, ``column``, ``sight`` and ``work`` as
    :func:`companion.gnss.single_point.solve` left them; ``sight`` is not to be used after this.
    ``factors`` (2, SYSTEMS): what the variances were multiplied by; ``expected``: of
    :func:`trimmed_mean`.
    """
    found[:, :, :] = 0.0
    for kind in range(2):
        rate = kind == 1
        y_at, lever_at = (G_RATE_RESIDUAL, G_RATE_LEVER) if rate else (G_RESIDUAL, G_LEVER)
        var_at = S_RATE_VAR if rate else S_RANGE_VAR
        out = _leave_out_worst(
            rows, m, used, sight, rate, column, factors[kind], work[kind], work[2, 0]
        )
        for c in range(SYSTEMS):
            total, largest, second, dof, count = 0.0, 0.0, 0.0, 0.0, 0
            for s in range(m):
                y, var = sight[s, y_at], rows[s, var_at]
                if int(rows[s, S_SYSTEM]) != c or math.isnan(y):
                    continue
                share = _share(sight[s, lever_at], var, used[s] == 1 and s != out)
                if share < LEAST_REDUNDANCY:
                    continue
                e = y * y / (share * var)
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
