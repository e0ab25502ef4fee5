"""What an aid does to the direct filter, by kind: which models, which gates, what is noted."""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.adaptation.evidence import reception
from companion.estimation.adaptation.flac import LARGEST_ACCEL, LARGEST_ATT, LARGEST_GYRO, fade
from companion.estimation.adaptation.layout import FLAC
from companion.estimation.aid_table import (
    A_AZIMUTH,
    A_CLOCK_SCALE,
    A_INTERFERENCE,
    A_LET_GO,
    A_SATELLITES,
    A_VALUE,
    A_VAR,
    A_VAR_VELOCITY,
    A_VELOCITY,
    KIND_ATTITUDE,
    KIND_BARO,
    KIND_GNSS,
    KIND_IMU,
    KIND_RANGE,
)
from companion.estimation.direct import aids, ranges
from companion.estimation.direct.inertial_update import fuse_unit
from companion.estimation.direct.layout import (
    ACC_N,
    ACCEL_BIAS,
    ACCEL_SCALE,
    ATT,
    EPOCH_SEEN,
    EPOCH_TAKEN,
    GYRO_BIAS,
    GYRO_SCALE,
    L_BARO,
    L_CLOCK,
    L_N,
    L_P,
    T_POSITION_AID,
    T_REJECT,
    T_REJECT_HEIGHT,
    T_VELOCITY_AID,
    UNIT,
    VEL_N,
)
from companion.estimation.direct.parameters import ATTITUDE_VAR, ATTITUDE_YAW_VAR, LEVER
from companion.estimation.direct.update import fuse
from companion.estimation.parameters import (
    ADAPTATION,
    BANK,
    COURSE,
    COURSE_SPEED,
    COURSE_VAR,
    LATENCY_VAR,
    TIGHT,
)
from companion.estimation.receiver_clock import LET_GO_DRIFT_VAR, LET_GO_VAR
from companion.gnss.corrected import S_RANGE_VAR, S_RATE, S_RATE_VAR, S_SYSTEM
from companion.navigation.layout import BIAS, CLOCK_SCALE, DRIFT
from companion.navigation.rotation import quat_to_matrix
from companion.types import F64, I64

LARGEST_SCALE = 4e-4
"""Variance of a scale factor that P is not widened beyond: (2 %)²."""

# channels, as types.Channel
_BARO, _MAG, _COURSE, _ATTITUDE = 4, 5, 6, 10
_RANGE, _RATE = 18, 21  # and the systems after GPS


@njit("void(i8[::1], b1, i8)", cache=True)
def _note_height(k: I64, good: bool, t: int) -> None:
    """Since when every height has been refused."""
    if good:
        k[T_REJECT_HEIGHT] = 0
    elif k[T_REJECT_HEIGHT] == 0:
        k[T_REJECT_HEIGHT] = t


