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
    range_rate,
)
from companion.gnss.geometry import add_line, geodetic, invert_spd, mirror, ned_axes
from companion.gnss.sight import (
    G_LEVER,
    G_RANGE,
    G_RATE_LEVER,
    G_RATE_RESIDUAL,
    G_RESIDUAL,
    look,
    stand,
)
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
NEAR_M2 = 40.0
"""Square of a step after which lines of sight need no further look. A step of d leaves d² / 4e7 m
and, as the troposphere's change with height is not in the lines, up to d / 1000; a step more with
the same matrix leaves a thousandth of that, 1e-5 m."""


@njit("f8(f8[:, ::1], i8, f8[::1])", cache=True, counted=False)
def leverage(N: F64, k: int, u: F64) -> float:
    """h N hᵀ of the line h that :func:`companion.gnss.geometry.add_line` adds."""
    total = N[k, k]
    for i in range(3):
        total += u[i] * (N[i, 0] * u[0] + N[i, 1] * u[1] + N[i, 2] * u[2] - 2.0 * N[i, k])
    return float(total)


@njit("i8(f8[:, ::1], i8, i8[::1], i8[::1])", cache=True, counted=False)
def _unknowns(rows: F64, m: int, used: I64, column: I64) -> int:
    """``column`` (SYSTEMS,) of each system's clock, −1 without one in use; how many there are."""
    column[:] = -1
    n = 3
    for s in range(m):
        system = int(rows[s, S_SYSTEM])
        if used[s] == 1 and column[system] < 0:
            column[system] = n
            n += 1
    return n


@njit("b1(f8[:, ::1], i8, i8[::1], i8[::1], i8, f8[:, ::1], f8[:, ::1])", cache=True, counted=False)
def _normal(
    rows: F64, m: int, used: I64, column: I64, n: int, sight: F64, N: F64
) -> bool:  # fmt: skip
    """Fill ``N`` (8, 8) with the inverse normal matrix; false where there is none."""
    N[:, :] = 0.0
    for s in range(m):
        if used[s] == 1:
            k = column[int(rows[s, S_SYSTEM])]
            add_line(N, k, sight[s], 1.0 / rows[s, S_RANGE_VAR])
    mirror(N, n)
    return invert_spd(N, n)


@njit(
    "f8(f8[:, ::1], i8, i8[::1], i8[::1], i8, f8[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8[::1])",
    cache=True,
    counted=False,
)
def _step(
    rows: F64, m: int, used: I64, column: I64, n: int, sight: F64, N: F64, x: F64, b: F64, dx: F64
) -> float:  # fmt: skip
    """Move ``x`` (8,) by ``dx``, a step of Gauss and Newton; its square in place [m²]."""
    b[:] = 0.0
    for s in range(m):
        if used[s] == 0:
            continue
        k = column[int(rows[s, S_SYSTEM])]
        y = (rows[s, S_RANGE] - sight[s, G_RANGE] - x[k]) / rows[s, S_RANGE_VAR]
        b[0] -= sight[s, 0] * y
        b[1] -= sight[s, 1] * y
        b[2] -= sight[s, 2] * y
        b[k] += y
    for i in range(n):
        dx[i] = 0.0
        for j in range(n):
            dx[i] += N[i, j] * b[j]
        x[i] += dx[i]
    return float(dx[0] * dx[0] + dx[1] * dx[1] + dx[2] * dx[2])


@njit(
    "f8(f8[:, ::1], i8, i8[::1], i8[::1], f8[::1], f8[:, ::1], f8[:, ::1])",
    cache=True,
    counted=False,
)
def _residuals(rows: F64, m: int, used: I64, column: I64, x: F64, N: F64, sight: F64) -> float:
    """Residuals and leverages of all ranges into ``sight``; weighted sum of squares of the used.

    NaN where the system of a satellite has no clock.
    """
    total = 0.0
    for s in range(m):
        k = column[int(rows[s, S_SYSTEM])]
        if k < 0:
            sight[s, G_RESIDUAL] = sight[s, G_LEVER] = np.nan
            continue
        y = rows[s, S_RANGE] - sight[s, G_RANGE] - x[k]
        sight[s, G_RESIDUAL], sight[s, G_LEVER] = y, leverage(N, k, sight[s])
        if used[s] == 1:
            total += y * y / rows[s, S_RANGE_VAR]
    return total


