"""One fused increment from the increments of several units over the same interval.

Each unit's bias against the others is taken off first, so that one that drops out or comes back
moves nothing. What is fused is a weighted mean of the units that lie near the centre of all: with
three or more the median, which one that has gone wrong cannot move far.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.intake.fusion.layout import (
    ALPHA,
    CENTRE,
    DISAGREE,
    DISCORD,
    EPOCHS,
    EXCESS,
    GAPS,
    KNOWN,
    LAST,
    LEVER,
    MISSED,
    NOW,
    OMEGA,
    OUTLIERS,
    SAMPLES,
    SCATTER,
    SUM_E,
    SUM_EE,
    T_LAST,
    T_RAIL,
    TERMS,
    TOOK,
    TRUSTED,
    WEIGHT,
    WHY,
)
from companion.intake.fusion.resample import integral_at
from companion.types import F64, I64

ALPHA_S = 0.02
"""Low pass of the rate's derivative [s]: differencing makes white noise of it, vibration more."""
OUTLIER_SD = 10.0
"""Deviations of a sample from the centre that a trusted unit may have, in usual ones; a tenth of
what is measured comes on top, or a knock would count."""
OUTLIER_SHARE = 0.1
NOW_SHARE = 0.15
"""Of an epoch in the low-passed deviation, which is held to six of its own deviations and a
twentieth of what is measured: a step shows in it before its window is over."""
NOW_SD, NOW_EXTRA = 6.0, 0.05
DISCORD_S = 0.5
"""For so long the half difference of two units that disagree lasts: σ² 2τ is the density [s]."""


@njit("f8(f8[::1], i8)", cache=True)
def middle(values: F64, count: int) -> float:
    """Median of the first ``count`` values, which are sorted in place."""
    for i in range(1, count):
        x = values[i]
        j = i - 1
        while j >= 0 and values[j] > x:
            values[j + 1] = values[j]
            j -= 1
        values[j + 1] = x
    half = count // 2
    if count % 2 == 1:
        return float(values[half])
    return 0.5 * float(values[half - 1] + values[half])


@njit("void(f8[::1], f8[::1], f8[::1])", cache=True)
def lever_force(arm: F64, common: F64, out: F64) -> None:
    """``out`` (3,): α × r + ω × (ω × r), what a unit at ``arm`` feels beyond the first one."""
    w, a = common[OMEGA : OMEGA + 3], common[ALPHA : ALPHA + 3]
    along = w[0] * arm[0] + w[1] * arm[1] + w[2] * arm[2]
    square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    out[0] = a[1] * arm[2] - a[2] * arm[1] + w[0] * along - square * arm[0]
    out[1] = a[2] * arm[0] - a[0] * arm[2] + w[1] * along - square * arm[1]
    out[2] = a[0] * arm[1] - a[1] * arm[0] + w[2] * along - square * arm[2]


@njit(
    "i8(i8, f8, i8[::1], f8[:, ::1], i8[:, ::1], i8[:, ::1], f8[:, :, ::1], f8[:, :, ::1],"
    "i8[:, ::1], f8[:, ::1], i8[::1])",
    cache=True,
)
def increments(
    t: int,
    dt: float,
    clock: I64,
    s: F64,
    k: I64,
    T: I64,
    X: F64,
    sums: F64,
    gaps: I64,
    x: F64,
    valid: I64,
) -> int:
    """Mean outputs ``x`` (U, 6) over the ``dt`` up to ``t``, and which units have them; how many.

    ``valid`` (U,): 1 for a whole interval without a gap.
    """
    total = np.empty(6)
    count = 0
    for u in range(s.shape[0]):
        before = integral_at(u, t, k[u], T, X, sums, gaps, total)
        valid[u] = 1 if before >= 0 and k[u, KNOWN] == 1 and before == k[u, GAPS] else 0
        if valid[u] == 0:
            k[u, MISSED] += clock[T_LAST] > 0
        for a in range(6):
            x[u, a] = (total[a] - s[u, LAST + a]) / dt if valid[u] == 1 else 0.0
            if before >= 0:
                s[u, LAST + a] = total[a]
        k[u, KNOWN] = 1 if before >= 0 else 0
        k[u, GAPS] = before
        count += valid[u]
    return count


@njit("void(i8, i8[::1], i8, i8[::1], f8[::1], f8[:, ::1])", cache=True)
def _note_discord(sensor: int, used: I64, count: int, clock: I64, common: F64, x: F64) -> None:
    """What two units that have declared their disagreement add to the noise of their mean."""
    common[EXCESS + sensor] = 0.0
    if count != 2 or clock[DISAGREE] == 0:
        common[DISCORD + sensor] = 0.0
        return
    square, sign = 0.0, 1.0
    difference = np.zeros(3)
    for u in range(used.shape[0]):
        if used[u] == 1:
            for a in range(3):
                difference[a] += 0.5 * sign * x[u, 3 * sensor + a]
            sign = -1.0
    for a in range(3):
        square = max(square, difference[a] * difference[a])
    # Quick to grow, slow to forget.
    old = common[DISCORD + sensor]
    common[DISCORD + sensor] = square if square > old else old + 0.02 * (square - old)
    common[EXCESS + sensor] = 2.0 * DISCORD_S * common[DISCORD + sensor]


