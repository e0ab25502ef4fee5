"""Pseudorange and range rate of one satellite, for the direct filter.

As :mod:`companion.measurements.pseudorange`: with u the line of sight in n, H = −uᵀ H_position and
−uᵀ H_velocity of the antenna, and the clock. A place that is wrong also turns u, which makes a rate
of v⊥/r.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.direct import aids
from companion.estimation.direct.layout import CLOCK, L_CLOCK, LAT, POS
from companion.estimation.direct.update import WIDTH
from companion.gnss.corrected import S_RANGE, S_RATE, S_SYSTEM, S_VEL, expected_range, range_rate
from companion.measurements.pseudorange import antenna
from companion.navigation.layout import BIAS, DRIFT, SYSTEM
from companion.types import F64, I64


@njit(
    "i8(f8[::1], i8[::1], f8[:, ::1], f8[::1], f8[::1], b1, f8[:, ::1], i8[::1], f8[::1])",
    cache=True,
)
def satellite(
    s: F64, lay: I64, C: F64, lever: F64, row: F64, rate: bool, H: F64, cols: I64, y: F64
) -> int:
    """Innovation ``y[0]`` [m or, for the ``rate``, m/s] and the columns of H; how many there are.

    ``row`` (12,): columns ``S_`` of :mod:`companion.gnss.corrected`; ``C`` (3, 3) is C_nb.
    """
    full, w, x, here = np.empty((3, WIDTH)), np.empty(3), np.empty(3), np.empty(3)
    axes, u_e, u, v_e = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    # The innovation of "measured where we are" is less the lever arm and the slow error.
    nc = aids.position(s, lay, C, lever, s[LAT : LAT + 3], full, cols, w)
    for i in range(3):
        w[i] = -w[i]
    antenna(s, w, axes, here, x)
    expected = expected_range(row, x, here, u_e)
    for i in range(3):
        u[i] = axes[i, 0] * u_e[0] + axes[i, 1] * u_e[1] + axes[i, 2] * u_e[2]
    clock = lay[L_CLOCK] + (DRIFT if rate else BIAS)
    if rate:
        w[:] = 0.0
        nc = aids.velocity(s, C, lever, w, full, cols, here)
        for i in range(3):
            v_e[i] = -(axes[0, i] * here[0] + axes[1, i] * here[1] + axes[2, i] * here[2])
        y[0] = row[S_RATE] - range_rate(row, u_e, x, v_e) - s[CLOCK + DRIFT]
    else:
        y[0] = row[S_RANGE] - expected - s[CLOCK + BIAS]
    for c in range(nc):
        H[0, c] = -(u[0] * full[0, c] + u[1] * full[1, c] + u[2] * full[2, c])
    cols[nc], H[0, nc] = clock, 1.0
    nc += 1
    if rate:
        return _turning(row, axes, u, u_e, x, v_e, nc, H, cols)
    system = int(row[S_SYSTEM])
    if system > 0:
        at = SYSTEM - 1 + system
        y[0] -= s[CLOCK + at]
        cols[nc], H[0, nc] = lay[L_CLOCK] + at, 1.0
        nc += 1
    return nc


@njit(
    "i8(f8[::1], f8[:, ::1], f8[::1], f8[::1], f8[::1], f8[::1], i8, f8[:, ::1], i8[::1])",
    cache=True,
)
def _turning(
    row: F64, axes: F64, u: F64, u_e: F64, x: F64, v_e: F64, nc: int, H: F64, cols: I64
) -> int:
    """Add the three columns by which position turns the line of sight of a rate; the new count."""
    along, distance = 0.0, 0.0
    for i in range(3):
        along += u_e[i] * (row[S_VEL + i] - v_e[i])
        distance += (row[i] - x[i]) ** 2
    distance = math.sqrt(distance)
    for c in range(3):
        across = 0.0
        for i in range(3):
            across += axes[c, i] * (row[S_VEL + i] - v_e[i])
        cols[nc + c], H[0, nc + c] = POS + c, -(across - u[c] * along) / distance
    return nc + 3
