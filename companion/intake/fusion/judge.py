"""How far each unit is off the others: once a window, against what noise and mismatch explain.

How a unit differs from the centre of all is a bias and a small share of what is measured (scale,
misalignment), followed axis by axis by a Kalman filter of four states; what is left over is noise,
or a fault.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.intake.fusion.combine import middle
from companion.intake.fusion.layout import (
    BEFORE,
    BIAS_STEP,
    BIAS_VAR,
    C_MISMATCH,
    CENTRE,
    CENTRE_BEFORE,
    HAVE_BEFORE,
    MOVED,
    ONSET,
    OVER,
    PULL,
    PULLED,
    RATIO,
    SLOW,
    SUM_E,
    TERMS,
    TOOK,
    TRUSTED,
    VAR_0,
    WEIGHT,
    WHY,
    WORST,
)
from companion.types import F64, I64

WINDOW_S = 0.25
FAR = 6.0
"""Standard deviations, of a window or of the mean over some four seconds, that are too far off."""
SLOW_SHARE = 1.0 / 16.0
"""Of a window in that mean; its white part is then a thirty-first of a window's."""
SKEW_S = 0.001
"""Stamps of two units may be so far from simultaneous: what changes meanwhile is no fault."""
PLAUSIBLE = 5.0
"""Standard deviations of bias and mismatch at the start beyond which no unit is by itself."""
LONG_SHARE, SHORT_SHARE = 1.0 / 120.0, 1.0 / 6.0
"""Of a window in the noise of a unit as it usually is (30 s) and as it is (1.5 s)."""
LEARNING = 40
"""Windows, ten seconds, before noise is held against what is usual."""
BOUNDED = 9.0
"""A unit's variance counts for at most, and at least, so many times the median one."""
LATELY = 1.0 - 1.0 / 40.0
"""Memory of what a unit did to the mean, a window: ten seconds, what a drift takes to be found."""


@njit("void(i8[::1], f8[:, ::1], i8[:, ::1], f8[:, :, :, ::1], i8, f8[::1])", cache=True)
def learn_noise(present: I64, s: F64, k: I64, pairs: F64, windows: int, least: F64) -> None:
    """Variance of the units' window means, from how those of each pair wander apart.

    ``pairs`` (2, 2, U, U): by sensor, usual and present, V_ij = σ_i² + σ_j² from window to window;
    ``least`` (2,): what the two that were closest to each other now say of one.
    """
    units = s.shape[0]
    least[0] = least[1] = -1.0
    for i in range(units):
        for j in range(i):
            if present[i] * present[j] * k[i, HAVE_BEFORE] * k[j, HAVE_BEFORE] == 0:
                continue
            for sensor in range(2):
                v = 0.0
                for a in range(3 * sensor, 3 * sensor + 3):
                    step = s[i, SUM_E + a] - s[i, BEFORE + a] - s[j, SUM_E + a] + s[j, BEFORE + a]
                    v += step * step / 6.0
                if least[sensor] < 0.0 or 0.5 * v < least[sensor]:
                    least[sensor] = 0.5 * v
                for term in range(2):
                    old = pairs[sensor, term, i, j]
                    share = max(LONG_SHARE if term == 0 else SHORT_SHARE, 1.0 / (2.0 + windows))
                    # A fault is not what is usual.
                    new = min(v, BOUNDED * old) if term == 0 and windows > LEARNING else v
                    pairs[sensor, term, i, j] = old + share * (new - old)
                    pairs[sensor, term, j, i] = pairs[sensor, term, i, j]


@njit("void(i8[::1], f8[:, ::1], i8, i8, f8[:, :, :, ::1], f8[::1])", cache=True)
def noise_of(present: I64, unit: F64, sensor: int, term: int, pairs: F64, out: F64) -> None:
    """``out`` (U,): variance of the window means of each present unit.

    Of three or more, σ_i² from the V_ij of all pairs (a "three-cornered hat"); of two, what they
    share, parted as their datasheets say. No less than a quarter of what the datasheet gives.
    """
    units = present.shape[0]
    count, whole, said = 0, 0.0, 0.0
    for i in range(units):
        count += present[i]
        said += unit[i, VAR_0 + sensor] * present[i]
        for j in range(i):
            if present[i] == 1 and present[j] == 1:
                whole += pairs[sensor, term, i, j]
    for i in range(units):
        out[i] = unit[i, VAR_0 + sensor]
        if present[i] == 0 or count < 2:
            continue
        mine = 0.0
        for j in range(units):
            if j != i and present[j] == 1:
                mine += pairs[sensor, term, i, j]
        if count > 2:
            mine = (mine - whole / (count - 1.0)) / (count - 2.0)
        else:
            mine *= unit[i, VAR_0 + sensor] / said
        out[i] = max(mine, 0.25 * unit[i, VAR_0 + sensor])


