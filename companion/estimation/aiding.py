"""How the error-state filter takes each kind of aid: fixes, barometer, heading, constraints.

Ranges have a house of their own, :mod:`companion.estimation.range_update`.
"""

from __future__ import annotations

import math

from companion._jit import njit
from companion.estimation.adaptation.adapt import after_fix
from companion.estimation.adaptation.evidence import least_factor, reception
from companion.estimation.aid_table import (
    A_AZIMUTH,
    A_INTERFERENCE,
    A_SATELLITES,
    A_VALUE,
    A_VAR,
    A_VAR_VELOCITY,
    A_VELOCITY,
    KIND_BARO,
    KIND_GNSS,
)
from companion.estimation.parameters import (
    BANK,
    CONSTRAINT_NS,
    COURSE,
    COURSE_SPEED,
    COURSE_VAR,
    LATENCY_VAR,
    NHC_LEVER,
    NHC_VAR,
    TIGHT,
    ZARU_VAR,
    ZERO_VELOCITY,
    ZUPT_VAR,
)
from companion.estimation.source_faults import report_source, settle, weigh
from companion.estimation.tape import RECORDER, Recorder, record_fix
from companion.estimation.update import R_VERDICT, foresee, fuse, note_velocity_fit
from companion.measurements.barometer import height
from companion.measurements.gnss import position, velocity
from companion.measurements.heading import direction
from companion.measurements.non_holonomic import sideways
from companion.measurements.standstill import zero_rate, zero_velocity
from companion.navigation.layout import (
    ACCEL_BIAS_B,
    EARTH_RATE,
    GNSS_GROUND_SPEED,
    GNSS_SPEED,
    GNSS_SPEED_SD,
    L_N,
    LAST_ACCEL,
    R_LEAST,
    STANDING,
    T_CONSTRAINT,
    T_GNSS_SPEED,
    T_POSITION_AID,
    T_VELOCITY_AID,
    VEL_N,
)
from companion.navigation.rotation import quat_to_matrix
from companion.types import F64, I64

SPARE = 12
"""Row of the scratch ``W`` from which on it is free while an aid is fused."""

# channels, as types.Channel
_POS_H, _POS_V, _VEL_H, _VEL_V, _BARO, _MAG, _COURSE, _ZUPT, _ZARU, _NHC = range(10)


