"""The one gate and the one update that every aid passes through.

    y = z − h(x),  S = H P Hᵀ + R,  NIS = yᵀ S⁻¹ y against χ²,  K = P Hᵀ S⁻¹,  P ← P − K S Kᵀ

One to three components with independent noise are gated together and then applied one after the
other. For a scalar and the optimal gain P − (PHᵀ)(PHᵀ)ᵀ/S equals the Joseph form, and its two
halves are the same products: P stays symmetric to the bit.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.adaptation.adapt import adapt, adapts
from companion.estimation.adaptation.layout import TRACE_SIZE, TRACED
from companion.estimation.parameters import BANK, FEEDFORWARD, GATE
from companion.estimation.tape import RECORDER, Recorder, record_turn, record_update
from companion.navigation.error_model import box_plus
from companion.navigation.layout import (
    ATT,
    BANK_DOF,
    BANK_NIS,
    DX,
    L_N,
    LOG_LIKELIHOOD,
    VELOCITY_FIT,
)
from companion.navigation.layout import P as P_OFFSET
from companion.types import F64, I64

# --- columns of a report row
R_CHANNEL, R_SOURCE, R_DOF = 0, 1, 2
R_INNOVATION, R_SD = 3, 6
R_NIS, R_GATE, R_SCALE_USED, R_VERDICT = 9, 10, 11, 12
R_TRACE = 13  # what the adaptation made of it, see adaptation/layout.py
REPORT_SIZE = R_TRACE + TRACE_SIZE

VELOCITY_H, ZERO_VELOCITY, ZERO_RATE = 2, 7, 8  # as types.Channel
ACCEPTED, REJECTED_GATE, REFUSED_INVALID = 0.0, 1.0, 4.0
FIT_UPDATES = 50.0
"""Updates over which the fit of horizontal velocity is averaged."""
WINSOR = 25.0
"""Cap on NIS in the likelihood of a heading hypothesis: one outlier must not decide."""


@njit("f8(f8[:, ::1], f8[::1], i8, f8[:, ::1])", cache=True, counted=False)
def normalised_square(S: F64, y: F64, m: int, L: F64) -> float:
    """yᵀ S⁻¹ y by Cholesky of the leading m×m of ``S``, factor in ``L``. −1: not definite."""
    total = 0.0
    for i in range(m):
        for j in range(i + 1):
            x = S[i, j]
            for k in range(j):
                x -= L[i, k] * L[j, k]
            if i == j:
                if not x > 0.0:
                    return -1.0
                L[i, i] = math.sqrt(x)
            else:
                L[i, j] = x / L[j, j]
        x = y[i]
        for k in range(i):
            x -= L[i, k] * L[3, k]
        L[3, i] = x / L[i, i]
        total += L[3, i] * L[3, i]
    return total


@njit("void(f8[:, ::1], f8[::1], i8)", cache=True, counted=False)
def reset_covariance(P: F64, dx: F64, n: int) -> None:
    """P ← G P Gᵀ for the attitude error re-expressed about the corrected attitude.

    exp(φ') = exp(φ) exp(−φ̂) gives φ' = (φ − φ̂) + ½ φ̂ × (φ − φ̂), so G = I + ½[φ̂×] for tilt.
    About the vertical the whole φ̂_D turns P: what is known of level (and its correlation with the
    accelerometer bias) was learned in body axes whatever the heading, so it goes round with a
    correction of it. The other half is the second-order term of C(φ̂) b that the update left out.
    """
    x, y, z = 0.5 * dx[ATT], 0.5 * dx[ATT + 1], dx[ATT + 2]
    for j in range(n):
        a, b, c = P[ATT, j], P[ATT + 1, j], P[ATT + 2, j]
        P[ATT, j] = a - z * b + y * c
        P[ATT + 1, j] = b + z * a - x * c
        P[ATT + 2, j] = c - y * a + x * b
    for j in range(n):
        a, b, c = P[j, ATT], P[j, ATT + 1], P[j, ATT + 2]
        P[j, ATT] = a - z * b + y * c
        P[j, ATT + 1] = b + z * a - x * c
        P[j, ATT + 2] = c - y * a + x * b
    for i in range(ATT, ATT + 3):
        for j in range(n):
            if j < ATT or j > i:
                P[j, i] = P[i, j]


@njit(
    "f8(f8[::1], i8[::1], i8[::1], f8[:, ::1], f8[::1], f8[::1], i8, f8[:, ::1])",
    cache=True,
    counted=False,
)
def foresee(s: F64, lay: I64, ipar: I64, H: F64, y: F64, R: F64, m: int, W: F64) -> float:
    """NIS of ``m`` components against what the filter foresees; −1: S is not definite.

    ``y`` loses what the error carried in feedforward mode foresees. Of the scratch ``W`` (≥ 12,
    ≥ n), rows 0 to 2 are H P, 4 to 6 S, 7 to 10 its factor and the whitened innovation, 11 the
    diagonal of H P Hᵀ.
    """
    n = lay[L_N]
    P = s[P_OFFSET : P_OFFSET + n * n].reshape((n, n))
    PHt, S, L, foreseen = W[:3], W[4:7], W[7:11], W[11]
    for i in range(m):
        for j in range(n):
            PHt[i, j] = 0.0
        for k in range(n):
            h = H[i, k]
            if h != 0.0:
                if ipar[FEEDFORWARD] == 1:
                    y[i] -= h * s[DX + k]
                for j in range(n):
                    PHt[i, j] += h * P[k, j]
    for i in range(m):
        for j in range(i + 1):
            x = 0.0
            for k in range(n):
                x += H[j, k] * PHt[i, k]
            S[i, j] = x
            S[j, i] = x
        foreseen[i] = S[i, i]
        S[i, i] += R[i]
    return float(normalised_square(S, y, m, L))


@njit("UniTuple(f8, 2)(f8[:, ::1], f8[::1], f8[::1], f8, f8, f8[::1])", cache=True, counted=False)
def against(P: F64, dx: F64, H: F64, y: float, R: float, a: F64) -> tuple[float, float]:
    """S and innovation of one component, ``dx`` (n,) being corrected already; ``a`` ← P Hᵀ (n,)."""
    n = P.shape[0]
    for j in range(n):
        a[j] = 0.0
    for i in range(n):
        h = H[i]
        if h != 0.0:
            for j in range(n):
                a[j] += h * P[i, j]
    S = R
    for i in range(n):
        S += H[i] * a[i]
        y -= H[i] * dx[i]
    return S, y


@njit(f"void(f8[:, ::1], f8[::1], f8[::1], f8[::1], f8, f8, {RECORDER})", cache=True, counted=False)
def apply(P: F64, dx: F64, H: F64, a: F64, S: float, y: float, tape: Recorder) -> None:
    """Correct ``dx`` (n,) and P by one component of :func:`against`; ``a`` becomes P Hᵀ/√S."""
    n = P.shape[0]
    r = 1.0 / math.sqrt(S)
    for j in range(n):
        a[j] *= r
    record_update(tape, H, a, r, y, n)
    for j in range(n):
        g = a[j]
        dx[j] += g * (r * y)
        for i in range(n):
            P[j, i] -= g * a[i]


@njit("void(f8[::1], f8, i8)", cache=True, counted=False)
def note_velocity_fit(s: F64, nis: float, m: int) -> None:
    """Take one NIS of ``m`` components of velocity into the running mean."""
    s[VELOCITY_FIT] += (min(nis, WINSOR) / m - s[VELOCITY_FIT]) / FIT_UPDATES


@njit(
    "b1(f8[::1], i8[::1], f8[::1], i8[::1], i8, i8, f8, f8[:, ::1], f8[::1], f8[::1], i8,"
    f"f8[:, ::1], f8[::1], {RECORDER})",
    cache=True,
    counted=False,
)
def fuse(
    s: F64,
    lay: I64,
    par: F64,
    ipar: I64,
    channel: int,
    source: int,
    barred: float,
    H: F64,
    y: F64,
    R: F64,
    m: int,
    W: F64,
    report: F64,
    tape: Recorder,
) -> bool:
    """Gate ``m`` components (``H`` (3, n), ``y`` (3,), variances ``R`` (3,)) and apply them.

    ``barred`` is the verdict on a measurement that is not to be used whatever its innovation, 0 for
    none. Fills ``report`` and returns whether the measurement was accepted. ``W`` (≥ 12, ≥ n) is
    scratch, its fourth row the correction; ``tape`` is what a smoother reads later.
    """
    n = lay[L_N]
    P = s[P_OFFSET : P_OFFSET + n * n].reshape((n, n))
    PHt, dx, S, L, foreseen = W[:3], W[3], W[4:7], W[7:11], W[11]
    nis = foresee(s, lay, ipar, H, y, R, m, W)
    gate = par[GATE + m - 1]
    scale = 1.0
    report[R_TRACE + TRACED] = 0.0
    if nis >= 0.0 and barred == ACCEPTED and adapts(ipar, channel):
        trace = report[R_TRACE : R_TRACE + TRACE_SIZE]
        scale = adapt(s, par, ipar, channel, m, y, L[3], foreseen, R, nis, gate, trace)
        if scale != 1.0:
            for i in range(m):
                S[i, i] = foreseen[i] + R[i] * scale
            nis = normalised_square(S, y, m, L)
    report[R_CHANNEL], report[R_SOURCE], report[R_DOF] = channel, source, m
    for i in range(3):
        report[R_INNOVATION + i] = y[i] if i < m else np.nan
        report[R_SD + i] = math.sqrt(S[i, i]) if i < m else np.nan
    report[R_NIS], report[R_GATE], report[R_SCALE_USED] = nis, gate, scale
    if not nis >= 0.0:
        report[R_VERDICT] = REFUSED_INVALID
        return False
    if barred != ACCEPTED:
        report[R_VERDICT] = barred
        return False
    if channel == VELOCITY_H:
        note_velocity_fit(s, nis, m)
    if ipar[BANK] == 1 and channel != ZERO_VELOCITY and channel != ZERO_RATE:
        # Hypotheses compete on how well they foresee the aids; a standstill favours none of them.
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

    for j in range(n):
        dx[j] = 0.0
    for i in range(m):
        S_one, e = against(P, dx, H[i], y[i], R[i] * scale, PHt[i])
        apply(P, dx, H[i], PHt[i], S_one, e, tape)
    if ipar[FEEDFORWARD] == 1:
        for j in range(n):
            s[DX + j] += dx[j]
    else:
        box_plus(s, lay, dx)
        reset_covariance(P, dx, n)
        record_turn(tape, dx)
    return True
