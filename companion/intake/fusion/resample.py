"""Samples of one unit as an integral over time that can be asked at any moment they cover.

A unit that gives rates is integrated by the trapezoid rule, one that gives integrals piece by
piece: the difference of two moments is the increment between them, whatever the unit's own epochs.
"""

from __future__ import annotations

from companion._jit import njit
from companion.intake.fusion.layout import (
    END,
    FIRST,
    OUT_OF_ORDER,
    PERIOD,
    RAILED,
    RANGE,
    RING,
    SAME,
    T_CHANGE,
    T_RAIL,
)
from companion.types import F64, I64

GAP_S = 0.05
"""A pause longer than this and two usual periods is a gap: nothing is said across it."""
CLOCK_BACK_NS = 1_000_000_000
"""A clock that goes back further than this has been restarted; less is a late sample."""
AT_RAIL = 0.999
"""Share of the full scale from which a sample counts as cut off."""


@njit(
    "b1(i8, i8, f8[::1], f8[::1], f8[::1], i8[::1], i8[:, ::1], f8[:, :, ::1], f8[:, :, ::1],"
    "i8[:, ::1])",
    cache=True,
)
def push(
    u: int, t: int, x: F64, unit: F64, s: F64, k: I64, T: I64, X: F64, sums: F64, gaps: I64
) -> bool:
    """Take a sample ``x`` (7,) of unit ``u`` at ``t``; false where it is not later than the last.

    The ring: times ``T`` (U, RING), values ``X`` and their integrals ``sums`` (U, RING, 6), and how
    many ``gaps`` (U, RING) there have been.
    """
    end = k[END]
    at = end % RING
    railed = False
    for sensor in range(2):
        for a in range(3):
            railed = railed or abs(x[3 * sensor + a]) >= AT_RAIL * unit[RANGE + sensor]
    if end == 0:
        gap, h = 0, 0.0
        for a in range(6):
            X[u, at, a], sums[u, at, a] = x[a], 0.0
        k[T_CHANGE], k[SAME] = t, 0
    else:
        before = (end - 1) % RING
        back = T[u, before] - t
        if 0 <= back <= CLOCK_BACK_NS:
            k[OUT_OF_ORDER] += 1
            return False
        if back > 0:
            # Its clock began anew: what the ring holds is of the old one.
            k[FIRST] = end
        h = (t - T[u, before]) * 1e-9
        gap = 1 if h > GAP_S + 2.0 * s[PERIOD] or h < 0.0 else 0
        changed = False
        for a in range(6):
            changed = changed or x[a] != X[u, before, a]
            mean = x[a] if x[6] > 0.0 else 0.5 * (x[a] + X[u, before, a])
            X[u, at, a] = x[a]
            sums[u, at, a] = sums[u, before, a] + mean * h
        gap += gaps[u, before]
        if changed:
            k[T_CHANGE], k[SAME] = t, 0
        else:
            k[SAME] += 1
        # Learned over some fifty samples; a pause says nothing of what is usual.
        if gap == gaps[u, before]:
            s[PERIOD] += (h - s[PERIOD]) * (0.02 if s[PERIOD] > 0.0 else 1.0)
    X[u, at, 6] = x[6]
    T[u, at], gaps[u, at] = t, gap
    if railed:
        k[T_RAIL] = t
        k[RAILED] += 1
    k[END] = end + 1
    if k[END] - k[FIRST] > RING:
        k[FIRST] = k[END] - RING
    return True


@njit(
    "i8(i8, i8, i8[::1], i8[:, ::1], f8[:, :, ::1], f8[:, :, ::1], i8[:, ::1], f8[::1])",
    cache=True,
)
def integral_at(u: int, t: int, k: I64, T: I64, X: F64, sums: F64, gaps: I64, out: F64) -> int:
    """Integral of unit ``u`` up to ``t`` into ``out`` (6,); gaps before it, or −1: not covered.

    Samples that end before ``t`` are let go of: it may only grow from call to call.
    """
    j, end = k[FIRST], k[END]
    while j + 1 < end and T[u, (j + 1) % RING] <= t:
        j += 1
    k[FIRST] = j
    if j >= end or T[u, j % RING] > t:
        return -1
    a0 = j % RING
    if T[u, a0] == t:
        for a in range(6):
            out[a] = sums[u, a0, a]
        return int(gaps[u, a0])
    if j + 1 >= end:
        return -1
    a1 = (j + 1) % RING
    tau = (t - T[u, a0]) * 1e-9
    h = (T[u, a1] - T[u, a0]) * 1e-9
    for a in range(6):
        if X[u, a1, 6] > 0.0:
            out[a] = sums[u, a0, a] + X[u, a1, a] * tau
        else:
            step = X[u, a1, a] - X[u, a0, a]
            out[a] = sums[u, a0, a] + (X[u, a0, a] + step * tau / (2.0 * h)) * tau
    return int(gaps[u, a1])
