"""The walk: inertial samples and aiding in order of validity, one kernel for a block or a sample.

Everything that happens to a filter between two moments happens here: strapdown steps, steps split
at the time of an aid, covariance, aids, constraints, output rows, snapshots. What happens depends
on the sorted samples alone, never on how they were cut into calls.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.adaptation.adapt import after_fix
from companion.estimation.adaptation.evidence import least_factor, reception
from companion.estimation.covariance import STRIDE, propagate
from companion.estimation.parameters import (
    BANK,
    BASE_MODE,
    BRIDGED_DT,
    COASTING_NS,
    CONSTRAINT_NS,
    COURSE,
    COURSE_SPEED,
    COURSE_VAR,
    COVARIANCE_NS,
    DIVERGED_VAR,
    FEEDFORWARD,
    GAP_NS,
    LATENCY_VAR,
    NHC_LEVER,
    NHC_VAR,
    OUTPUT_NS,
    RELOCK_NS,
    SNAPSHOT_NS,
    STILL_ACCEL,
    STILL_GYRO,
    STILL_NS,
    STILL_SPEED,
    TIGHT,
    ZARU_VAR,
    ZERO_VELOCITY,
    ZUPT_VAR,
)
from companion.estimation.range_update import fuse_epoch
from companion.estimation.saturation import SATURATION, saturated
from companion.estimation.source_faults import report_source, settle, undecided, weigh
from companion.estimation.tape import RECORDER, Recorder, record_fix, record_row, record_step
from companion.estimation.update import R_VERDICT, foresee, fuse, note_velocity_fit
from companion.measurements.barometer import height
from companion.measurements.gnss import position, velocity
from companion.measurements.heading import direction
from companion.measurements.non_holonomic import sideways
from companion.measurements.standstill import observe, zero_rate, zero_velocity
from companion.navigation.error_model import box_plus
from companion.navigation.layout import (
    ACCEL_BIAS_B,
    DX,
    EARTH_RATE,
    GNSS_GROUND_SPEED,
    GNSS_SPEED,
    GNSS_SPEED_SD,
    HAVE_IMU,
    L_ACCEL_SCALE,
    L_N,
    LAST_ACCEL,
    LAST_GYRO,
    LAT,
    R_LEAST,
    REFUSED_SINCE,
    RESETS,
    STANDING,
    SUM_XA,
    SUM_XC,
    SUM_XV,
    T_CHECK,
    T_CONSTRAINT,
    T_COVARIANCE,
    T_GNSS_SPEED,
    T_IMU,
    T_NOW,
    T_OUTPUT,
    T_POSITION_AID,
    T_SNAPSHOT,
    T_VELOCITY_AID,
    VEL_N,
    VELOCITY_FIT,
)
from companion.navigation.layout import P as P_OFFSET
from companion.navigation.mechanisation import advance
from companion.navigation.rotation import quat_to_matrix
from companion.types import F64, I64

# --- why a walk ended
# Of several filters the highest counts: one that is broken must not take part in a decision.
DONE, STOP_GAP, STOP_CHECK, STOP_BROKEN = 0, 1, 2, 3

CHECK_NS = 500_000_000
"""Grid of the decisions above the kernel: heading found, relock, divergence."""
LOST_FIT = 6.0
"""Mean NIS per component of horizontal velocity beyond which the attitude is taken for wrong: 1 is
honest, noise three times what was configured gives 9 but scatters about the solution."""
LOST_SPEED = 1.0

# --- kinds of aid and columns of the aid table
KIND_GNSS, KIND_BARO, KIND_MAG = 0, 1, 2
KIND_ATTITUDE, KIND_IMU = 3, 4  # only the direct filter takes these
KIND_RANGE = 5
A_VALUE, A_VELOCITY, A_VAR, A_VAR_VELOCITY = 0, 3, 6, 9
A_AZIMUTH = 3
A_SATELLITES = 12  # NaN: unknown
A_LET_GO = 13  # 1: the receiver's clock jumped in front of this epoch, nobody knows how far
A_INTERFERENCE = 14  # 0 to 1; NaN: unknown
AID_SIZE = 15

# --- columns of an output row
O_LAT, O_VEL, O_Q, O_ACCEL_BIAS, O_GYRO_BIAS, O_COV, O_MODE, O_RESETS = 0, 3, 6, 10, 13, 16, 46, 47
ROW_SIZE = 48

EXCESS = 8
"""Columns of a sample's noise beyond the configured one: gyro, accelerometer."""
BRIDGE_ACCEL_VAR = 1.0
BRIDGE_GYRO_VAR = 0.01
"""What a bridged gap may hide: (1 m/s²)² and (0.1 rad/s)², constant over the gap."""

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


