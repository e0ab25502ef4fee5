"""Position, velocity and clock from one epoch alone: weighted least squares with fault exclusion.

Where a filter starts from, what it is compared with, and the guard against a satellite whose range
contradicts the others. Faults are found by the largest normalised residual (Baarda's data
snooping; Groves 2013, section 17.4): w² = r² / (σ² − h (HᵀWH)⁻¹ hᵀ), one satellite at a time, as
long as the sum of squared residuals says that something is wrong, and as long as the right ones are
the many.
"""

from __future__ import annotations

import math

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
from companion.gnss.geometry import geodetic, invert_spd, ned_axes
from companion.gnss.systems import SYSTEMS
from companion.types import F64, I64

# --- what comes out
P_POS, P_CLOCK, P_VEL, P_RATE = 0, 3, 6, 9
"""ECEF position [m]; clock against each system [m], NaN where unknown; velocity [m/s]; clock rate
[m/s]. Velocity and rate are NaN without four rates."""
P_SUM, P_DOF = 10, 11
"""Weighted sum of squared residuals, and how many more ranges there are than unknowns."""
P_COV, P_COV_VEL = 12, 21
"""Covariances (9,) of position and of velocity, ECEF."""
POINT_SIZE = 30

FIX_SIZE = 12
"""Columns of a point as a fix: latitude, longitude, height, velocity NED, 1σ of place and velocity;
NaN where unknown."""

SOLVED, TOO_FEW, SINGULAR, FAULTY = 0, 1, 2, 3
"""FAULTY: the ranges contradict each other, and too few agree to tell which are wrong."""
TURNS = 12
_EARTH = 1e6


@njit(
    "void(f8[:, ::1], i8, i8[::1], i8[::1], i8, f8[::1], f8[:, ::1], f8[::1], f8[::1])", cache=True
)
def _residuals(
    rows: F64, m: int, used: I64, column: I64, n: int, x: F64, N: F64, w: F64, point: F64
) -> None:
    """Sum of squares, and ``w``: each residual against what it may be by its own leverage."""
    here, u, h = np.zeros(3), np.empty(3), np.zeros(8)
    geodetic(x[0], x[1], x[2], here)
    total = 0.0
    for s in range(m):
        if used[s] == 0:
            continue
        k = column[int(rows[s, S_SYSTEM])]
        y = rows[s, S_RANGE] - expected_range(rows[s], x[:3], here, u) - x[k]
        for i in range(n):
            h[i] = -u[i] if i < 3 else 0.0
        h[k] = 1.0
        explained = 0.0
        for i in range(n):
            for j in range(n):
                explained += h[i] * N[i, j] * h[j]
        var = rows[s, S_RANGE_VAR]
        total += y * y / var
        # With no redundancy in it, a measurement cannot be judged: its residual is zero anyway.
        w[s] = y * y / (var - explained) if var - explained > 1e-3 * var else 0.0
    point[P_SUM] = total


@njit("void(f8[:, ::1], i8, i8[::1], b1, f8[::1], f8[:, ::1], f8[::1])", cache=True)
def _velocity(rows: F64, m: int, used: I64, rates: bool, x: F64, N: F64, point: F64) -> None:
    """Velocity and clock rate: linear in the rates, one clock for all systems."""
    for i in range(4):
        point[P_VEL + i] = np.nan
    u, h, b, still = np.empty(3), np.zeros(4), np.zeros(4), np.zeros(3)
    N[:, :] = 0.0
    count = 0
    for s in range(m):
        if used[s] == 0 or not rates or math.isnan(rows[s, S_RATE]):
            continue
        line_of_sight(rows[s], x[0], x[1], x[2], u)
        y = rows[s, S_RATE] - range_rate(rows[s], u, x, still)
        v = 1.0 / rows[s, S_RATE_VAR]
        h[0], h[1], h[2], h[3] = -u[0], -u[1], -u[2], 1.0
        count += 1
        for i in range(4):
            b[i] += h[i] * v * y
            for j in range(4):
                N[i, j] += h[i] * v * h[j]
    if count < 4 or not invert_spd(N, 4):
        return
    for i in range(4):
        total = 0.0
        for j in range(4):
            total += N[i, j] * b[j]
        point[P_VEL + i] = total
    for i in range(3):
        for j in range(3):
            point[P_COV_VEL + 3 * i + j] = N[i, j]