@njit("void(i8[::1], f8[:, ::1], f8[:, ::1], f8[:, :, :, ::1], f8[::1], f8[::1])", cache=True)
def set_weights(trusted: I64, unit: F64, s: F64, pairs: F64, least: F64, typical: F64) -> None:
    """Inverse variances, each bounded by the median of those trusted.

    ``typical`` (2,) is that, or more where all have just become noisier: motors start.
    """
    units = s.shape[0]
    var, near = np.empty(units), np.empty(units)
    for sensor in range(2):
        noise_of(trusted, unit, sensor, 0, pairs, var)
        m = 0
        for u in range(units):
            if trusted[u] == 1:
                near[m] = var[u]
                m += 1
        if m == 0:
            continue
        typical[sensor] = middle(near, m)
        for u in range(units):
            if trusted[u] == 1:
                low, high = typical[sensor] / BOUNDED, typical[sensor] * BOUNDED
                s[u, WEIGHT + sensor] = 1.0 / min(max(var[u], low), high)
        noise_of(trusted, unit, sensor, 1, pairs, var)
        m = 0
        for u in range(units):
            if trusted[u] == 1:
                near[m] = var[u]
                m += 1
        typical[sensor] = max(typical[sensor], middle(near, m), 2.0 * least[sensor])


@njit("f8(i8, f8[::1], f8[:, ::1], f8[::1])", cache=True)
def _spread(a: int, common: F64, P: F64, h: F64) -> float:
    """hᵀ P h of axis ``a``, h = (1, what was measured); h (TERMS,) is filled."""
    h[0] = 1.0
    for i in range(1, TERMS):
        h[i] = common[CENTRE + 3 * (a // 3) + i - 1]
    total = 0.0
    for i in range(TERMS):
        for j in range(TERMS):
            total += h[i] * P[i, j] * h[j]
    return total


@njit("f8(i8, f8[::1], f8)", cache=True)
def _white(a: int, common: F64, typical: float) -> float:
    """Variance of a deviation that says nothing of the next: noise, and stamps a little off."""
    square = 0.0
    for i in range(3 * (a // 3), 3 * (a // 3) + 3):
        square += (common[CENTRE + i] - common[CENTRE_BEFORE + i]) ** 2
    return typical + square * (SKEW_S / WINDOW_S) ** 2


@njit(
    "void(i8, i8, f8[::1], f8[::1], f8[:, ::1], f8[:, ::1], i8[:, ::1], f8[:, :, ::1],"
    "f8[:, :, :, ::1], f8[::1])",
    cache=True,
)
def hold_against(
    u: int,
    trusted: int,
    config: F64,
    typical: F64,
    unit: F64,
    s: F64,
    k: I64,
    terms: F64,
    P: F64,
    common: F64,
) -> None:
    """How far unit ``u`` is off over what is allowed, as squares: in this window, and for long.

    ``trusted``: how many units are. Of two, each is off by half of what they are apart.
    """
    ratio, worst, by = 0.0, 0, 0.0
    h = np.empty(TERMS)
    share = 0.5 if trusted == 2 and k[u, WHY] == TRUSTED else 1.0
    for a in range(6):
        sensor = a // 3
        e = s[u, SUM_E + a]
        known = _spread(a, common, P[u, a], h)
        white = _white(a, common, typical[sensor])
        s[u, SLOW + a] += SLOW_SHARE * (e - s[u, SLOW + a])
        now = e * e / (share * (known + white))
        slow = s[u, SLOW + a] ** 2 / (share * (known + white * SLOW_SHARE))
        differs, size = 0.0, 0.0
        for i in range(TERMS):
            differs += terms[u, a, i] * h[i]
            size += h[i] * h[i] if i > 0 else 0.0
        plausible = unit[u, BIAS_VAR + sensor] + config[C_MISMATCH] ** 2 * size
        bias = differs * differs / plausible * (FAR / PLAUSIBLE) ** 2
        if now > ratio:
            ratio, worst, by = now, a, e
        if slow > ratio:
            ratio, worst, by = slow, a, s[u, SLOW + a]
        if bias > ratio:
            ratio, worst, by = bias, a, differs
    s[u, WORST], s[u, WORST + 1] = worst, by
    s[u, RATIO] = ratio / (FAR * FAR)
    # Twice as far as is too far needs no second window.
    more = 2 if s[u, RATIO] > 4.0 else 1
    k[u, OVER] = k[u, OVER] + more if s[u, RATIO] > 1.0 else 0
    if k[u, OVER] == 0:
        for a in range(6):
            s[u, ONSET + a] = s[u, SUM_E + a]


@njit("void(i8, f8[:, ::1])", cache=True)
def note_pull(epochs: int, s: F64) -> None:
    """Add up what each unit does to the integral of the mean, over a window of ``epochs``.

    What it moved the mean by where it took part, and what of its deviation has been taken for its
    bias: that has moved the mean by as much for good.
    """
    for u in range(s.shape[0]):
        for a in range(6):
            by = s[u, TOOK + a] / max(epochs, 1) + s[u, MOVED + a]
            s[u, PULL + a] = LATELY * s[u, PULL + a] + by * WINDOW_S
            s[u, TOOK + a] = 0.0


@njit("void(i8, f8[:, ::1], f8[:, :, ::1], f8[::1])", cache=True)
def undo(u: int, s: F64, terms: F64, common: F64) -> None:
    """Take back what unit ``u``, just excluded, did to the mean of the others.

    The biases of the others go back to where they were before its fault was taken for a bias; what
    it turned and accelerated the mean by meanwhile is in attitude and velocity now, and is handed
    on as variance: part of it has been corrected by aids, nobody knows which.
    """
    for a in range(6):
        sensor = a // 3
        for v in range(s.shape[0]):
            if v != u:
                terms[v, a, 0] += s[u, MOVED + a]
        common[PULLED + sensor] = max(common[PULLED + sensor], s[u, PULL + a] ** 2)
        s[u, MOVED + a] = s[u, PULL + a] = 0.0


@njit(
    "void(i8[::1], f8[::1], f8[:, ::1], f8[:, ::1], i8[:, ::1], f8[:, :, ::1], f8[:, :, :, ::1],"
    "f8[::1])",
    cache=True,
)
def follow(
    follows: I64, typical: F64, unit: F64, s: F64, k: I64, terms: F64, P: F64, common: F64
) -> None:
    """One step of how each unit differs from the others; the mean of the trusted does not move.

    A deviation counts for no more than three standard deviations.
    """
    units = s.shape[0]
    h, Ph = np.empty(TERMS), np.empty(TERMS)
    moved, own = np.zeros(TERMS), np.zeros(units)
    for a in range(6):
        sensor = a // 3
        white = _white(a, common, typical[sensor])
        weight = 0.0
        for i in range(TERMS):
            moved[i] = 0.0
        for u in range(units):
            if follows[u] == 0:
                continue
            P[u, a, 0, 0] += unit[u, BIAS_STEP + sensor]
            S = _spread(a, common, P[u, a], h) + white
            limit = 3.0 * math.sqrt(S)
            e = min(max(s[u, SUM_E + a], -limit), limit)
            for i in range(TERMS):
                Ph[i] = 0.0
                for j in range(TERMS):
                    Ph[i] += P[u, a, i, j] * h[j]
            for i in range(TERMS):
                step = Ph[i] / S * e
                terms[u, a, i] += step
                if i == 0:
                    own[u] = step * s[u, WEIGHT + sensor]
                if k[u, WHY] == TRUSTED:
                    moved[i] += s[u, WEIGHT + sensor] * step
                for j in range(i, TERMS):
                    P[u, a, i, j] -= Ph[i] * Ph[j] / S
                    P[u, a, j, i] = P[u, a, i, j]
            if k[u, WHY] == TRUSTED:
                weight += s[u, WEIGHT + sensor]
        if weight > 0.0:
            for u in range(units):
                for i in range(TERMS):
                    terms[u, a, i] -= moved[i] / weight
                learned = own[u] / weight if follows[u] == 1 and k[u, WHY] == TRUSTED else 0.0
                s[u, MOVED + a] = LATELY * s[u, MOVED + a] + learned
