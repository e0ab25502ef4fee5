"""How far a receiver's time is off, from one epoch of more ranges than unknowns.

A satellite moves by up to 4 km a second, its range by up to 800 m in one direction or the other: an
epoch that is stamped δ too early or too late leaves in its ranges

    y = −u·Δx + c Δt_r + ρ̇ δ

beside place and clocks (coarse-time navigation; van Diggelen 2009, chapter 4). Without the last
term most of it goes into a place that is off by 600 m for each second, and nothing contradicts it.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.gnss.corrected import S_RANGE, S_RANGE_VAR, S_SYSTEM, range_rate
from companion.gnss.geometry import invert_spd
from companion.gnss.sight import FRAME_SIZE, G_RANGE, SIGHT_SIZE, look, stand
from companion.gnss.systems import SYSTEMS
from companion.types import F64

SPARE = 2
"""Ranges beyond the unknowns that are needed: their scatter says how good the ranges are."""


@njit("b1(f8[:, ::1], f8[::1], f8[::1])", cache=True, entry=True)
def time_error(rows: F64, x: F64, found: F64) -> bool:
    """Fill ``found`` (2,): true time − stamped time, and its 1σ [s]; false where it cannot be told.

    ``rows`` (m, 12): corrected satellites; ``x`` (3,): about where they were seen from, ECEF. The
    deviation grows with the scatter of the ranges where that is larger than they claim.
    """
    m = rows.shape[0]
    frame, sight = np.empty(FRAME_SIZE), np.empty((m, SIGHT_SIZE))
    if not stand(x[0], x[1], x[2], frame):
        return False
    look(rows, m, x, frame, sight)
    column, last = np.full(SYSTEMS, -1), 3
    for s in range(m):
        system = int(rows[s, S_SYSTEM])
        if column[system] < 0:
            column[system] = last
            last += 1
    if m < last + 1 + SPARE:
        return False
    N, b, h, still = np.zeros((8, 8)), np.zeros(8), np.zeros(8), np.zeros(3)
    total = 0.0
    for s in range(m):
        row, u = rows[s], sight[s]
        h[:] = 0.0
        for i in range(3):
            h[i] = -u[i]
        h[column[int(row[S_SYSTEM])]] = 1.0
        h[last] = range_rate(row, u, x, still)
        y, v = row[S_RANGE] - u[G_RANGE], 1.0 / row[S_RANGE_VAR]
        total += y * v * y
        for i in range(last + 1):
            b[i] += h[i] * v * y
            for j in range(last + 1):
                N[i, j] += h[i] * v * h[j]
    if not invert_spd(N, last + 1):
        return False
    error = 0.0
    for i in range(last + 1):
        error += N[last, i] * b[i]
        for j in range(last + 1):
            total -= b[i] * N[i, j] * b[j]
    scatter = max(1.0, total / (m - last - 1))
    found[0], found[1] = error, math.sqrt(N[last, last] * scatter)
    return True