@njit("b1(f8[::1], i8[::1], i8[::1], i8[::1], f8[::1], f8[::1])", cache=True, counted=False)
def write_row(s: F64, k: I64, lay: I64, ipar: I64, total: F64, row: F64) -> bool:
    """Fill an output row; in feedforward mode from INS ⊞ error (``total`` is scratch).

    False where something in it is not finite or a variance is negative: not fit to be given out.
    """
    nominal = s
    if ipar[FEEDFORWARD] == 1:
        for i in range(DX):
            total[i] = s[i]
        box_plus(total, lay, s[DX : DX + lay[L_N]])
        nominal = total
    for i in range(3):
        row[O_LAT + i] = nominal[LAT + i]
        row[O_VEL + i] = nominal[VEL_N + i]
        row[O_ACCEL_BIAS + i] = nominal[ACCEL_BIAS_B + i]
        row[O_GYRO_BIAS + i] = nominal[ACCEL_BIAS_B + 3 + i]
    for i in range(4):
        row[O_Q + i] = nominal[i]
    n = lay[L_N]
    at = O_COV
    for block in range(5):
        for i in range(3):
            for j in range(i, 3):
                row[at] = s[P_OFFSET + (3 * block + i) * n + 3 * block + j]
                at += 1
    mode = ipar[BASE_MODE]
    if mode == 2 and k[T_NOW] - max(k[T_POSITION_AID], k[T_VELOCITY_AID]) > ipar[COASTING_NS]:
        mode = 3
    row[O_MODE] = mode
    row[O_RESETS] = k[RESETS]
    for i in range(O_MODE):
        if not abs(row[i]) < 1e30:
            return False
    for block in range(5):
        at = O_COV + 6 * block
        if row[at] < 0.0 or row[at + 3] < 0.0 or row[at + 5] < 0.0:
            return False
    return True


@njit(
    "void(f8[::1], i8[::1], b1, f8[::1], f8[::1], i8, i8, f8[::1], f8[:, ::1])",
    cache=True,
    counted=False,
)
def _step(
    s: F64, k: I64, scale: bool, par: F64, sample: F64, t: int, t_sample: int, at: F64, C: F64
) -> None:
    """Strapdown from now to ``t``, at or before the sample's time ``t_sample``."""
    span = t_sample - k[T_NOW]
    if t <= k[T_NOW]:
        return
    dt = (t - k[T_NOW]) * 1e-9
    integral = sample[6] > 0.0
    first = s[LAST_GYRO : LAST_GYRO + 6]
    fraction = 1.0 if t == t_sample or integral else (t - k[T_NOW]) / span
    for i in range(6):
        at[i] = sample[i] if fraction == 1.0 else first[i] + (sample[i] - first[i]) * fraction
    advance(s, first, at, dt, integral, scale, C)
    whole = (t_sample - k[T_IMU]) * 1e-9
    if whole > par[BRIDGED_DT]:
        s[SUM_XV] += BRIDGE_ACCEL_VAR * whole * dt
        s[SUM_XA] += BRIDGE_GYRO_VAR * whole * dt
    s[SUM_XA] += sample[EXCESS] * dt
    s[SUM_XV] += sample[EXCESS + 1] * dt
    if not integral:
        for i in range(6):
            s[LAST_GYRO + i] = at[i]
    k[T_NOW] = t