@njit(
    "i8(f8[::1], i8[::1], i8[::1], f8[::1], i8[::1], i8, f8[::1], i8, f8[:, ::1], f8[:, ::1],"
    "i8[::1], f8[:, ::1], i8[::1], f8[:, ::1], i8)",
    cache=True,
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
    cols: I64,
    W: F64,
    reports_t: I64,
    reports: F64,
    count: int,
) -> int:
    """Fuse one fix: position and velocity, horizontal and vertical each behind its own gate."""
    y = np.empty(3)
    R = np.empty(3)
    reception(s, z[A_SATELLITES], z[A_VAR], z[A_INTERFERENCE])
    # With ranges at hand a fix made of them says nothing new, but for the bank's sake.
    halves = 0 if ipar[TIGHT] == 1 and ipar[BANK] == 0 else 4
    for half in range(halves):
        vertical = half % 2 == 1
        o = A_VELOCITY if half >= 2 else A_VALUE
        v = A_VAR_VELOCITY if half >= 2 else A_VAR
        m = 1 if vertical else 2
        first = 2 if vertical else 0
        if not (z[o + first] == z[o + first] and z[o + first + m - 1] == z[o + first + m - 1]):
            continue
        quat_to_matrix(s, C)
        if half >= 2:
            nc = aids.velocity(s, C, par[LEVER : LEVER + 3], z[o : o + 3], H, cols, y)
        else:
            nc = aids.position(s, lay, C, par[LEVER : LEVER + 3], z[o : o + 3], H, cols, y)
        for i in range(m):
            # A fix valid at a slightly other time errs along acceleration and velocity.
            drift = s[(ACC_N if half >= 2 else VEL_N) + first + i]
            R[i] = z[v + first + i] + par[LATENCY_VAR] * drift * drift
        if vertical:
            y[0] = y[2]
            for j in range(nc):
                H[0, j] = H[2, j]
        good = fuse(s, lay, par, ipar, half, source, H, cols, nc, y, R, m, W, reports[count])
        reports_t[count] = t
        count += 1
        if half == 0:
            if good:
                k[T_POSITION_AID] = t
                k[T_REJECT] = 0
            elif k[T_REJECT] == 0:
                k[T_REJECT] = t
        elif half == 1:
            _note_height(k, good, t)
        elif half == 2 and good:
            k[T_VELOCITY_AID] = t
    speed = math.hypot(z[A_VELOCITY], z[A_VELOCITY + 1])
    if ipar[COURSE] == 1 and ipar[BANK] == 0 and speed > par[COURSE_SPEED]:
        quat_to_matrix(s, C)
        azimuth = math.atan2(z[A_VELOCITY + 1], z[A_VELOCITY])
        nc = aids.direction(C, 1.0, 0.0, 0.0, azimuth, H, cols, y)
        if nc > 0:
            R[0] = par[COURSE_VAR] + z[A_VAR_VELOCITY] / (speed * speed)
            fuse(s, lay, par, ipar, _COURSE, source, H, cols, nc, y, R, 1, W, reports[count])
            reports_t[count] = t
            count += 1
    if halves > 0:
        after_fix(s, lay, ipar)
    return count


@njit("void(f8[::1], i8[::1], i8[::1])", cache=True)
def after_fix(s: F64, lay: I64, ipar: I64) -> None:
    """What a method of adaptation does once all of a fix is in: FLAC forgets.

    Not where P is beyond what the error equations stand for, as in the other filter.
    """
    if ipar[ADAPTATION] != FLAC or ipar[BANK] == 1:
        return
    n = lay[L_N]
    P = s[lay[L_P] : lay[L_P] + n * n].reshape((n, n))
    allowed = True
    for i in range(3):
        allowed = allowed and P[ATT + i, ATT + i] <= LARGEST_ATT
        allowed = allowed and P[UNIT + ACCEL_BIAS + i, UNIT + ACCEL_BIAS + i] <= LARGEST_ACCEL
        allowed = allowed and P[UNIT + GYRO_BIAS + i, UNIT + GYRO_BIAS + i] <= LARGEST_GYRO
        for scale in (GYRO_SCALE, ACCEL_SCALE):
            at = UNIT + scale + i
            allowed = allowed and P[at, at] <= LARGEST_SCALE
    fade(s, P, n, allowed)


@njit("void(f8[::1], i8[::1])", cache=True)
def let_go(s: F64, lay: I64) -> None:
    """The receiver's clock jumped, nobody knows how far: its variance grows, its estimate stays."""
    n, b = lay[L_N], lay[L_CLOCK]
    s[lay[L_P] + (b + BIAS) * (n + 1)] += LET_GO_VAR
    s[lay[L_P] + (b + DRIFT) * (n + 1)] += LET_GO_DRIFT_VAR


