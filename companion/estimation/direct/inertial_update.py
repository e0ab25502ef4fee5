"""What a sample of an inertial unit does: rate, then specific force, each behind its own gate."""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.estimation.direct import inertial
from companion.estimation.direct.layout import (
    L_UNITS,
    SHAKE_SIZE,
    UNIT_INTS,
    UNIT_SIZE,
    UNIT_TIMES,
    UNITS,
)
from companion.estimation.direct.parameters import (
    LONGEST_S,
    REPORT_NS,
    SHORTEST_S,
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
from companion.estimation.direct.update import ACCEL, GYRO, fuse
from companion.estimation.parameters import BANK
from companion.navigation.rotation import quat_to_matrix
from companion.types import F64, I64


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
