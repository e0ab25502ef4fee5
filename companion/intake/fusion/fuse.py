"""Arrivals of several units in, fused epochs out: when an epoch is due, and what is made of it.

The epochs are those of the first unit that is trusted and in time. Each waits until every unit that
is in time covers it; one that falls further behind than that is not waited for. All of it follows
from the samples in their order of arrival, however they are cut into calls.
"""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.intake.fusion.combine import combine, correct, increments, lever_force
from companion.intake.fusion.exclude import close_window
from companion.intake.fusion.layout import (
    C_WAIT_NS,
    CELL,
    END,
    EXCESS,
    FIRST,
    LEVER,
    OMEGA,
    PULLED,
    RING,
    ROW_EXCESS,
    ROW_INTERVAL,
    T_LAST,
    TRUSTED,
    WHY,
)
from companion.intake.fusion.resample import push
from companion.types import F64, I64

WINDOW_NS = 250_000_000


@njit("i8(f8[::1], i8[:, ::1], i8[::1], i8[:, ::1])", cache=True)
def pace(config: F64, k: I64, clock: I64, T: I64) -> int:
    """Place ``unit · RING + index`` in the rings of the sample that sets the next epoch, or −1."""
    units = k.shape[0]
    wait = int(config[C_WAIT_NS])
    newest = np.zeros(units, np.int64)
    head = 0
    for u in range(units):
        if k[u, END] > 0:
            newest[u] = T[u, (k[u, END] - 1) % RING]
            head = max(head, newest[u])
    leader = -1
    for trusted in (1, 0):
        for u in range(units):
            fit = k[u, END] > 0 and head - newest[u] <= wait
            if leader < 0 and fit and (trusted == 0 or k[u, WHY] == TRUSTED):
                leader = u
    if leader < 0 or newest[leader] <= clock[T_LAST]:
        return -1
    j = k[leader, FIRST]
    while T[leader, j % RING] <= clock[T_LAST]:
        j += 1
    t = T[leader, j % RING]
    for u in range(units):
        if k[u, END] > 0 and head - newest[u] <= wait and newest[u] < t:
            return -1
    return int(leader * RING + j % RING)


@njit(
    "void(i8, f8[:, ::1], f8[:, ::1], i8[:, ::1], f8[:, :, ::1], f8[:, :, :, ::1], f8[::1],"
    "i8[::1], i8[:, ::1], f8[:, :, ::1], f8[:, :, ::1], i8[:, ::1], f8[::1])",
    cache=True,
)
def epoch(
    place: int,
    unit: F64,
    s: F64,
    k: I64,
    terms: F64,
    P: F64,
    common: F64,
    clock: I64,
    T: I64,
    X: F64,
    sums: F64,
    gaps: I64,
    row: F64,
) -> None:
    """Fill the fused row (FUSED_SIZE,) of the epoch that the sample at ``place`` sets.

    Where no unit covers the time since the last epoch (the first one, a pause of all), the row is
    that sample itself.
    """
    units = s.shape[0]
    leader, at = place // RING, place % RING
    t = T[leader, at]
    dt = (t - clock[T_LAST]) * 1e-9
    x = np.empty((units, 6))
    valid = np.zeros(units, np.int64)
    if increments(t, dt, clock, s, k, T, X, sums, gaps, x, valid) > 0:
        combine(dt, valid, clock, unit, s, k, terms, P, common, x, row[:6])
        row[ROW_INTERVAL] = dt
        for sensor in range(2):
            row[ROW_EXCESS + sensor] = common[EXCESS + sensor] + common[PULLED + sensor] / dt
            common[PULLED + sensor] = 0.0
    else:
        force = np.zeros(3)
        lever_force(unit[leader, LEVER : LEVER + 3], common, force)
        one = X[leader, at : at + 1, :6].copy()
        for a in range(3):
            one[0, 3 + a] -= force[a]
        correct(one, terms[leader : leader + 1])
        for a in range(6):
            row[a] = one[0, a]
        for a in range(3):
            common[OMEGA + a] = row[a]
        row[ROW_INTERVAL] = X[leader, at, 6]
        row[ROW_EXCESS] = row[ROW_EXCESS + 1] = 0.0
    if clock[T_LAST] == 0:
        clock[CELL] = t // WINDOW_NS
    clock[T_LAST] = t


@njit(
    "void(i8[::1], i8[::1], f8[:, ::1], i8[::1], f8[::1], f8[:, ::1], f8[:, ::1], i8[:, ::1],"
    "f8[:, :, ::1], f8[:, :, :, ::1], f8[:, :, :, ::1], f8[::1], i8[::1], i8[:, ::1],"
    "f8[:, :, ::1], f8[:, :, ::1], i8[:, ::1], i8[::1], i8[::1], f8[:, ::1], i8[::1],"
    "f8[:, ::1])",
    cache=True,
    entry=True,
)
def fuse(
    of: I64,
    times: I64,
    samples: F64,
    count: I64,
    config: F64,
    unit: F64,
    s: F64,
    k: I64,
    terms: F64,
    P: F64,
    pairs: F64,
    common: F64,
    clock: I64,
    T: I64,
    X: F64,
    sums: F64,
    gaps: I64,
    out_t: I64,
    out_of: I64,
    out: F64,
    news_t: I64,
    news: F64,
) -> None:
    """Take samples (N, 7) of units ``of`` (N,) at ``times`` (N,) in their order of arrival.

    Fused rows go to ``out`` with their times and the arrival that completed each, what is to be
    told to ``news``; ``count`` (2,): how many of both.
    """
    units = s.shape[0]
    fresh = np.empty((4 * units, news.shape[1]))
    for m in range(of.shape[0]):
        u = of[m]
        if not push(u, times[m], samples[m], unit[u], s[u], k[u], T, X, sums, gaps):
            continue
        place = pace(config, k, clock, T)
        while place >= 0 and count[0] < out.shape[0] and count[1] + 4 * units < news.shape[0]:
            row = out[count[0]]
            epoch(place, unit, s, k, terms, P, common, clock, T, X, sums, gaps, row)
            t = clock[T_LAST]
            out_t[count[0]], out_of[count[0]] = t, m
            count[0] += 1
            if t // WINDOW_NS != clock[CELL]:
                told = close_window(t, config, unit, s, k, terms, P, pairs, common, clock, T, fresh)
                clock[CELL] = t // WINDOW_NS
                for i in range(told):
                    news_t[count[1]] = t
                    for c in range(news.shape[1]):
                        news[count[1], c] = fresh[i, c]
                    count[1] += 1
            place = pace(config, k, clock, T)
