"""The walk of the direct filter: inertial samples and aids in order of validity, in one kernel.

As :mod:`companion.estimation.walk`, with two differences: an inertial sample is one measurement
among others, so the state is carried by the model between any two of them; and output rows come on
their grid also between the samples of a slow IMU, each from what was measured before it.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.direct import aids, inertial
from companion.estimation.direct.layout import (
    ACC_N,
    ACCEL_BIAS,
    ATT,
    CIRCULAR,
    GYRO_BIAS,
    L_BARO,
    L_N,
    L_P,
    L_UNITS,
    LAT,
    POS,
    RESETS,
    SHAKE_SIZE,
    SNAP_CELL,
    SNAP_COUNT,
    T_CHECK,
    T_IMU,
    T_NOW,
    T_OUTPUT,
    T_POSITION_AID,
    T_REJECT,
    T_REJECT_HEIGHT,
    T_VELOCITY_AID,
    UNIT,
    UNIT_INTS,
    UNIT_SIZE,
    UNIT_TIMES,
    UNITS,
    VEL,
    VEL_N,
    Q,
)
from companion.estimation.direct.motion import MAX_STEP, carry, spread
from companion.estimation.direct.parameters import (
    ATTITUDE_VAR,
    ATTITUDE_YAW_VAR,
    BANK,
    BASE_MODE,
    COASTING_NS,
    CONSTRAINT_NS,
    COURSE,
    COURSE_SPEED,
    COURSE_VAR,
    DIVERGED_VAR,
    GAP_NS,
    LATENCY_VAR,
    LEVER,
    LONGEST_S,
    NHC_VAR,
    OUTPUT_NS,
    RELOCK_NS,
    REPORT_NS,
    SHORTEST_S,
    SNAPSHOT_NS,
    U_ACCEL_PSD,
    U_ACCEL_VAR,
    U_GYRO_PSD,
    U_GYRO_VAR,
)
from companion.estimation.direct.surprises import (
    MISSED_S,
    PERSISTENT,
    allow,
    contradicted,
    learn_shaking,
    turned_round,
)
from companion.estimation.direct.transitions import NO_SWITCH, switch, turn
from companion.estimation.direct.update import ACCEL, GYRO, WIDTH, fuse
from companion.estimation.walk import (
    A_AZIMUTH,
    A_VALUE,
    A_VAR,
    A_VAR_VELOCITY,
    A_VELOCITY,
    CHECK_NS,
    DONE,
    KIND_ATTITUDE,
    KIND_BARO,
    KIND_GNSS,
    KIND_IMU,
    O_ACCEL_BIAS,
    O_COV,
    O_GYRO_BIAS,
    O_LAT,
    O_MODE,
    O_Q,
    O_RESETS,
    O_VEL,
    STOP_BROKEN,
    STOP_CHECK,
    STOP_GAP,
)
from companion.navigation.rotation import quat_to_matrix
from companion.types import F64, I64

_BARO, _MAG, _COURSE, _NHC, _ATTITUDE = 4, 5, 6, 9, 10  # as types.Channel


@njit("void(f8[::1], i8[::1], i8[::1], f8[::1], f8[:, ::1], i8, f8[:, ::1])", cache=True)
def move_to(s: F64, k: I64, lay: I64, par: F64, slow: F64, t: int, W: F64) -> None:
    """Carry state and covariance to ``t`` [ns] in steps of at most :data:`MAX_STEP`."""
    if t <= k[T_NOW]:
        return
    span = (t - k[T_NOW]) * 1e-9
    steps = math.ceil(span / MAX_STEP - 1e-9)
    for _ in range(steps):
        spread(s, lay, par, slow, span / steps, W)
        carry(s, lay, par, slow, span / steps)
    k[T_NOW] = t


@njit(
    "i8(f8[::1], i8[::1], i8[::1], f8[::1], i8[::1], f8[:, ::1], i8, f8[::1], i8, f8[:, ::1],"
    "f8[:, ::1], i8[::1], f8[:, ::1], i8[::1], f8[:, ::1], i8)",
    cache=True,
)
def fuse_unit(
    s: F64,
    k: I64,
    lay: I64,
    par: F64,
    ipar: I64,
    units: F64,
    unit: int,
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
    """Fuse a sample ``z`` (7,) of ``unit``: rate, then specific force; both gated on their own.

    Returns the number of report rows after it.
    """
    y = np.empty(3)
    R = np.empty(3)
    f = np.empty(3)
    at = UNIT_TIMES + UNIT_INTS * unit
    shake = UNITS + UNIT_SIZE * lay[L_UNITS] + SHAKE_SIZE * unit
    age = (t - k[at]) * 1e-9 if k[at] > 0 else LONGEST_S
    dt = z[6] if z[6] > 0.0 else min(max(age, SHORTEST_S), LONGEST_S)
    told = k[at] > 0 and t // ipar[REPORT_NS] == k[at] // ipar[REPORT_NS]
    k[at] = t
    known = units[unit]
    quat_to_matrix(s, C)
    good = True
    for half in range(2):
        if half == 0:
            inertial.rate(s, unit, C, z[:3], H, cols, y)
            var, nc, channel = known[U_GYRO_PSD] / dt + known[U_GYRO_VAR], 9, GYRO
            inertial.relinearise_rate(s, lay, unit, H, cols, y, var)
        else:
            quat_to_matrix(s, C)
            inertial.force(s, unit, known, C, z[3:6], H, cols, y, f)
            var, nc, channel = known[U_ACCEL_PSD] / dt + known[U_ACCEL_VAR], 15, ACCEL
        for i in range(3):
            R[i] = var + s[shake + i] * half
        if half == 1:
            inertial.relinearise_force(s, lay, unit, H, cols, y, R, f)
        ok = fuse(s, lay, par, ipar, channel, unit, H, cols, nc, y, R, 3, W, reports[count])
        if half == 1 and ipar[BANK] == 0:
            learn_shaking(s, shake, reports[count], age)
            if not ok and turned_round(s, shake, y):
                k[at + 2] = 0
        if not ok and k[at + 2] >= PERSISTENT and not contradicted(k, lay, unit, t):
            # No noise lasts that long: the vehicle does what the model did not foresee.
            since = min((t - k[at + 1]) * 1e-9, MISSED_S)
            allow(s, lay, half, y, since)
            ok = fuse(s, lay, par, ipar, channel, unit, H, cols, nc, y, R, 3, W, reports[count])
        good = good and ok
        if not (ok and told):
            reports_t[count] = t
            count += 1
    if good:
        k[at + 1], k[at + 2] = t, 0
    else:
        k[at + 2] += 1
    return count


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
    for half in range(4):
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
    return count


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


@njit("b1(f8[::1], i8[::1], i8[::1], i8[::1], f8[:, ::1], f8[::1])", cache=True)
def write_row(s: F64, k: I64, lay: I64, ipar: I64, C: F64, row: F64) -> bool:
    """Fill an output row; False where something in it is not finite or a variance is negative."""
    n = lay[L_N]
    P = s[lay[L_P] : lay[L_P] + n * n].reshape((n, n))
    quat_to_matrix(s, C)
    for i in range(3):
        row[O_LAT + i] = s[LAT + i]
        row[O_VEL + i] = s[VEL_N + i]
        row[O_ACCEL_BIAS + i] = s[UNITS + ACCEL_BIAS + i]
        row[O_GYRO_BIAS + i] = s[UNITS + GYRO_BIAS + i]
    for i in range(4):
        row[O_Q + i] = s[Q + i]
    at = O_COV
    for block in range(5):
        first = (POS, VEL, ATT, UNIT + ACCEL_BIAS, UNIT + GYRO_BIAS)[block]
        for i in range(3):
            for j in range(i, 3):
                if block == 2:  # φ = C ψ
                    x = 0.0
                    for a in range(3):
                        for b in range(3):
                            x += C[i, a] * P[ATT + a, ATT + b] * C[j, b]
                    row[at] = x
                else:
                    row[at] = P[first + i, first + j]
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


@njit("b1(f8[::1], i8[::1], i8[::1], f8[::1], i8[::1])", cache=True)
def doubtful(s: F64, k: I64, lay: I64, par: F64, ipar: I64) -> bool:
    """Whether a decision above the kernel is due: a bank, diverged, or locked out."""
    n = lay[L_N]
    if ipar[BANK] == 1 or s[lay[L_P]] + s[lay[L_P] + n + 1] > par[DIVERGED_VAR]:
        return True
    for since in (k[T_REJECT], k[T_REJECT_HEIGHT]):
        if since > 0 and k[T_IMU] - since > ipar[RELOCK_NS]:
            return True
    return False


@njit("void(f8[::1], i8[::1], i8[::1], f8[:, ::1], i8[:, ::1])", cache=True)
def snapshot(s: F64, k: I64, ipar: I64, snaps: F64, snaps_k: I64) -> None:
    """Keep the state in the ring if a cell of the grid was entered since the last one."""
    if k[T_NOW] // ipar[SNAPSHOT_NS] == k[SNAP_CELL]:
        return
    k[SNAP_CELL] = k[T_NOW] // ipar[SNAPSHOT_NS]
    k[SNAP_COUNT] += 1
    slot = k[SNAP_COUNT] % snaps.shape[0]
    for c in range(s.shape[0]):
        snaps[slot, c] = s[c]
    for c in range(k.shape[0]):
        snaps_k[slot, c] = k[c]


@njit(
    "i8(f8[::1], i8[::1], i8[::1], f8[::1], i8[::1], f8[:, ::1], f8[:, ::1], i8[::1], f8[:, ::1],"
    "i8[::1], i8[:, ::1], f8[:, ::1], i8[::1], f8[:, ::1], i8[::1], f8[:, ::1], f8[:, ::1],"
    "i8[:, ::1], i8[:, ::1], i8[::1])",
    cache=True,
)
def walk(
    s: F64,
    k: I64,
    lay: I64,
    par: F64,
    ipar: I64,
    units: F64,
    slow: F64,
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
    switches: I64,
    at: I64,
) -> int:
    """Walk over samples ``at[0]:at[1]`` and aids ``at[2]:at[3]``; see the error-state ``walk``.

    Output rows go to ``rows`` from ``at[4]``, reports to ``reports`` from ``at[5]``, transitions
    (time, which) to ``switches`` from ``at[6]``.
    """
    n = lay[L_N]
    C = np.empty((3, 3))
    W = np.zeros((9, n))
    H = np.zeros((3, WIDTH))
    cols = np.zeros(WIDTH, np.int64)
    y = np.empty(3)
    R = np.empty(3)
    i, j, n_rows, n_reports, n_switches = at[0], at[2], at[4], at[5], at[6]
    code = DONE
    while i < at[1]:
        t = imu_t[i]
        if t - k[T_IMU] > ipar[GAP_NS]:
            code = STOP_GAP
            break
        if (
            t // CHECK_NS != k[T_IMU] // CHECK_NS
            and k[T_CHECK] != k[T_IMU]
            and doubtful(s, k, lay, par, ipar)
        ):
            code = STOP_CHECK
            break
        healthy = True
        while healthy:
            # The next moment: an epoch of the grid, an aid, or the sample itself.
            event = aid_t[j] if j < at[3] and aid_t[j] <= t else t
            epoch = (k[T_OUTPUT] + 1) * ipar[OUTPUT_NS]
            if epoch < k[T_NOW]:
                epoch = (k[T_NOW] // ipar[OUTPUT_NS] + 1) * ipar[OUTPUT_NS]
            if epoch < event and t - epoch >= ipar[OUTPUT_NS]:
                move_to(s, k, lay, par, slow, epoch, W)
                k[T_OUTPUT] = epoch // ipar[OUTPUT_NS]
                rows_t[n_rows] = epoch
                healthy = write_row(s, k, lay, ipar, C, rows[n_rows])
                n_rows += healthy
                continue
            if event > k[T_NOW]:
                # All that happened at this moment is in: here a late aid can begin again.
                snapshot(s, k, ipar, snaps, snaps_k)
            move_to(s, k, lay, par, slow, event, W)
            if j < at[3] and aid_t[j] <= t:
                n_reports = fuse_aid(
                    s, k, lay, par, ipar, units, aid_kind[j], aid[j], aid_t[j], C, H, cols, W,
                    reports_t, reports, n_reports,
                )  # fmt: skip
                j += 1
                continue
            break
        sample = imu[i]
        quat_to_matrix(s, C)
        var = units[0, U_ACCEL_PSD] / min(max((t - k[T_IMU]) * 1e-9, SHORTEST_S), LONGEST_S)
        kind = switch(s, k, lay, par, sample[3], sample[4], var + units[0, U_ACCEL_VAR], C)
        if kind != NO_SWITCH:
            switches[n_switches, 0], switches[n_switches, 1] = t, kind
            n_switches += 1
        n_reports = fuse_unit(
            s, k, lay, par, ipar, units, 0, sample, t, C, H, cols, W, reports_t, reports, n_reports
        )
        if k[CIRCULAR] == 1:
            quat_to_matrix(s, C)
            turn(s, lay, par, C, H, cols, y, R, W)
        if ipar[CONSTRAINT_NS] > 0 and t // ipar[CONSTRAINT_NS] != k[T_IMU] // ipar[CONSTRAINT_NS]:
            quat_to_matrix(s, C)
            nc = aids.sideways(s, C, H, cols, y)
            R[0] = R[1] = par[NHC_VAR]
            fuse(s, lay, par, ipar, _NHC, 0, H, cols, nc, y, R, 2, W, reports[n_reports])
            reports_t[n_reports] = t
            n_reports += 1
        k[T_IMU] = t
        i += 1
        if healthy and t // ipar[OUTPUT_NS] > k[T_OUTPUT]:
            k[T_OUTPUT] = t // ipar[OUTPUT_NS]
            rows_t[n_rows] = t
            healthy = write_row(s, k, lay, ipar, C, rows[n_rows])
            n_rows += healthy
        if not healthy:
            code = STOP_BROKEN
            break
    at[0], at[2], at[4], at[5], at[6] = i, j, n_rows, n_reports, n_switches
    return code
