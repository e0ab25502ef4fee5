"""The gate and the update of the direct filter, on measurements that touch few states.

As :mod:`companion.estimation.update`: one to three components with independent noise are gated
together, then applied one after the other, P ← P − K S Kᵀ. Here H is kept as the few columns that
are not zero, so the cost is a few rows of P rather than all of H P Hᵀ.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.adaptation.adapt import adapt, adapts
from companion.estimation.adaptation.layout import TRACE_SIZE, TRACED
from companion.estimation.direct.layout import (
    ACC,
    ACC_N,
    ATT,
    ATTITUDE_BIAS,
    BANK_DOF,
    BANK_NIS,
    BARO_BIAS,
    CLOCK,
    GNSS_BIAS,
    HEIGHT,
    L_ATTITUDE,
    L_BARO,
    L_CLOCK,
    L_GNSS,
    L_N,
    L_P,
    L_UNITS,
    LAT,
    LOG_LIKELIHOOD,
    LON,
    POS,
    RATE,
    RATE_B,
    UNIT,
    UNIT_SIZE,
    UNITS,
    VEL,
    VEL_N,
)
from companion.estimation.parameters import BANK, GATE
from companion.estimation.update import (
    ACCEPTED,
    R_CHANNEL,
    R_DOF,
    R_GATE,
    R_INNOVATION,
    R_NIS,
    R_SCALE_USED,
    R_SD,
    R_SOURCE,
    R_TRACE,
    R_VERDICT,
    REFUSED_INVALID,
    REJECTED_GATE,
    WINSOR,
    normalised_square,
)
from companion.navigation.earth import radii
from companion.navigation.layout import CLOCK_STATES
from companion.navigation.rotation import rotate_body
from companion.types import F64, I64

WIDTH = 20
"""Columns that one measurement may touch: an accelerometer touches 12, a lever arm 9."""
GYRO, ACCEL = 11, 12  # as types.Channel


@njit("void(f8[::1], i8[::1], f8[::1])", cache=True, entry=True)
def box_plus(s: F64, lay: I64, dx: F64) -> None:
    """Move the error ``dx`` (n,) into the nominal state in place: x ⊞ δx.

    No reset of P follows: ψ is an error in body axes, and what is known of level, and its
    correlation with the biases, was learned in body axes; it stays there whatever the correction.
    """
    m, n = radii(s[LAT])
    lat = s[LAT]
    s[LAT] = lat + dx[POS] / (m + s[HEIGHT])
    s[LON] += dx[POS + 1] / ((n + s[HEIGHT]) * math.cos(lat))
    s[HEIGHT] -= dx[POS + 2]
    rotate_body(s, dx[ATT], dx[ATT + 1], dx[ATT + 2])
    for i in range(3):
        s[VEL_N + i] += dx[VEL + i]
        s[ACC_N + i] += dx[ACC + i]
        s[RATE_B + i] += dx[RATE + i]
        if lay[L_GNSS] >= 0:
            s[GNSS_BIAS + i] += dx[lay[L_GNSS] + i]
        if lay[L_ATTITUDE] >= 0:
            s[ATTITUDE_BIAS + i] += dx[lay[L_ATTITUDE] + i]
    for i in range(UNIT_SIZE * lay[L_UNITS]):
        s[UNITS + i] += dx[UNIT + i]
    if lay[L_BARO] >= 0:
        s[BARO_BIAS] += dx[lay[L_BARO]]
    if lay[L_CLOCK] >= 0:
        for i in range(CLOCK_STATES):
            s[CLOCK + i] += dx[lay[L_CLOCK] + i]


@njit(
    "void(f8[::1], i8[::1], f8[:, ::1], i8[::1], i8, f8[::1], f8[::1], i8, f8[:, ::1])", cache=True
)
def apply(s: F64, lay: I64, H: F64, cols: I64, nc: int, y: F64, R: F64, m: int, W: F64) -> None:
    """Correct state and P by ``m`` components, one after the other; arguments as :func:`fuse`."""
    n = lay[L_N]
    P = s[lay[L_P] : lay[L_P] + n * n].reshape((n, n))
    a, dx = W[0], W[1]
    for j in range(n):
        dx[j] = 0.0
    for i in range(m):
        for j in range(n):
            a[j] = 0.0
        for c in range(nc):
            h = H[i, c]
            if h != 0.0:
                row = P[cols[c]]
                for j in range(n):
                    a[j] += h * row[j]
        v, e = R[i], y[i]
        for c in range(nc):
            v += H[i, c] * a[cols[c]]
            e -= H[i, c] * dx[cols[c]]
        r = 1.0 / math.sqrt(v)
        for j in range(n):
            a[j] *= r
        e *= r
        for j in range(n):
            g = a[j]
            dx[j] += g * e
            row = P[j]
            for c in range(n):
                row[c] -= g * a[c]
    box_plus(s, lay, dx)


@njit(
    "b1(f8[::1], i8[::1], f8[::1], i8[::1], i8, i8, f8[:, ::1], i8[::1], i8, f8[::1], f8[::1], i8,"
    "f8[:, ::1], f8[::1])",
    cache=True,
)
def fuse(
    s: F64,
    lay: I64,
    par: F64,
    ipar: I64,
    channel: int,
    source: int,
    H: F64,
    cols: I64,
    nc: int,
    y: F64,
    R: F64,
    m: int,
    W: F64,
    report: F64,
) -> bool:
    """Gate ``m`` components and apply them; fills ``report``, returns whether accepted.

    ``H`` (3, WIDTH) holds the columns ``cols[:nc]`` of the Jacobian, ``y`` (3,) the innovation,
    ``R`` (3,) the variances, which the adaptation scales in place; ``W`` (≥ 9, n) is scratch.
    """
    n = lay[L_N]
    P = s[lay[L_P] : lay[L_P] + n * n].reshape((n, n))
    S = np.zeros((3, 3))
    L = np.zeros((4, 3))
    foreseen = np.empty(3)
    for i in range(m):
        for j in range(i + 1):
            x = 0.0
            for a in range(nc):
                row = P[cols[a]]
                part = 0.0
                for b in range(nc):
                    part += row[cols[b]] * H[j, b]
                x += H[i, a] * part
            S[i, j] = x
            S[j, i] = x
        foreseen[i] = S[i, i]
        S[i, i] += R[i]
    nis = normalised_square(S, y, m, L)
    gate = par[GATE + m - 1]
    scale = 1.0
    report[R_TRACE + TRACED] = 0.0
    if nis >= 0.0 and adapts(ipar, channel):
        trace = report[R_TRACE : R_TRACE + TRACE_SIZE]
        scale = adapt(s, par, ipar, channel, m, y, L[3], foreseen, R, nis, gate, trace)
        if scale != 1.0:
            for i in range(m):
                R[i] *= scale
                S[i, i] = foreseen[i] + R[i]
            nis = normalised_square(S, y, m, L)
    report[R_CHANNEL], report[R_SOURCE], report[R_DOF] = channel, source, m
    for i in range(3):
        report[R_INNOVATION + i] = y[i] if i < m else np.nan
        report[R_SD + i] = math.sqrt(S[i, i]) if i < m else np.nan
    report[R_NIS], report[R_GATE], report[R_SCALE_USED] = nis, gate, scale
    if not nis >= 0.0:
        report[R_VERDICT] = REFUSED_INVALID
        return False
    if ipar[BANK] == 1:
        # Where GNSS says how the vehicle accelerates, the accelerometer says where that points.
        log_det = 0.0
        for i in range(m):
            log_det += 2.0 * math.log(L[i, i])
        s[LOG_LIKELIHOOD] -= 0.5 * (min(nis, WINSOR) + log_det)
        s[BANK_NIS] += min(nis, WINSOR)
        s[BANK_DOF] += m
    elif nis > gate:
        report[R_VERDICT] = REJECTED_GATE
        return False
    report[R_VERDICT] = ACCEPTED
    apply(s, lay, H, cols, nc, y, R, m, W)
    return True
