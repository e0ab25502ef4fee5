"""What a filter gives out at a moment: an output row, and the kernel that fills it."""

from __future__ import annotations

from companion._jit import njit
from companion.estimation.parameters import (
    BASE_MODE,
    COASTING_NS,
    FEEDFORWARD,
)
from companion.navigation.error_model import box_plus
from companion.navigation.layout import (
    ACCEL_BIAS_B,
    DX,
    L_N,
    LAT,
    RESETS,
    T_NOW,
    T_POSITION_AID,
    T_VELOCITY_AID,
    VEL_N,
)
from companion.navigation.layout import P as P_OFFSET
from companion.types import F64, I64

# --- columns of an output row
O_LAT, O_VEL, O_Q, O_ACCEL_BIAS, O_GYRO_BIAS, O_COV, O_MODE, O_RESETS = 0, 3, 6, 10, 13, 16, 46, 47
ROW_SIZE = 48


@njit("b1(f8[::1])", cache=True, counted=False)
def presentable(row: F64) -> bool:
    """Whether a row is fit to be given out: all of it finite, no variance negative."""
    for i in range(O_MODE):
        if not abs(row[i]) < 1e30:
            return False
    for block in range(5):
        at = O_COV + 6 * block
        if row[at] < 0.0 or row[at + 3] < 0.0 or row[at + 5] < 0.0:
            return False
    return True


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
    return presentable(row)
