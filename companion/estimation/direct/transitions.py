"""Practical mechanisms for smooth transitions between kinds of motion (Yu et al. 2018, section IV).

A step of raw specific force of the first IMU from one sample to the next beyond a threshold (eqs 40
and 41; magnitudes, though the paper prints none) is a change of motion that the trajectory model
does not foresee: the acceleration on that axis is forgotten, P_aa ← P_aa + σ² u uᵀ, and the
accelerometer's own update, which follows, sets it to (f − b)/(1 + s) − gravity (eq. 42) with the
uncertainty that this has. A lateral step Δa at speed v is a step Δa/v of the turn rate, too, which
the paper does not say: the rate is forgotten by as much, or the gyros' next samples would be
refused as outliers, and the turn lost meanwhile would stay in the heading. While turning,
acceleration goes round with the vehicle: at every sample it is forgotten a little on both axes, and
to the right measured as turn rate times speed (eq. 44).
"""

from __future__ import annotations

import math

from companion._jit import njit
from companion.estimation.direct.aids import lateral
from companion.estimation.direct.layout import (
    ACC,
    CIRCULAR,
    HAVE_FORCE,
    L_N,
    L_P,
    LAST_FORCE_X,
    LAST_FORCE_Y,
    RATE,
    VEL_N,
)
from companion.estimation.direct.parameters import CIRCLE_VAR, SWITCH_SIGMAS, SWITCH_VAR
from companion.estimation.direct.update import apply
from companion.types import F64, I64

SLOWEST = 1.0
"""Forward speed [m/s] above which a lateral step is taken for the beginning or end of a turn."""
NO_SWITCH, LINEAR, CIRCULAR_BEGINS, CIRCULAR_ENDS = 0, 1, 2, 3


@njit("void(f8[::1], i8[::1], f8, f8[:, ::1], i8)", cache=True)
def _forget(s: F64, lay: I64, var: float, C: F64, axis: int) -> None:
    """Add ``var`` to the covariance of the acceleration along a body axis."""
    n = lay[L_N]
    P = s[lay[L_P] : lay[L_P] + n * n].reshape((n, n))
    for i in range(3):
        for j in range(3):
            P[ACC + i, ACC + j] += var * (C[i, axis] * C[j, axis])


@njit("void(f8[::1], i8[::1], f8, f8[:, ::1])", cache=True)
def _forget_rate(s: F64, lay: I64, step: float, C: F64) -> None:
    """A step of lateral acceleration [m/s²] at a speed is one of the turn rate: add its square."""
    forward = 0.0
    for i in range(3):
        forward += C[i, 0] * s[VEL_N + i]
    if abs(forward) > SLOWEST:
        n = lay[L_N]
        s[lay[L_P] + (RATE + 2) * n + RATE + 2] += (step / forward) ** 2


@njit("i8(f8[::1], i8[::1], i8[::1], f8[::1], f8, f8, f8, f8[:, ::1])", cache=True)
def switch(s: F64, k: I64, lay: I64, par: F64, fx: float, fy: float, var: float, C: F64) -> int:
    """Look at forward and right specific force of a new sample [m/s²]; which switch it is.

    ``var``: white variance of one sample. Forgets the acceleration on the axis of a step.
    """
    found = NO_SWITCH
    if k[HAVE_FORCE] == 1 and par[SWITCH_SIGMAS] < math.inf:
        limit = par[SWITCH_SIGMAS] * math.sqrt(2.0 * var)
        if abs(fx - s[LAST_FORCE_X]) > limit:
            _forget(s, lay, par[SWITCH_VAR], C, 0)
            found = LINEAR
        if abs(fy - s[LAST_FORCE_Y]) > limit:
            _forget(s, lay, par[SWITCH_VAR], C, 1)
            _forget_rate(s, lay, fy - s[LAST_FORCE_Y], C)
            # A step back to nothing ends the turn; anything else begins or sharpens one.
            found = CIRCULAR_BEGINS if abs(fy) > abs(s[LAST_FORCE_Y]) else CIRCULAR_ENDS
            k[CIRCULAR] = found == CIRCULAR_BEGINS
    if k[CIRCULAR] == 1:
        _forget(s, lay, par[CIRCLE_VAR], C, 0)
        _forget(s, lay, par[CIRCLE_VAR], C, 1)
    s[LAST_FORCE_X], s[LAST_FORCE_Y] = fx, fy
    k[HAVE_FORCE] = 1
    return found


@njit(
    "void(f8[::1], i8[::1], f8[::1], f8[:, ::1], f8[:, ::1], i8[::1], f8[::1], f8[::1],f8[:, ::1])",
    cache=True,
)
def turn(s: F64, lay: I64, par: F64, C: F64, H: F64, cols: I64, y: F64, R: F64, W: F64) -> None:
    """Eq. 44: acceleration to the right is turn rate times forward speed."""
    nc = lateral(s, C, H, cols, y)
    R[0] = par[CIRCLE_VAR]
    apply(s, lay, H, cols, nc, y, R, 1, W)