@njit(
    "i8(f8[::1], i8[::1], i8[::1], f8[::1], i8[::1], i8, f8[::1], i8, f8[:, ::1], f8[:, ::1],"
    f"f8[:, ::1], i8[::1], f8[:, ::1], i8, {RECORDER})",
    cache=True,
    counted=False,
)
def fuse_gnss(
    s: F64,
    k: I64,
    lay: I64,
    par: F64,
    ipar: I64,
    source: int,
    z: F64,
    t: int,
    C: F64,
    H: F64,
    W: F64,
    reports_t: I64,
    reports: F64,
    count: int,
    tape: Recorder,
) -> int:
    """Fuse one fix: position and velocity, horizontal and vertical apart, then course.

    Horizontal and vertical pass their own gates: a wrong height must not cost the position.
    Returns the number of report rows after it.
    """
    y, R = W[SPARE], W[SPARE + 1]
    n = lay[L_N]
    taken = False
    reception(s, z[A_SATELLITES], z[A_VAR], z[A_INTERFERENCE])
    if z[A_VELOCITY] == z[A_VELOCITY] and z[A_VELOCITY + 1] == z[A_VELOCITY + 1]:
        down = z[A_VELOCITY + 2] if z[A_VELOCITY + 2] == z[A_VELOCITY + 2] else 0.0
        s[GNSS_SPEED] = math.sqrt(z[A_VELOCITY] ** 2 + z[A_VELOCITY + 1] ** 2 + down * down)
        s[GNSS_SPEED_SD] = math.sqrt(z[A_VAR_VELOCITY])
        s[GNSS_GROUND_SPEED] = math.sqrt(z[A_VELOCITY] ** 2 + z[A_VELOCITY + 1] ** 2)
        k[T_GNSS_SPEED] = t
    # With ranges at hand a fix made of them says nothing new, but for the bank's sake, and how well
    # the velocity fits, by which a wrong attitude is found.
    aside = ipar[TIGHT] == 1 and ipar[BANK] == 0
    for half in range(4):
        if aside and half != 2:
            continue
        vertical = half % 2 == 1
        o = A_VELOCITY if half >= 2 else A_VALUE
        v = A_VAR_VELOCITY if half >= 2 else A_VAR
        m = 1 if vertical else 2
        if vertical:
            if math.isnan(z[o + 2]):
                continue
            R[0] = z[v + 2]
        else:
            if not (z[o] == z[o] and z[o + 1] == z[o + 1]):
                continue
            R[0], R[1] = z[v], z[v + 1]
        quat_to_matrix(s, C)
        # A fix valid at a slightly other time than its stamp errs along acceleration and velocity.
        for i in range(m):
            axis = 2 if vertical else i
            drift = s[VEL_N + axis]
            if half >= 2:
                drift = 9.8 if vertical else 0.0
                for c in range(3):
                    drift += C[axis, c] * (s[LAST_ACCEL + c] - s[ACCEL_BIAS_B + c])
            R[i] += par[LATENCY_VAR] * drift * drift
        s[R_LEAST] = least_factor(par, lay, half, z[v + 2 * vertical : v + 3], R, m)
        if half >= 2:
            velocity(s, lay, C, z[A_VELOCITY : A_VELOCITY + 3], H, y)
        else:
            position(s, lay, C, z[A_VALUE : A_VALUE + 3], H, y)
        if vertical:
            y[0] = y[2]
            for j in range(n):
                H[0, j] = H[2, j]
        if aside:
            nis = foresee(s, lay, ipar, H, y, R, m, W)
            if nis >= 0.0:
                note_velocity_fit(s, nis, m)
            continue
        barred = 0.0
        if half < 2 and ipar[BANK] == 0:
            barred = weigh(s, k, lay, par, ipar, half, y, R, t, W[SPARE + 2])
        good = fuse(s, lay, par, ipar, half, source, barred, H, y, R, m, W, reports[count], tape)
        reports_t[count] = t
        count += 1
        # What a smoother on line waits for: a place, where the fix has one; with its velocity alone
        # an outage would be smoothed while the place is on probation behind it.
        taken |= good and half == (0 if z[A_VALUE] == z[A_VALUE] else 2)
        if half == 0 and good:
            k[T_POSITION_AID] = t
        elif half == 2 and good:
            k[T_VELOCITY_AID] = t
        if half < 2 and ipar[BANK] == 0:
            settle(s, k, lay, half, W[3], t, reports[count - 1, R_VERDICT])
            if report_source(s, k, half, source, t, reports[count]):
                reports_t[count] = t
                count += 1
    if (
        ipar[COURSE] == 1
        and ipar[BANK] == 0
        and k[T_GNSS_SPEED] == t
        and s[GNSS_GROUND_SPEED] > par[COURSE_SPEED]
    ):
        quat_to_matrix(s, C)
        # Where time runs backwards the vehicle moves against where it points.
        ahead = math.copysign(1.0, s[EARTH_RATE])
        azimuth = math.atan2(ahead * z[A_VELOCITY + 1], ahead * z[A_VELOCITY])
        if direction(lay, C, 1.0, 0.0, 0.0, azimuth, H, y):
            R[0] = par[COURSE_VAR] + z[A_VAR_VELOCITY] / (
                s[GNSS_GROUND_SPEED] * s[GNSS_GROUND_SPEED]
            )
            fuse(s, lay, par, ipar, _COURSE, source, 0.0, H, y, R, 1, W, reports[count], tape)
            reports_t[count] = t
            count += 1
    if not aside:
        after_fix(s, lay, ipar, tape)
    if taken:
        record_fix(tape, t)
    return count


