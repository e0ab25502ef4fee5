"""Non-holonomic constraint: a wheeled vehicle's rear axle moves neither sideways nor up and down.

v_b = C_bn v_n + ω × l at the axle; 0 = v_b[right, down]. With C_true = (I + [φ×]) C:
δv_b = C_bn δv + C_bn [v_n×] φ + [l×] (δb_g + diag(ω_measured) δs_g).  Dissanayake et al. 2001.
"""

from __future__ import annotations

from companion._jit import njit
from companion.navigation.layout import (
    ATT,
    GYRO_BIAS,
    GYRO_BIAS_B,
    GYRO_SCALE_B,
    L_GYRO_SCALE,
    L_N,
    LAST_GYRO,
    VEL,
    VEL_N,
)
from companion.types import F64, I64


@njit(
    "void(f8[::1], i8[::1], f8[:, ::1], f8, f8, f8, f8[:, ::1], f8[::1])", cache=True, counted=False
)
def sideways(s: F64, lay: I64, C: F64, lx: float, ly: float, lz: float, H: F64, y: F64) -> None:
    """Fill ``y[:2]`` [m/s] (right, down) and rows 0, 1 of ``H``; lever (lx, ly, lz) IMU to axle."""
    vn, ve, vd = s[VEL_N], s[VEL_N + 1], s[VEL_N + 2]
    wx = s[LAST_GYRO] * (1.0 - s[GYRO_SCALE_B]) - s[GYRO_BIAS_B]
    wy = s[LAST_GYRO + 1] * (1.0 - s[GYRO_SCALE_B + 1]) - s[GYRO_BIAS_B + 1]
    wz = s[LAST_GYRO + 2] * (1.0 - s[GYRO_SCALE_B + 2]) - s[GYRO_BIAS_B + 2]
    for r in range(2):
        a = r + 1
        for j in range(lay[L_N]):
            H[r, j] = 0.0
        c0, c1, c2 = C[0, a], C[1, a], C[2, a]
        H[r, VEL], H[r, VEL + 1], H[r, VEL + 2] = c0, c1, c2
        H[r, ATT] = c1 * vd - c2 * ve
        H[r, ATT + 1] = c2 * vn - c0 * vd
        H[r, ATT + 2] = c0 * ve - c1 * vn
        y[r] = -(c0 * vn + c1 * ve + c2 * vd)
    y[0] -= wz * lx - wx * lz
    y[1] -= wx * ly - wy * lx
    H[0, GYRO_BIAS], H[0, GYRO_BIAS + 2] = lz, -lx
    H[1, GYRO_BIAS], H[1, GYRO_BIAS + 1] = -ly, lx
    if lay[L_GYRO_SCALE] >= 0:
        for r in range(2):
            for j in range(3):
                H[r, lay[L_GYRO_SCALE] + j] = H[r, GYRO_BIAS + j] * s[LAST_GYRO + j]