@njit("b1(f8[::1], i8[::1], i8[::1], f8[::1], i8[::1])", cache=True, counted=False)
def doubtful(s: F64, k: I64, lay: I64, par: F64, ipar: I64) -> bool:
    """Whether a decision above the kernel is due.

    Diverged, ranges refused for long, velocity never fits, source news.
    """
    n = lay[L_N]
    if s[P_OFFSET] + s[P_OFFSET + n + 1] > par[DIVERGED_VAR]:
        return True
    if undecided(k):
        return True
    if k[REFUSED_SINCE] > 0 and k[T_NOW] - k[REFUSED_SINCE] > ipar[RELOCK_NS]:
        return True
    return bool(s[VELOCITY_FIT] > LOST_FIT)


@njit(
    "i8(f8[::1], i8[::1], i8[::1], f8[::1], i8[::1], i8[::1], f8[:, ::1], i8[::1], i8[:, ::1],"
    "f8[:, ::1], i8[::1], f8[:, ::1], i8[::1], f8[:, ::1], f8[:, ::1], i8[:, ::1], i8[::1],"
    f"{RECORDER}, f8[:, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1], f8[::1], f8[::1])",
    cache=True,
    counted=False,
)
def _walk(
    s: F64,
    k: I64,
    lay: I64,
    par: F64,
    ipar: I64,
    imu_t: I64,
    imu: F64,
    aid_t: I64,
    aid_kind: I64,
    aid: F64,
    rows_t: I64,
    rows: F64,
    reports_t: I64,
    reports: F64,
    snaps: F64,
    snaps_k: I64,
    at: I64,
    tape: Recorder,
    C: F64,
    B: F64,
    W: F64,
    H: F64,
    total: F64,
    mixed: F64,
) -> int:
    """As :func:`walk`, with scratch: C (3, 3), B (24, 3, 3), W (n + 9, STRIDE), H (3, n), total
    (DX,), mixed (6,).
    """
    i, j, n_rows, n_reports = at[0], at[2], at[4], at[5]
    code = DONE
    scale = lay[L_ACCEL_SCALE] >= 0
    taped = tape[0].shape[0] > 0
    # Time only grows: a cell of a grid is left where its end is reached. Dividing to find the cell
    # of every sample on every grid was a tenth of the walk.
    check_ns = (k[T_IMU] // CHECK_NS + 1) * CHECK_NS
    while i < at[1]:
        t = imu_t[i]
        sample = imu[i]
        if t - k[T_IMU] > ipar[GAP_NS]:
            code = STOP_GAP
            break
        if (
            t >= check_ns
            and k[T_CHECK] != k[T_IMU]
            and (ipar[BANK] == 1 or doubtful(s, k, lay, par, ipar))
        ):
            code = STOP_CHECK
            break
        if t >= check_ns:
            check_ns = (t // CHECK_NS + 1) * CHECK_NS
        if k[HAVE_IMU] == 0:
            for c in range(6):
                s[LAST_GYRO + c] = sample[c]
            k[HAVE_IMU] = 1
        healthy = True
        while j < at[3] and aid_t[j] <= t:
            if aid[j, A_LET_GO] == 1.0:
                s[SUM_XC] = 1.0
            _step(s, k, scale, par, sample, aid_t[j], t, mixed, C)
            if taped:
                record_step(tape, s, lay, par)
            healthy = propagate(s, lay, par, B, W) and healthy
            first, ranges = j, aid_kind[j, 0] == KIND_RANGE
            j += 1
            if not ranges:
                n_reports = fuse_aid(
                    s, k, lay, par, ipar, aid_kind[first], aid[first], aid_t[first], C, H, W,
                    reports_t, reports, n_reports, tape,
                )  # fmt: skip
                continue
            # Ranges are the last kind at their time.
            while j < at[3] and aid_t[j] == aid_t[first]:
                j += 1
            # Filters that compete on their heading take the fixes made of the ranges.
            if ipar[BANK] == 0:
                n_reports = fuse_epoch(
                    s, k, lay, par, ipar, aid, aid_kind, first, j, aid_t[first], C, B[0], W,
                    reports_t, reports, n_reports, tape,
                )  # fmt: skip
        _step(s, k, scale, par, sample, t, t, mixed, C)
        for c in range(6):
            s[LAST_GYRO + c] = sample[c]
        if sample[SATURATION] > 0.0:
            saturated(s, par, sample[SATURATION], (t - k[T_IMU]) * 1e-9)
        k[T_IMU] = t
        observe(
            s,
            k,
            lay[L_N],
            sample,
            t,
            ipar[STILL_NS],
            par[STILL_GYRO],
            par[STILL_ACCEL],
            par[STILL_SPEED],
        )
        standing = k[STANDING] == 3 and ipar[ZERO_VELOCITY] == 1
        due = ipar[CONSTRAINT_NS] > 0 and t >= (k[T_CONSTRAINT] + 1) * ipar[CONSTRAINT_NS]
        if standing or due or t >= (k[T_COVARIANCE] + 1) * ipar[COVARIANCE_NS]:
            k[T_COVARIANCE] = t // ipar[COVARIANCE_NS]
            if taped:
                record_step(tape, s, lay, par)
            healthy = propagate(s, lay, par, B, W) and healthy
            if (standing or due) and healthy:
                n_reports = fuse_constraints(
                    s, k, lay, par, ipar, t, C, H, W, reports_t, reports, n_reports, tape
                )
        i += 1
        if healthy and t >= (k[T_OUTPUT] + 1) * ipar[OUTPUT_NS]:
            k[T_OUTPUT] = t // ipar[OUTPUT_NS]
            rows_t[n_rows] = t
            healthy = write_row(s, k, lay, ipar, total, rows[n_rows])
            if healthy:
                record_row(tape, s, lay, t, rows[n_rows])
                n_rows += 1
        if not healthy:
            code = STOP_BROKEN
            break
        if t >= (k[T_SNAPSHOT] + 1) * ipar[SNAPSHOT_NS]:
            cell = t // ipar[SNAPSHOT_NS]
            k[T_SNAPSHOT] = cell
            slot = cell % snaps.shape[0]
            for c in range(s.shape[0]):
                snaps[slot, c] = s[c]
            for c in range(k.shape[0]):
                snaps_k[slot, c] = k[c]
    at[0], at[2], at[4], at[5] = i, j, n_rows, n_reports
    return code


@njit(
    "i8(f8[::1], i8[::1], i8[::1], f8[::1], i8[::1], i8[::1], f8[:, ::1], i8[::1], i8[:, ::1],"
    "f8[:, ::1], i8[::1], f8[:, ::1], i8[::1], f8[:, ::1], f8[:, ::1], i8[:, ::1], i8[::1],"
    f"{RECORDER})",
    cache=True,
    entry=True,
)
def walk(
    s: F64,
    k: I64,
    lay: I64,
    par: F64,
    ipar: I64,
    imu_t: I64,
    imu: F64,
    aid_t: I64,
    aid_kind: I64,
    aid: F64,
    rows_t: I64,
    rows: F64,
    reports_t: I64,
    reports: F64,
    snaps: F64,
    snaps_k: I64,
    at: I64,
    tape: Recorder,
) -> int:
    """Walk state ``s``, ``k`` over samples ``at[0]:at[1]`` and aids ``at[2]:at[3]``.

    imu_t (N,) ns and imu (N, 10): gyro [rad/s], specific force [m/s²], integration interval [s]
    or 0, what is saturated, noise densities beyond the configured ones of both [rad²/s, m²/s³];
    aid_t (M,), aid_kind (M, 2): kind and source, aid (M, AID_SIZE): see the ``A_`` columns.
    Aids after the last sample wait. Output rows go to ``rows`` from ``at[4]`` on, reports to
    ``reports`` from ``at[5]``, snapshots to the rings ``snaps``, ``snaps_k``. ``at`` is moved on;
    the code says why the walk ended: all samples taken, a gap before sample ``at[0]``, a state
    that is not finite, or a decision due.
    """
    n = lay[L_N]
    C = np.empty((3, 3))
    B = np.empty((24, 3, 3))
    W = np.zeros((9 + n, STRIDE))  # zeros: leftovers that are not numbers would be slow
    H = np.zeros((3, n))
    total = np.empty(DX)
    mixed = np.empty(6)
    return _walk(
        s, k, lay, par, ipar, imu_t, imu, aid_t, aid_kind, aid, rows_t, rows, reports_t, reports,
        snaps, snaps_k, at, tape, C, B, W, H, total, mixed,
    )  # fmt: skip