@njit(
    "i8(f8[::1], i8[::1], i8[::1], f8[::1], i8[::1], i8[::1], f8[::1], i8, f8[:, ::1],"
    f"f8[:, ::1], f8[:, ::1], i8[::1], f8[:, ::1], i8, {RECORDER})",
    cache=True,
    counted=False,
)
def fuse_aid(
    s: F64,
    k: I64,
    lay: I64,
    par: F64,
    ipar: I64,
    kind: I64,
    z: F64,
    t: int,
    C: F64,
    H: F64,
    W: F64,
    reports_t: I64,
    reports: F64,
    count: int,
    tape: Recorder,
) -> int:
    """Fuse one row of the aid table, but of ranges; returns the number of report rows after it."""
    if kind[0] == KIND_GNSS:
        return fuse_gnss(
            s, k, lay, par, ipar, kind[1], z, t, C, H, W, reports_t, reports, count, tape
        )
    y, R = W[SPARE], W[SPARE + 1]
    R[0] = z[A_VAR]
    channel = _BARO
    if kind[0] == KIND_BARO:
        height(s, lay, z[A_VALUE], H, y)
    else:
        channel = _MAG
        if ipar[BANK] == 1:
            return count
        quat_to_matrix(s, C)
        if not direction(lay, C, z[A_VALUE], z[A_VALUE + 1], z[A_VALUE + 2], z[A_AZIMUTH], H, y):
            return count
    fuse(s, lay, par, ipar, channel, kind[1], 0.0, H, y, R, 1, W, reports[count], tape)
    reports_t[count] = t
    return count + 1


@njit(
    "i8(f8[::1], i8[::1], i8[::1], f8[::1], i8[::1], i8, f8[:, ::1], f8[:, ::1], f8[:, ::1],"
    f"i8[::1], f8[:, ::1], i8, {RECORDER})",
    cache=True,
    counted=False,
)
def fuse_constraints(
    s: F64,
    k: I64,
    lay: I64,
    par: F64,
    ipar: I64,
    t: int,
    C: F64,
    H: F64,
    W: F64,
    reports_t: I64,
    reports: F64,
    count: int,
    tape: Recorder,
) -> int:
    """Zero velocity and zero rate once a standing quarter, non-holonomic on its grid otherwise."""
    y, R = W[SPARE], W[SPARE + 1]
    if k[STANDING] == 3 and ipar[ZERO_VELOCITY] == 1:
        for i in range(3):
            R[i] = par[ZUPT_VAR]
        zero_velocity(s, lay, H, y)
        good = fuse(s, lay, par, ipar, _ZUPT, 0, 0.0, H, y, R, 3, W, reports[count], tape)
        reports_t[count] = t
        count += 1
        if good:
            k[T_VELOCITY_AID] = t
        for i in range(3):
            R[i] = par[ZARU_VAR]
        quat_to_matrix(s, C)
        zero_rate(s, k, lay, C, H, y)
        fuse(s, lay, par, ipar, _ZARU, 0, 0.0, H, y, R, 3, W, reports[count], tape)
        reports_t[count] = t
        count += 1
    if ipar[CONSTRAINT_NS] > 0 and t // ipar[CONSTRAINT_NS] != k[T_CONSTRAINT]:
        k[T_CONSTRAINT] = t // ipar[CONSTRAINT_NS]
        if k[STANDING] & 1 == 0:
            R[0] = R[1] = par[NHC_VAR]
            quat_to_matrix(s, C)
            sideways(s, lay, C, par[NHC_LEVER], par[NHC_LEVER + 1], par[NHC_LEVER + 2], H, y)
            fuse(s, lay, par, ipar, _NHC, 0, 0.0, H, y, R, 2, W, reports[count], tape)
            reports_t[count] = t
            count += 1
    return count
