"""An output row of the direct filter, in the terms that both filters give out."""

from __future__ import annotations

from companion._jit import njit
from companion.estimation.direct.layout import (
    ACCEL_BIAS,
    ATT,
    GYRO_BIAS,
    L_N,
    L_P,
    LAT,
    POS,
    RESETS,
    T_NOW,
    T_POSITION_AID,
    T_VELOCITY_AID,
    UNIT,
    UNITS,
    VEL,
    VEL_N,
    Q,
)
from companion.estimation.output_row import (
    O_ACCEL_BIAS,
    O_COV,
    O_GYRO_BIAS,
    O_LAT,
    O_MODE,
    O_Q,
    O_RESETS,
    O_VEL,
    presentable,
)
from companion.estimation.parameters import BASE_MODE, COASTING_NS
from companion.navigation.rotation import quat_to_matrix
from companion.types import F64, I64


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
    return presentable(row)