@njit("i8(f8[:, ::1], i8, i8[::1], b1, f8[::1], f8[::1], f8[:, ::1], f8[::1])", cache=True)
def least_squares(
    rows: F64, m: int, used: I64, rates: bool, start: F64, point: F64, N: F64, w: F64
) -> int:
    """Gauss-Newton on the ranges of the ``used`` (m,) rows, then the rates; see :func:`solve`.

    ``N`` (8, 8) receives the inverse normal matrix, ``w`` (m,) the squared normalised residuals.
    """
    column = np.full(SYSTEMS, -1)
    n, count = 3, 0
    for s in range(m):
        if used[s] == 1:
            count += 1
            system = int(rows[s, S_SYSTEM])
            if column[system] < 0:
                column[system] = n
                n += 1
    point[P_DOF] = count - n
    if count < n:
        return TOO_FEW
    x, here, u = np.zeros(8), np.zeros(3), np.empty(3)
    h, b = np.zeros(8), np.zeros(8)
    for i in range(3):
        x[i] = start[i]
    for turn in range(TURNS):
        # The troposphere of a point that is still somewhere in the Earth means nothing.
        near = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]) > _EARTH
        if near:
            geodetic(x[0], x[1], x[2], here)
        N[:, :] = 0.0
        b[:] = 0.0
        for s in range(m):
            if used[s] == 0:
                continue
            if near:
                r = expected_range(rows[s], x[:3], here, u)
            else:
                r = line_of_sight(rows[s], x[0], x[1], x[2], u)
            k = column[int(rows[s, S_SYSTEM])]
            for i in range(n):
                h[i] = -u[i] if i < 3 else 0.0
            h[k] = 1.0
            v = 1.0 / rows[s, S_RANGE_VAR]
            y = rows[s, S_RANGE] - r - x[k]
            w[s] = y
            for i in range(n):
                b[i] += h[i] * v * y
                for j in range(n):
                    N[i, j] += h[i] * v * h[j]
        if not invert_spd(N, n):
            return SINGULAR
        moved = 0.0
        for i in range(n):
            dx = 0.0
            for j in range(n):
                dx += N[i, j] * b[j]
            x[i] += dx
            if i < 3:
                moved += dx * dx
        # A step of d leaves d² / 4e7 m.
        if moved < 1e-4 and turn > 0:
            break
    else:
        return SINGULAR
    _residuals(rows, m, used, column, n, x, N, w, point)
    for i in range(3):
        point[P_POS + i] = x[i]
        for j in range(3):
            point[P_COV + 3 * i + j] = N[i, j]
    for k in range(SYSTEMS):
        point[P_CLOCK + k] = x[column[k]] if column[k] >= 0 else np.nan
    _velocity(rows, m, used, rates, x[:3].copy(), N, point)
    return SOLVED


@njit("i8(f8[:, ::1], i8, f8[::1], f8[::1], f8[::1], i8[::1])", cache=True, entry=True)
def solve(rows: F64, m: int, start: F64, gates: F64, point: F64, used: I64) -> int:
    """Solve one epoch of ``m`` corrected satellites, leaving out those at fault.

    ``start`` (3,): ECEF guess; zeros will do, for a place to begin from, which needs no majority.
    ``gates`` (D,): limit of the sum of squared residuals for 1…D degrees of freedom. ``point``
    (:data:`POINT_SIZE`,) is filled; ``used`` (m,) says whom it rests on: 1 used, 0 left out.
    Returns :data:`SOLVED` or why not.
    """
    N, w = np.zeros((8, 8)), np.zeros(m)
    seen = np.zeros(SYSTEMS, np.int64)

    for s in range(m):
        used[s] = 1 if rows[s, S_RANGE] == rows[s, S_RANGE] else 0
        seen[int(rows[s, S_SYSTEM])] += used[s]
    # The only satellite of its system just fixes that system's clock.
    for s in range(m):
        if seen[int(rows[s, S_SYSTEM])] == 1:
            used[s] = 0
    # From nowhere, nothing is corrected that depends on elevation: any agreement is a beginning.
    lenient = start[0] == 0.0 and start[1] == 0.0
    spare, excluded = -3, 0
    for k in range(SYSTEMS):
        spare += seen[k] - 1 if seen[k] > 1 else 0
    while True:
        code = least_squares(rows, m, used, True, start, point, N, w)
        if code != SOLVED:
            return code
        dof = int(point[P_DOF])
        if dof < 1 or point[P_SUM] <= gates[min(dof, gates.shape[0]) - 1]:
            return SOLVED
        # Half of what is redundant is the most that any method can tell from the rest (breakdown
        # point of a regression; Rousseeuw and Leroy 1987, section 3.4): what then agrees need not
        # be right. A receiver's time that is off by a second looks like that.
        excluded += 1
        if dof < 2 or (2 * excluded > spare and not lenient):
            return FAULTY
        worst = -1
        for s in range(m):
            if used[s] == 1 and (worst < 0 or w[s] > w[worst]):
                worst = s
        used[worst] = 0
        system, left = int(rows[worst, S_SYSTEM]), 0
        for s in range(m):
            if used[s] == 1 and int(rows[s, S_SYSTEM]) == system:
                left += 1
        if left == 1:
            for s in range(m):
                if int(rows[s, S_SYSTEM]) == system:
                    used[s] = 0


@njit("void(f8[:, ::1], f8[:, ::1])", cache=True, entry=True)
def as_fixes(points: F64, fixes: F64) -> None:
    """``fixes`` (N, :data:`FIX_SIZE`) from ``points`` (N, :data:`POINT_SIZE`)."""
    axes = np.empty((3, 3))
    for i in range(points.shape[0]):
        p, fix = points[i], fixes[i]
        geodetic(p[P_POS], p[P_POS + 1], p[P_POS + 2], fix)
        ned_axes(fix[0], fix[1], axes)
        for j in range(3):
            velocity, var, var_velocity = 0.0, 0.0, 0.0
            for a in range(3):
                velocity += axes[j, a] * p[P_VEL + a]
                for b in range(3):
                    weight = axes[j, a] * axes[j, b]
                    var += weight * p[P_COV + 3 * a + b]
                    var_velocity += weight * p[P_COV_VEL + 3 * a + b]
            fix[3 + j] = velocity
            fix[6 + j] = math.sqrt(var) if var > 0.0 else np.nan
            fix[9 + j] = math.sqrt(var_velocity) if var_velocity > 0.0 else np.nan