@njit(
    "i8(i8, i8[::1], i8[::1], f8[:, ::1], i8[:, ::1], f8[:, :, :, ::1], f8[::1], f8[:, ::1],"
    "f8[::1], f8[::1])",
    cache=True,
)
def weigh(
    sensor: int,
    valid: I64,
    clock: I64,
    s: F64,
    k: I64,
    P: F64,
    common: F64,
    x: F64,
    centre: F64,
    fused: F64,
) -> int:
    """Centre and weighted mean of one sensor over the units that are trusted; how many took part.

    Biases are off ``x`` already. Without a trusted unit all that are valid take part.
    """
    units, o = s.shape[0], 3 * sensor
    used = np.zeros(units, np.int64)
    count = 0
    for relaxed in range(3):
        for u in range(units):
            fit = valid[u] == 1
            if relaxed < 2:
                fit = fit and k[u, WHY] == TRUSTED
            if relaxed < 1:
                # Cut off within this interval: the amount is not known.
                fit = fit and k[u, T_RAIL] <= clock[T_LAST]
            used[u] = 1 if fit else 0
            count += used[u]
        if count > 0:
            break
    near = np.empty(units)
    size = 0.0
    for a in range(o, o + 3):
        m = 0
        for u in range(units):
            if used[u] == 1:
                near[m] = x[u, a]
                m += 1
        centre[a] = middle(near, m)
        size += centre[a] * centre[a]
    if count > 2 and common[SCATTER + sensor] > 0.0:
        limit = OUTLIER_SD * math.sqrt(common[SCATTER + sensor]) + OUTLIER_SHARE * math.sqrt(size)
        white = common[SCATTER + sensor] * NOW_SHARE / (2.0 - NOW_SHARE)
        lasting = NOW_SD * math.sqrt(white) + NOW_EXTRA * math.sqrt(size)
        for u in range(units):
            far = False
            for a in range(o, o + 3):
                # Until it is learned, the bias may be that much of it.
                room = limit + 4.0 * math.sqrt(P[u, a, 0, 0])
                far = far or not abs(x[u, a] - centre[a]) <= room
                slack = lasting + 4.0 * math.sqrt(P[u, a, 0, 0])
                far = far or abs(s[u, NOW + a]) > slack
            if used[u] == 1 and far and count > 1:
                used[u] = 0
                count -= 1
                k[u, OUTLIERS] += 1
    total = 0.0
    for a in range(o, o + 3):
        fused[a] = 0.0
    for u in range(units):
        if used[u] == 1:
            total += s[u, WEIGHT + sensor]
            for a in range(o, o + 3):
                fused[a] += s[u, WEIGHT + sensor] * x[u, a]
    for a in range(o, o + 3):
        fused[a] /= total
        for u in range(units):
            if used[u] == 1:
                s[u, TOOK + a] += s[u, WEIGHT + sensor] / total * (x[u, a] - centre[a])
    _note_discord(sensor, used, count, clock, common, x)
    return count


@njit("void(f8[:, ::1], f8[:, :, ::1])", cache=True)
def correct(x: F64, terms: F64) -> None:
    """Take off ``x`` (U, 6) what each unit is known to measure beside the others.

    x − b − M x, with b and the rows of M in ``terms`` (U, 6, TERMS); M is small.
    """
    raw = np.empty(6)
    for u in range(x.shape[0]):
        for a in range(6):
            raw[a] = x[u, a]
        for a in range(6):
            o = 3 * (a // 3)
            x[u, a] -= terms[u, a, 0]
            for i in range(1, TERMS):
                x[u, a] -= terms[u, a, i] * raw[o + i - 1]


@njit(
    "void(f8, i8[::1], i8[::1], f8[:, ::1], f8[:, ::1], i8[:, ::1], f8[:, :, ::1],"
    "f8[:, :, :, ::1], f8[::1], f8[:, ::1], f8[::1])",
    cache=True,
)
def combine(
    dt: float,
    valid: I64,
    clock: I64,
    unit: F64,
    s: F64,
    k: I64,
    terms: F64,
    P: F64,
    common: F64,
    x: F64,
    fused: F64,
) -> None:
    """Fuse what the units measured over ``dt``, and add up how far each is off the centre.

    ``x`` (U, 6) loses lever arms and known differences; ``fused`` (6,) is filled.
    """
    units = s.shape[0]
    centre = np.zeros(6)
    force = np.zeros(3)
    turned = x.copy()
    correct(turned, terms)
    weigh(0, valid, clock, s, k, P, common, turned, centre, fused)
    keep = dt / (ALPHA_S + dt)
    for a in range(3):
        turn = (fused[a] - common[OMEGA + a]) / dt
        # The first rate has none before it.
        common[ALPHA + a] += keep * (turn - common[ALPHA + a]) if clock[EPOCHS] > 0 else 0.0
        common[OMEGA + a] = fused[a]
    for u in range(units):
        lever_force(unit[u, LEVER : LEVER + 3], common, force)
        for a in range(3):
            x[u, 3 + a] -= force[a]
    correct(x, terms)
    weigh(1, valid, clock, s, k, P, common, x, centre, fused)
    clock[EPOCHS] += 1
    for a in range(6):
        common[CENTRE + a] += centre[a]
    for u in range(units):
        if valid[u] == 1:
            k[u, SAMPLES] += 1
            for a in range(6):
                e = x[u, a] - centre[a]
                s[u, SUM_E + a] += e
                s[u, NOW + a] += NOW_SHARE * (e - s[u, NOW + a])
                s[u, SUM_EE + a // 3] += e * e / 3.0