@njit(
    "void(f8[:, ::1], i8, i8[::1], f8[:, ::1], f8[::1], f8[:, ::1], f8[::1])",
    cache=True,
    counted=False,
)
def _velocity(rows: F64, m: int, used: I64, sight: F64, b: F64, R: F64, point: F64) -> None:
    """Velocity and clock rate into ``point``: linear in the rates, one clock for all systems.

    ``R`` (8, 8) receives their covariance; residuals and leverages of the rates go to ``sight``.
    """
    x, v = point[P_POS : P_POS + 3], point[P_VEL : P_VEL + 3]
    R[:, :] = 0.0
    b[:] = 0.0
    v[:] = 0.0
    count = 0
    for s in range(m):
        if used[s] == 0 or math.isnan(rows[s, S_RATE]):
            continue
        w = 1.0 / rows[s, S_RATE_VAR]
        y = w * (rows[s, S_RATE] - range_rate(rows[s], sight[s], x, v))
        add_line(R, 3, sight[s], w)
        b[0] -= sight[s, 0] * y
        b[1] -= sight[s, 1] * y
        b[2] -= sight[s, 2] * y
        b[3] += y
        count += 1
    mirror(R, 4)
    known = count >= 4 and invert_spd(R, 4)
    for i in range(4):
        total = 0.0
        for j in range(4):
            total += R[i, j] * b[j]
        point[P_VEL + i] = total if known else np.nan
    for i in range(3):
        for j in range(3):
            point[P_COV_VEL + 3 * i + j] = R[i, j] if known else np.nan
    for s in range(m):
        # NaN where there is no velocity or no rate.
        foreseen = range_rate(rows[s], sight[s], x, v) + point[P_RATE]
        sight[s, G_RATE_RESIDUAL] = rows[s, S_RATE] - foreseen
        sight[s, G_RATE_LEVER] = leverage(R, 3, sight[s]) if known else np.nan


@njit(
    "i8(f8[:, ::1], i8, i8[::1], f8[::1], b1, f8[::1], f8[:, ::1], f8[:, :, ::1], i8[::1], "
    "f8[::1])",
    cache=True,
    counted=False,
)
def _least_squares(
    rows: F64, m: int, used: I64, start: F64, seen: bool, frame: F64, sight: F64, work: F64,
    column: I64, point: F64,
) -> int:  # fmt: skip
    """Gauss-Newton on the ranges of the ``used`` (m,) rows, then the rates; see :func:`solve`.

    ``seen``: ``sight`` holds lines and ranges from ``start`` already.
    """
    N, R, x, b, dx = work[0], work[1], work[2, 0], work[2, 1], work[2, 2]
    n, count = _unknowns(rows, m, used, column), 0
    for s in range(m):
        count += used[s]
    point[P_DOF] = count - n
    if count < n:
        return TOO_FEW
    x[:] = 0.0
    for i in range(3):
        x[i] = start[i]
    outside, settled = True, False
    for turn in range(TURNS):
        if turn > 0 or not seen:
            outside = stand(x[0], x[1], x[2], frame)
            look(rows, m, x, frame, sight)
        if settled:
            break
        if not _normal(rows, m, used, column, n, sight, N):
            return SINGULAR
        moved = _step(rows, m, used, column, n, sight, N, x, b, dx)
        settled = outside and moved < NEAR_M2
    else:
        return SINGULAR
    # What that leaves: a step more with the same matrix, too short to look again.
    _step(rows, m, used, column, n, sight, N, x, b, dx)
    for s in range(m):
        for i in range(3):
            sight[s, G_RANGE] -= sight[s, i] * dx[i]
    point[P_SUM] = _residuals(rows, m, used, column, x, N, sight)
    for i in range(3):
        point[P_POS + i] = x[i]
        for j in range(3):
            point[P_COV + 3 * i + j] = N[i, j]
    for k in range(SYSTEMS):
        point[P_CLOCK + k] = x[column[k]] if column[k] >= 0 else np.nan
    _velocity(rows, m, used, sight, b, R, point)
    return SOLVED


