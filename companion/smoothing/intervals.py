"""Update intervals of a running tape: where they end, and which of them are due to be smoothed."""

from __future__ import annotations

from companion._jit import njit
from companion.estimation.output_row import ROW_SIZE
from companion.estimation.tape import (
    C_STEP,
    COARSE,
    F32,
    FINE,
    FIX,
    FULL_ROW,
    I8,
    KIND,
    PLAIN_ROW,
    STEP,
    read_time,
)
from companion.navigation.layout import L_N
from companion.smoothing.phi import step_size
from companion.smoothing.window import BROKEN, copy_row, numbers_of, smooth_window
from companion.types import F64, I64, Flags

# --- a boundary between update intervals: place on the tape, time, rows since the one before
TIME, ROWS, MARK = 3, 4, 5
# --- progress: boundaries known, failed windows, rows without room, intervals given out
KNOWN, FAILED, WANTED, GIVEN, PROGRESS = 0, 1, 2, 3, 4


@njit("i8(i1[::1], f8[::1], i8[::1], i8, i8, i8, i8[::1], i8[::1])", cache=True, counted=False)
def next_boundary(
    kinds: I8,
    fine: F64,
    lay: I64,
    end: int,
    settled: int,
    longest: int,
    before: I64,
    scan: I64,
) -> int:
    """Look for the end of an update interval that nothing late can change any more.

    From ``scan`` (MARK,) on, before record ``end``; times up to ``settled`` [ns] count
    as settled. An interval ends behind a fix, or in front of the first row ``longest`` [ns] after
    the boundary ``before`` (of which the very first takes its time from the first row). ``scan``
    moves on and counts the rows it passes. Returns the end's time, or −1 where there is none yet.
    """
    n = lay[L_N]
    step = step_size(lay)
    i, c, f = scan[KIND], scan[COARSE], scan[FINE]
    # Records are settled once a time behind them is: until then they are looked at again.
    while i < end:
        kind = kinds[i]
        if kind < 0:
            t = read_time(fine[f:])
            if t > settled:
                return -1
            if before[TIME] < 0:
                before[TIME] = t
            if kind != FIX and t - before[TIME] >= longest:
                scan[KIND], scan[COARSE], scan[FINE] = i, c, f
                return t
        i += 1
        f += numbers_of(kind, n, step)
        if kind == STEP:
            c += C_STEP
        if kind < 0:
            scan[ROWS] += kind != FIX
            scan[KIND], scan[COARSE], scan[FINE] = i, c, f
            if kind == FIX:
                return t
    return -1


@njit(
    "void(i1[::1], f8[::1], i8[::1], i8[::1], i8[::1], i8[::1], f8[:, ::1])",
    cache=True,
    counted=False,
)
def as_filtered(kinds: I8, fine: F64, lay: I64, a: I64, b: I64, t: I64, rows: F64) -> None:
    """The rows of the tape from ``a`` to ``b`` as the filter had them, into ``t`` and ``rows``."""
    n = lay[L_N]
    step = step_size(lay)
    f, row = a[FINE], 0
    for i in range(a[KIND], b[KIND]):
        kind = kinds[i]
        if kind in (FULL_ROW, PLAIN_ROW):
            copy_row(fine, f, row, rows, t, ROW_SIZE)
            row += 1
        f += numbers_of(kind, n, step)


@njit(
    "i8(i1[::1], f4[::1], f8[::1], i8[::1], i8, b1, i8, i8[:, ::1], i8[:, ::1], i8[::1], i8[::1],"
    "i8[::1], f8[::1], f8[::1], f8[::1], i8[::1], i8[::1], f8[:, ::1], b1[::1])",
    cache=True,
    entry=True,
)
def give_out(
    kinds: I8,
    coarse: F32,
    fine: F64,
    end: I64,
    settled: int,
    final: bool,
    longest: int,
    gaps: I64,
    marks: I64,
    scan: I64,
    progress: I64,
    lay: I64,
    par: F64,
    s: F64,
    scratch: F64,
    t: I64,
    until: I64,
    rows: F64,
    smoothed: Flags,
) -> int:
    """Smooth every interval that is due, oldest first; returns how many rows were filled.

    ``marks`` (window + 2, MARK): the boundaries that are still wanted, of which ``progress`` says
    how many; ``scan`` (MARK,): how far the tape, which stands at ``end``, was looked at. Windows
    that end inside one of ``gaps`` (K, 2) [ns] are left as the filter had them, and so are those
    that fail. With ``final`` the tape has ended: all the rest is smoothed with what there is.
    ``until`` (N,): time of the youngest data behind each row. Stops where the room ends.
    """
    window = marks.shape[0] - 2
    out = 0
    progress[WANTED] = 0
    while True:
        known = progress[KNOWN]
        newest = marks[known - 1]
        tail = marks[1]
        ended = False
        if known <= window:
            at = next_boundary(
                kinds, fine, lay, end[KIND], settled, longest, marks[known - 1], scan
            )
            if at >= 0:
                marks[known] = scan
                marks[known, TIME] = at
                scan[ROWS] = 0
                progress[KNOWN] += 1
                continue
            if not final:
                return out
            # Everything that is left, as one interval up to the end of the tape.
            ended = True
            tail = scan.copy()
            tail[:3] = end[:3]
            for i in range(1, known):
                tail[ROWS] += marks[i, ROWS]
            tail[TIME] = newest[TIME]
            newest = tail
        count = tail[ROWS]
        if out + count > t.shape[0]:
            progress[WANTED] = count
            return out
        own = slice(out, out + count)
        youngest = newest[TIME]
        skip = False
        for k in range(gaps.shape[0]):
            skip |= gaps[k, 0] <= youngest < gaps[k, 1]
        if not skip:
            done = smooth_window(
                kinds, coarse, fine, marks[0], tail, newest, lay, par, s, scratch,
                t[own], rows[own], smoothed[own],
            )  # fmt: skip
            skip = done == BROKEN
            progress[FAILED] += skip
        if skip:
            as_filtered(kinds, fine, lay, marks[0], tail, t[own], rows[own])
            smoothed[own] = False
        if ended and count > 0:
            youngest = max(youngest, t[out + count - 1])
        until[own] = youngest
        out += count
        progress[GIVEN] += 1
        if ended:
            return int(out)
        for i in range(1, known):
            marks[i - 1] = marks[i]
        progress[KNOWN] -= 1