@njit(
    "i8(f8[::1], i8[::1], i8[::1], f8[::1], i8[::1], i8, f8[::1], i8, f8[:, ::1], f8[:, ::1],"
    "i8[::1], f8[:, ::1], i8[::1], f8[:, ::1], i8)",
    cache=True,
)
def fuse_ranges(
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
    cols: I64,
    W: F64,
    reports_t: I64,
    reports: F64,
    count: int,
) -> int:
    """Fuse one satellite: range and rate, each behind its own gate; report rows after it."""
    y = np.empty(3)
    R = np.empty(3)
    lever = par[LEVER : LEVER + 3]
    if z[A_LET_GO] == 1.0:
        let_go(s, lay)
    for i in range(3):
        s[CLOCK_SCALE + i] = z[A_CLOCK_SCALE + i]
    for half in range(2):
        rate = half == 1
        if rate and math.isnan(z[S_RATE]):
            break
        quat_to_matrix(s, C)
        nc = ranges.satellite(s, lay, C, lever, z, rate, H, cols, y)
        R[0] = z[S_RATE_VAR if rate else S_RANGE_VAR]
        channel = (_RATE if rate else _RANGE) + int(z[S_SYSTEM])
        good = fuse(s, lay, par, ipar, channel, source, H, cols, nc, y, R, 1, W, reports[count])
        reports_t[count] = t
        count += 1
        if rate and good:
            k[T_VELOCITY_AID] = t
        elif not rate:
            k[EPOCH_SEEN] += 1
            k[EPOCH_TAKEN] += good
    return count


@njit("void(f8[::1], i8[::1], i8[::1], i8[::1], i8)", cache=True)
def end_epoch(s: F64, k: I64, lay: I64, ipar: I64, t: int) -> None:
    """What is due once all satellites of an epoch are in: it counts as a fix if most agree."""
    if 2 * k[EPOCH_TAKEN] > k[EPOCH_SEEN]:
        k[T_POSITION_AID] = t
        k[T_REJECT] = 0
        after_fix(s, lay, ipar)
    elif k[T_REJECT] == 0:
        k[T_REJECT] = t
    k[EPOCH_SEEN] = k[EPOCH_TAKEN] = 0


@njit(
    "i8(f8[::1], i8[::1], i8[::1], f8[::1], i8[::1], f8[:, ::1], i8[::1], f8[::1], i8, f8[:, ::1],"
    "f8[:, ::1], i8[::1], f8[:, ::1], i8[::1], f8[:, ::1], i8)",
    cache=True,
)
def fuse_aid(
    s: F64,
    k: I64,
    lay: I64,
    par: F64,
    ipar: I64,
    units: F64,
    kind: I64,
    z: F64,
    t: int,
    C: F64,
    H: F64,
    cols: I64,
    W: F64,
    reports_t: I64,
    reports: F64,
    count: int,
) -> int:
    """Fuse one row of the aid table; returns the number of report rows after it."""
    if kind[0] == KIND_GNSS:
        return fuse_gnss(
            s, k, lay, par, ipar, kind[1], z, t, C, H, cols, W, reports_t, reports, count
        )
    if kind[0] == KIND_RANGE:
        # Filters that compete on their heading take the fixes made of the ranges.
        if ipar[BANK] == 1:
            return count
        return fuse_ranges(
            s, k, lay, par, ipar, kind[1], z, t, C, H, cols, W, reports_t, reports, count
        )
    if kind[0] == KIND_IMU:
        return fuse_unit(
            s, k, lay, par, ipar, units, 1 + kind[1], z[:7], t, C, H, cols, W,
            reports_t, reports, count,
        )  # fmt: skip
    y = np.empty(3)
    R = np.empty(3)
    m, channel = 1, _BARO
    quat_to_matrix(s, C)
    R[0] = z[A_VAR]
    if kind[0] == KIND_BARO:
        nc = aids.pressure_height(s, lay, z[A_VALUE], H, cols, y) if lay[L_BARO] >= 0 else 0
    elif kind[0] == KIND_ATTITUDE:
        m, channel = 3, _ATTITUDE
        nc = aids.attitude(s, lay, C, z[A_VALUE : A_VALUE + 3], H, cols, y)
        R[0] = R[1] = par[ATTITUDE_VAR]
        R[2] = par[ATTITUDE_YAW_VAR]
    else:
        channel = _MAG
        nc = 0
        if ipar[BANK] == 0:
            nc = aids.direction(
                C, z[A_VALUE], z[A_VALUE + 1], z[A_VALUE + 2], z[A_AZIMUTH], H, cols, y
            )
    if nc == 0:
        return count
    good = fuse(s, lay, par, ipar, channel, kind[1], H, cols, nc, y, R, m, W, reports[count])
    if channel == _BARO and (good or k[T_REJECT_HEIGHT] > 0):
        _note_height(k, good, t)
    reports_t[count] = t
    return count + 1
