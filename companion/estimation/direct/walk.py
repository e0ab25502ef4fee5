"""The walk of the direct filter: inertial samples and aids in order of validity, in one kernel.

As :mod:`companion.estimation.walk`, with two differences: an inertial sample is one measurement
among others, so the state is carried by the model between any two of them; and output rows come on
their grid also between the samples of a slow IMU, each from what was measured before it.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.direct import aids
from companion.estimation.direct.aiding import end_epoch, fuse_aid
from companion.estimation.direct.inertial_update import fuse_unit
from companion.estimation.direct.layout import (
    CIRCULAR,
    EPOCH_SEEN,
    L_N,
    L_P,
    SNAP_CELL,
    SNAP_COUNT,
    T_CHECK,
    T_IMU,
    T_NOW,
    T_OUTPUT,
    T_REJECT,
    T_REJECT_HEIGHT,
)
from companion.estimation.direct.motion import MAX_STEP, carry, spread
from companion.estimation.direct.output import write_row
from companion.estimation.direct.parameters import LONGEST_S, SHORTEST_S, U_ACCEL_PSD, U_ACCEL_VAR
from companion.estimation.direct.transitions import NO_SWITCH, switch, turn
from companion.estimation.direct.update import WIDTH, fuse
from companion.estimation.parameters import (
    BANK,
    CONSTRAINT_NS,
    DIVERGED_VAR,
    GAP_NS,
    NHC_VAR,
    OUTPUT_NS,
    RELOCK_NS,
    SNAPSHOT_NS,
)
from companion.estimation.walk import CHECK_NS, DONE, STOP_BROKEN, STOP_CHECK, STOP_GAP
from companion.navigation.rotation import quat_to_matrix
from companion.types import F64, I64

_NHC = 9  # as types.Channel


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
    entry=True,
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
                # Ranges are the last kind at their time.
                if k[EPOCH_SEEN] > 0 and (j == at[3] or aid_t[j] != aid_t[j - 1]):
                    end_epoch(s, k, lay, ipar, aid_t[j - 1])
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
