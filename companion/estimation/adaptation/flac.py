"""FLAC: exponential data weighting by fuzzy rules, after Sasiadek and Wang (1999, 2003).

    K = P⁻ Hᵀ (H P⁻ Hᵀ + R / α²)⁻¹ ,   P⁻ₖ₊₁ = α² Φ P Φᵀ + Q

P is the paper's P^α. One α holds for a fix: the mean over its channels of what nine rules say of
each channel's innovations (mean and covariance against S). Aids between two fixes are weighted by
their own R, with P as the last fix left it. The paper prints no memberships; these are quantile
ramps, as in fuzzy.py. P is not widened where it is beyond what the error equations stand for:
without that limit a heading that nothing observes is lost within seconds.
"""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.estimation.adaptation.fuzzy import fire
from companion.estimation.adaptation.layout import COUNT, FADE, FIRING, IN_MEAN, IN_SPREAD
from companion.estimation.adaptation.parameters import ALPHA_TABLE, LENGTH
from companion.estimation.adaptation.window import FEWEST, deviate_of_chi2, push, statistics
from companion.navigation.layout import (
    ACCEL_BIAS,
    ALPHA,
    ATT,
    GYRO_BIAS,
    WINDOW_SIZE,
    WINDOWS,
)
from companion.types import F64

FADED = 4
"""Channels of a fix: the first ones."""
LARGEST_ATT, LARGEST_ACCEL, LARGEST_GYRO = 0.1, 1.0, 1e-3
"""Variances that P is not widened beyond: (18°)², (1 m/s²)², (1.8 °/s)²."""


@njit("f8(f8[::1], f8[::1], i8, i8, f8[::1], f8[::1])", cache=True)
def flac_scale(s: F64, a: F64, channel: int, m: int, u: F64, trace: F64) -> float:
    """Take in one innovation, whitened ``u`` (3,); the factor 1/α² on R of this fix."""
    if channel >= FADED:
        return 1.0
    w = s[WINDOWS + channel * WINDOW_SIZE : WINDOWS + (channel + 1) * WINDOW_SIZE]
    push(w, int(a[LENGTH]), u[0], u[1], u[2])
    found = np.empty(7)
    weights = trace[FIRING : FIRING + 9]
    if statistics(w, int(a[LENGTH]), m, found):
        mean, spread = deviate_of_chi2(w[COUNT] * found[4], float(m)), found[1]
        fire(a, mean, spread, weights)
        w[FADE] = 0.0
        for i in range(9):
            w[FADE] += weights[i] * (a[ALPHA_TABLE + i] - 1.0)
        trace[IN_MEAN], trace[IN_SPREAD] = mean, spread
    return float(1.0 / (s[ALPHA] * s[ALPHA]))


@njit("b1(f8[:, ::1])", cache=True)
def small(P: F64) -> bool:
    """Whether P of the error-state filter is one that the error equations stand for."""
    for i in range(ATT, GYRO_BIAS + 3):
        largest = LARGEST_ATT if i < ACCEL_BIAS else LARGEST_ACCEL
        if i >= GYRO_BIAS:
            largest = LARGEST_GYRO
        if P[i, i] > largest:
            return False
    return True


@njit("f8(f8[::1], f8[:, ::1], i8, b1)", cache=True)
def fade(s: F64, P: F64, n: int, allowed: bool) -> float:
    """After a fix: P ← α² P where that is ``allowed``, and α of the next fix; the factor on P."""
    square = s[ALPHA] * s[ALPHA] if allowed else 1.0
    if square > 1.0:
        for i in range(n):
            for j in range(n):
                P[i, j] *= square
    total, heard = 0.0, 0.0
    for channel in range(FADED):
        w = WINDOWS + channel * WINDOW_SIZE
        if s[w + COUNT] >= FEWEST:
            total += s[w + FADE]
            heard += 1.0
    s[ALPHA] = 1.0 + total / max(heard, 1.0)
    return float(square)