@njit("i8(f8[:, ::1], i8, i8[::1], i8[::1])", cache=True, counted=False)
def _redundancy(rows: F64, m: int, used: I64, count: I64) -> int:
    """Fill ``used``: all but the only one of its system; how many ranges more than unknowns.

    The only satellite of its system just fixes that system's clock. ``count`` (SYSTEMS,) is
    scratch.
    """
    count[:] = 0
    for s in range(m):
        count[int(rows[s, S_SYSTEM])] += 1
    for s in range(m):
        used[s] = 1 if count[int(rows[s, S_SYSTEM])] > 1 else 0
    spare = -3
    for k in range(SYSTEMS):
        spare += count[k] - 1 if count[k] > 1 else 0
    return spare


@njit("void(f8[:, ::1], i8, i8[::1], f8[:, ::1])", cache=True, counted=False)
def _leave_out_worst(rows: F64, m: int, used: I64, sight: F64) -> None:
    """Take the largest normalised residual out of ``used``, and whom it leaves alone of a system.

    With no redundancy in it, a measurement cannot be judged: its residual is zero anyway.
    """
    worst, largest = -1, -1.0
    for s in range(m):
        if used[s] == 0:
            continue
        y, var = sight[s, G_RESIDUAL], rows[s, S_RANGE_VAR]
        left = var - sight[s, G_LEVER]
        w = y * y / left if left > 1e-3 * var else 0.0
        if worst < 0 or w > largest:
            worst, largest = s, w
    used[worst] = 0
    system, others = rows[worst, S_SYSTEM], 0
    for s in range(m):
        if rows[s, S_SYSTEM] == system:
            others += used[s]
    if others == 1:
        for s in range(m):
            if rows[s, S_SYSTEM] == system:
                used[s] = 0


@njit(
    "i8(f8[:, ::1], i8, f8[::1], b1, f8[::1], f8[::1], f8[:, ::1], f8[:, :, ::1], i8[::1], "
    "f8[::1], i8[::1])",
    cache=True,
    counted=False,
)
def solve(
    rows: F64, m: int, start: F64, known: bool, gates: F64, frame: F64, sight: F64, work: F64,
    column: I64, point: F64, used: I64,
) -> int:  # fmt: skip
    """Solve one epoch of ``m`` corrected satellites, leaving out those at fault.

    ``start`` (3,): ECEF guess; zeros will do, and is not ``known`` then: for a place to begin from,
    which needs no majority. ``frame``, ``sight`` (m, ·) of :mod:`companion.gnss.sight` are filled
    from a known start, and are those of the solution when it is there. ``gates`` (D,): limit of the
    sum of squared residuals for 1…D degrees of freedom. ``point`` (:data:`POINT_SIZE`,) is filled;
    ``used`` (m,) says whom it rests on: 1 used, 0 left out. Of ``work`` (3, 8, 8) the first two are
    the covariances of place and clocks, whose columns ``column`` (SYSTEMS,) tells, and of velocity.
    Returns :data:`SOLVED` or why not.
    """
    spare, excluded = _redundancy(rows, m, used, column), 0
    while True:
        seen = known and excluded == 0
        code = _least_squares(rows, m, used, start, seen, frame, sight, work, column, point)
        if code != SOLVED:
            return code
        dof = int(point[P_DOF])
        if dof < 1 or point[P_SUM] <= gates[min(dof, gates.shape[0]) - 1]:
            return SOLVED
        # Half of what is redundant is the most that any method can tell from the rest (breakdown
        # point of a regression; Rousseeuw and Leroy 1987, section 3.4): what then agrees need not
        # be right. A receiver's time that is off by a second looks like that.
        excluded += 1
        # From nowhere, nothing is corrected that depends on elevation: any agreement is a start.
        if dof < 2 or (2 * excluded > spare and known):
            return FAULTY
        _leave_out_worst(rows, m, used, sight)


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
