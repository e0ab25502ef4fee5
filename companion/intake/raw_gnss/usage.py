"""Which satellites of an epoch are used: without those at fault, all or the best set."""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.gnss.corrected import ROW_SIZE, S_SAT, S_SYSTEM
from companion.gnss.geometry import NO_DOP, best_set, dilution
from companion.gnss.single_point import SOLVED, TOO_FEW
from companion.intake.raw_gnss.solution import system_of
from companion.intake.raw_gnss.state import (
    K_SATS,
    K_SET,
    K_SIGN,
    K_UNSOLVED,
    W_BEST,
    W_MARGIN,
    Z_CODE,
    Z_EXCLUDED,
    Z_NEWS,
    Z_USED,
)
from companion.types import F64, I64

_SIGN = 1_000_003


@njit("void(f8[:, ::1], i8, f8[:, ::1], i8)", cache=True, counted=False)
def _move(rows: F64, to: int, lines: F64, s: int) -> None:
    """Row and line of satellite ``s`` to a place further up."""
    if to != s:
        for i in range(ROW_SIZE):
            rows[to, i] = rows[s, i]
        for i in range(3):
            lines[to, i] = lines[s, i]


@njit(
    "i8(f8[:, ::1], i8, f8[:, ::1], i8[::1], i8, i8[::1], i8[::1], i8[::1])",
    cache=True,
    counted=False,
)
def leave_out(
    rows: F64, m: int, lines: F64, used: I64, code: int, count: I64, excluded: I64, epoch: I64
) -> int:
    """Keep the satellites that may be used after the test of faults; returns how many.

    Where the epoch is solved, those left out are ``excluded``; else all go. ``count`` (SYSTEMS,)
    is scratch.
    """
    if code != SOLVED:
        return 0
    count[:] = 0
    for s in range(m):
        count[int(rows[s, S_SYSTEM])] += 1
    kept, gone = 0, 0
    for s in range(m):
        # Judged by the residuals; the only one of its system was left out unjudged.
        if used[s] == 1 or count[int(rows[s, S_SYSTEM])] == 1:
            _move(rows, kept, lines, s)
            kept += 1
        else:
            excluded[gone] = int(rows[s, S_SAT])
            gone += 1
    epoch[Z_EXCLUDED] = gone
    return kept


@njit("i8(f8[:, ::1], i8, f8[:, ::1], i8[::1], f8[::1], i8[::1])", cache=True)
def choose(rows: F64, m: int, lines: F64, systems: I64, settings: F64, memory: I64) -> int:
    """Keep the best set of the configured size; returns how many are kept.

    The set of the epoch before stays until another is better by the margin. ``systems`` is filled.
    """
    for s in range(m):
        systems[s] = int(rows[s, S_SYSTEM])
    count = int(settings[W_BEST])
    if count == 0 or m <= count:
        return m
    best = np.empty(count, np.int64)
    found = best_set(lines, systems, m, count, best)
    if found >= NO_DOP:
        return m
    old, same = np.empty(m, np.int64), 0
    for s in range(m):
        for k in range(memory[K_SET]):
            if memory[K_SATS + k] == int(rows[s, S_SAT]):
                old[same] = s
                same += 1
                break
    if same == count:
        sub, kinds, dop = np.empty((count, 3)), np.empty(count, np.int64), np.empty(5)
        for k in range(count):
            kinds[k] = systems[old[k]]
            for i in range(3):
                sub[k, i] = lines[old[k], i]
        dilution(sub, kinds, count, np.empty((8, 8)), dop)
        if dop[0] <= found * (1.0 + settings[W_MARGIN]):
            best = old[:count]
    for k in range(count):
        _move(rows, k, lines, best[k])
        systems[k] = systems[best[k]]
    return count


@njit(
    "void(f8[:, ::1], i8, i8[::1], i8[::1], i8[::1], f8[::1], i8[::1], i8[::1])",
    cache=True,
    counted=False,
)
def remember(
    rows: F64, m: int, excluded: I64, sat: I64, row_of: I64, settings: F64, memory: I64, epoch: I64
) -> None:
    """Whether others are used, at fault or without an ephemeris than in the epoch before."""
    sign, bad = 0, epoch[Z_CODE] != SOLVED and epoch[Z_CODE] != TOO_FEW
    for s in range(m):
        memory[K_SATS + s] = int(rows[s, S_SAT])
        sign = sign * _SIGN + memory[K_SATS + s]
    for s in range(epoch[Z_EXCLUDED]):
        sign = sign * _SIGN + 1_000 + excluded[s]
    for k in range(sat.shape[0]):
        # Below −1: an ephemeris that may not be used; one that is missing is no news.
        if system_of(sat[k], settings) >= 0 and row_of[sat[k]] < -1:
            sign = sign * _SIGN - 1_000 * row_of[sat[k]] + sat[k]
    epoch[Z_USED] = memory[K_SET] = m
    epoch[Z_NEWS] = 1 if sign != memory[K_SIGN] else 0
    memory[K_SIGN] = sign
    memory[K_UNSOLVED] += 1 if bad else 0
