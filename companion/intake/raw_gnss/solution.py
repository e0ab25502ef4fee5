"""Where a receiver is, epoch by epoch: correction from about there, and the solution."""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.gnss.corrected import S_RANGE_VAR, S_RATE_VAR, S_SYSTEM
from companion.gnss.correction import O_RANGE, correct
from companion.gnss.sight import stand
from companion.gnss.single_point import P_POS, P_VEL, SOLVED, TOO_FEW, solve
from companion.gnss.systems import SYSTEMS
from companion.intake.raw_gnss.state import T_KNOWN, T_POS, T_TIME, T_VEL, W_OURS
from companion.types import F64, I64

GUESS_S = 600.0
"""A place this old no longer tells elevations or clock steps."""
AHEAD_S, AHEAD_M = 10.0, 1_000.0
"""A place is carried on with its velocity for so long and so far: rates are not tested for faults,
and a wrong velocity must not take satellites below the horizon."""


@njit("b1(f8[::1], f8, f8[::1])", cache=True, counted=False)
def _where(place: F64, now: float, start: F64) -> bool:
    """About where the receiver is at GPS time ``now`` [s], into ``start`` (3,); false: unknown."""
    if abs(now - place[T_TIME]) > GUESS_S:
        place[T_KNOWN] = 0.0
    start[:] = 0.0
    if place[T_KNOWN] == 0.0:
        return False
    ahead, square = now - place[T_TIME], 0.0
    for i in range(3):
        start[i] = place[T_POS + i]
        square += place[T_VEL + i] * place[T_VEL + i]
    # Written so that NaN, for no velocity, stays where it was.
    if 0.0 < ahead <= AHEAD_S and square * ahead * ahead < AHEAD_M * AHEAD_M:
        for i in range(3):
            start[i] += place[T_VEL + i] * ahead
    return True


@njit("void(f8[::1], f8, f8[::1])", cache=True, counted=False)
def _settle(place: F64, now: float, point: F64) -> None:
    """Remember a solution."""
    for i in range(3):
        place[T_POS + i], place[T_VEL + i] = point[P_POS + i], point[P_VEL + i]
    place[T_TIME], place[T_KNOWN] = now, 1.0


@njit("i8(i8, f8[::1])", cache=True, counted=False)
def system_of(sat: int, settings: F64) -> int:
    """System of a satellite that is used; −1 else."""
    system = sat // 100 - 1
    if 0 <= system < SYSTEMS and settings[W_OURS + system] == 1.0:
        return system
    return -1


@njit(
    "i8(f8, f8, i8[::1], f8[:, ::1], i8[::1], f8[:, ::1], f8[:, :, ::1], b1, f8[::1], f8[::1], "
    "f8[::1], f8[::1], f8[:, ::1], f8[:, ::1], f8[:, ::1])",
    cache=True,
    counted=False,
)
def _correct_all(
    week: float, tow: float, sat: I64, observed: F64, row_of: I64, ephemerides: F64, knots: F64,
    known: bool, start: F64, frame: F64, ionosphere: F64, settings: F64, rows: F64, lines: F64,
    sight: F64,
) -> int:  # fmt: skip
    """Fill a row for each satellite of an epoch that can be used; returns how many there are."""
    m = 0
    for k in range(sat.shape[0]):
        if system_of(sat[k], settings) < 0 or not np.isfinite(observed[k, O_RANGE]):
            continue
        which = row_of[sat[k]]
        if which >= 0 and correct(
            ephemerides[which], knots[which], week, tow, observed[k], known, start, frame,
            ionosphere, settings, rows[m], lines[m], sight[m],
        ):  # fmt: skip
            m += 1
    return m


@njit("void(f8[:, ::1], i8, f8[:, ::1], f8[:, ::1])", cache=True, counted=False)
def scale(rows: F64, m: int, factors: F64, before: F64) -> None:
    """Variances times their systems' ``factors`` (2, SYSTEMS) over those of ``before``."""
    for s in range(m):
        c = int(rows[s, S_SYSTEM])
        rows[s, S_RANGE_VAR] *= factors[0, c] / before[0, c]
        rows[s, S_RATE_VAR] *= factors[1, c] / before[1, c]


@njit(
    "Tuple((i8, i8, b1))(f8, f8, i8[::1], f8[:, ::1], i8[::1], f8[:, ::1], f8[:, :, ::1], f8[::1], "
    "f8[::1], f8[::1], f8[:, :, ::1], f8[::1], f8[::1], f8[::1], f8[:, ::1], f8[:, ::1], "
    "f8[:, ::1], f8[:, :, ::1], i8[::1], f8[::1], i8[::1])",
    cache=True,
    counted=False,
)
def solve_epoch(
    week: float, tow: float, sat: I64, observed: F64, row_of: I64, ephemerides: F64, knots: F64,
    ionosphere: F64, settings: F64, gates: F64, factors: F64, place: F64, start: F64, frame: F64,
    rows: F64, lines: F64, sight: F64, work: F64, column: I64, point: F64, used: I64,
) -> tuple[int, int, bool]:  # fmt: skip
    """One epoch's satellites and its solution, to begin with from nowhere.

    ``factors`` (2, 2, SYSTEMS): on variances, and ones. ``place`` goes on. What is filled is as
    :func:`companion.gnss.single_point.solve` and :func:`companion.gnss.correction.correct` say.
    Returns what ``solve`` said, how many satellites there are, and whether it was known beforehand
    about where the receiver is.
    """
    now = week * 604_800.0 + tow
    begun = known = _where(place, now, start)
    code, m = TOO_FEW, 0
    # From nowhere, the first solution only tells what is low and where the ionosphere is.
    for _ in range(2):
        if known:
            stand(start[0], start[1], start[2], frame)
        m = _correct_all(
            week, tow, sat, observed, row_of, ephemerides, knots, known, start, frame, ionosphere,
            settings, rows, lines, sight,
        )  # fmt: skip
        scale(rows, m, factors[0], factors[1])
        code = solve(rows, m, start, known, gates, frame, sight, work, column, point, used)
        if code == SOLVED:
            _settle(place, now, point)
        if known or code != SOLVED:
            break
        known = _where(place, now, start)
    if not begun and code != SOLVED:
        place[T_KNOWN] = 0.0  # a beginning that led nowhere is none
    return code, m, known
