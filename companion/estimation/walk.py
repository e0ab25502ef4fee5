"""The walk: inertial samples and aiding in order of validity, one kernel for a block or a sample.

Everything that happens to a filter between two moments happens here: strapdown steps, steps split
at the time of an aid, covariance, aids, constraints, output rows, snapshots. What happens depends
on the sorted samples alone, never on how they were cut into calls.
"""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.estimation.aid_table import A_CLOCK_SCALE, A_LET_GO, KIND_RANGE
from companion.estimation.aiding import fuse_aid, fuse_constraints
from companion.estimation.covariance import STRIDE, propagate
from companion.estimation.output_row import write_row
from companion.estimation.parameters import (
    BANK,
    BRIDGED_DT,
    CONSTRAINT_NS,
    COVARIANCE_NS,
    DIVERGED_VAR,
    GAP_NS,
    OUTPUT_NS,
    RELOCK_NS,
    SNAPSHOT_NS,
    STILL_ACCEL,
    STILL_GYRO,
    STILL_NS,
    STILL_SPEED,
    ZERO_VELOCITY,
)
from companion.estimation.range_update import fuse_epoch
from companion.estimation.saturation import SATURATION, saturated
from companion.estimation.source_faults import undecided
from companion.estimation.tape import RECORDER, Recorder, record_row, record_step
from companion.measurements.standstill import observe
from companion.navigation.layout import (
    CLOCK_SCALE,
    DX,
    HAVE_IMU,
    L_ACCEL_SCALE,
    L_N,
    LAST_GYRO,
    REFUSED_SINCE,
    STANDING,
    SUM_XA,
    SUM_XC,
    SUM_XV,
    T_CHECK,
    T_CONSTRAINT,
    T_COVARIANCE,
    T_IMU,
    T_NOW,
    T_OUTPUT,
    T_SNAPSHOT,
    VELOCITY_FIT,
)
from companion.navigation.layout import P as P_OFFSET
from companion.navigation.mechanisation import advance
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

EXCESS = 8
"""Columns of a sample's noise beyond the configured one: gyro, accelerometer."""
BRIDGE_ACCEL_VAR = 1.0
BRIDGE_GYRO_VAR = 0.01
"""What a bridged gap may hide: (1 m/s²)² and (0.1 rad/s)², constant over the gap."""


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
            for c in range(3):
                s[CLOCK_SCALE + c] = aid[first, A_CLOCK_SCALE + c]
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
