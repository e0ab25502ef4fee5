"""The update by raw GNSS: all satellites of an epoch, linearised once, fused one by one.

    y_i = z_i − h_i(x) − H_i δx̂,   S = H_i P H_iᵀ + R_i,   NIS = y²/S against χ²(1),
    δx̂ ← δx̂ + P H_iᵀ y/S,   P ← P − P H_iᵀ H_i P/S

and x ⊞ δx̂ once behind the last. Each range and each rate has its own gate, and what one of them
told is in δx̂ when the next is judged. That h is taken where the epoch began leaves d²/2ρ of a range
at a correction of d: 1e-5 m at 20 m.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.adaptation.adapt import after_fix
from companion.estimation.adaptation.layout import TRACED
from companion.estimation.parameters import FEEDFORWARD, GATE
from companion.estimation.tape import RECORDER, Recorder, record_fix, record_turn
from companion.estimation.update import (
    ACCEPTED,
    R_CHANNEL,
    R_DOF,
    R_GATE,
    R_INNOVATION,
    R_NIS,
    R_SCALE_USED,
    R_SD,
    R_SOURCE,
    R_TRACE,
    R_VERDICT,
    REFUSED_INVALID,
    REJECTED_GATE,
    against,
    apply,
    reset_covariance,
)
from companion.gnss.corrected import S_RANGE_VAR, S_RATE, S_RATE_VAR, S_SYSTEM
from companion.measurements.pseudorange import look, range_innovation, rate_innovation
from companion.navigation.error_model import box_plus
from companion.navigation.layout import DX, L_N, REFUSED_SINCE, T_POSITION_AID, T_VELOCITY_AID
from companion.navigation.layout import P as P_OFFSET
from companion.navigation.rotation import quat_to_matrix
from companion.types import F64, I64

_RANGE, _RATE = 18.0, 21.0
"""Channels of GPS, as types.Channel; the other systems behind them."""


@njit(
    f"b1(f8[:, ::1], f8[::1], f8[::1], f8, f8, f8, f8[::1], f8[::1], {RECORDER})",
    cache=True,
    counted=False,
)
def fuse_scalar(
    P: F64, dx: F64, H: F64, y: float, R: float, gate: float, a: F64, report: F64, tape: Recorder
) -> bool:
    """Gate one measurement and apply it to ``P`` (n, n) and the correction ``dx`` (n,).

    ``y``: innovation where ``dx`` is zero; ``a`` (n,) is scratch; what came of it goes to
    ``report``. Returns whether it was accepted.
    """
    S, y = against(P, dx, H, y, R, a)
    # Not a number where the innovation is none; below zero where S is not definite.
    nis = y * y / S if S > 0.0 else -1.0
    report[R_DOF] = 1.0
    for i in range(3):
        report[R_INNOVATION + i] = report[R_SD + i] = np.nan
    report[R_INNOVATION], report[R_SD] = y, math.sqrt(max(S, 0.0))
    report[R_NIS], report[R_GATE], report[R_SCALE_USED] = nis, gate, 1.0
    report[R_TRACE + TRACED] = 0.0
    if not nis >= 0.0:
        report[R_VERDICT] = REFUSED_INVALID
        return False
    if nis > gate:
        report[R_VERDICT] = REJECTED_GATE
        return False
    report[R_VERDICT] = ACCEPTED
    apply(P, dx, H, a, S, y, tape)
    return True


@njit(
    "i8(f8[::1], i8[::1], i8[::1], f8[::1], i8[::1], f8[:, ::1], i8[:, ::1], i8, i8, i8,"
    f"f8[:, ::1], f8[:, ::1], f8[:, ::1], i8[::1], f8[:, ::1], i8, {RECORDER})",
    cache=True,
    counted=False,
)
def fuse_epoch(
    s: F64,
    k: I64,
    lay: I64,
    par: F64,
    ipar: I64,
    rows: F64,
    kinds: I64,
    first: int,
    end: int,
    t: int,
    C: F64,
    axes: F64,
    W: F64,
    reports_t: I64,
    reports: F64,
    count: int,
    tape: Recorder,
) -> int:
    """Fuse the satellites ``rows[first:end]``, an epoch valid at ``t``.

    ``rows`` (M, ≥ 12): columns ``S_`` of :mod:`companion.gnss.corrected`; ``kinds`` (M, 2): kind,
    source; ``C``, ``axes`` (3, 3) and ``W`` (≥ 10, ≥ n) are scratch. Returns the number of
    report rows after it. Of an epoch most ranges must be accepted for it to count as a fix: one
    satellite more or less that agrees by chance says nothing of the place.
    """
    n = lay[L_N]
    P = s[P_OFFSET : P_OFFSET + n * n].reshape((n, n))
    J, view, dx, a, H = W[:6], W[6], W[7, :n], W[8, :n], W[9, :n]
    quat_to_matrix(s, C)
    look(s, lay, C, axes, J, view)
    # In feedforward mode the state stands still, and what is known of its error goes on growing.
    base = s[DX : DX + n] if ipar[FEEDFORWARD] == 1 else dx
    for j in range(n):
        dx[j] = 0.0
    taken, seen = 0, 0
    for m in range(first, end):
        row = rows[m]
        for half in range(1 if math.isnan(row[S_RATE]) else 2):
            if half == 0:
                y, R = range_innovation(s, lay, axes, J, view, row, H), row[S_RANGE_VAR]
            else:
                y, R = rate_innovation(s, lay, axes, J, view, row, H), row[S_RATE_VAR]
            report = reports[count]
            report[R_CHANNEL] = (_RANGE if half == 0 else _RATE) + row[S_SYSTEM]
            report[R_SOURCE] = kinds[m, 1]
            good = fuse_scalar(P, base, H, y, R, par[GATE], a, report, tape)
            reports_t[count] = t
            count += 1
            if half == 0:
                seen += 1
                taken += good
            elif good:
                k[T_VELOCITY_AID] = t
    if ipar[FEEDFORWARD] == 0:
        box_plus(s, lay, dx)
        reset_covariance(P, dx, n)
        record_turn(tape, dx)
    if 2 * taken > seen:
        k[T_POSITION_AID] = t
        k[REFUSED_SINCE] = 0
        after_fix(s, lay, ipar, tape)
        record_fix(tape, t)
    elif k[REFUSED_SINCE] == 0:
        k[REFUSED_SINCE] = t
    return count
