"""Aids of the direct filter: innovation y and the columns of H that are not zero.

Errors as the package says: δp, δv in n, ψ and δω in body axes. Each function fills ``y`` (3,),
``H`` (3, WIDTH) and ``cols`` and returns how many columns there are.
"""

from __future__ import annotations

import math

from companion._jit import njit
from companion.estimation.direct.layout import (
    ACC,
    ACC_N,
    ATT,
    ATTITUDE_BIAS,
    BARO_BIAS,
    GNSS_BIAS,
    HEIGHT,
    L_ATTITUDE,
    L_BARO,
    L_GNSS,
    LAT,
    LON,
    POS,
    RATE,
    RATE_B,
    VEL,
    VEL_N,
)
from companion.navigation.earth import radii
from companion.types import F64, I64


@njit("void(f8[:, ::1], i8)", cache=True)
def _clear(H: F64, nc: int) -> None:
    for i in range(3):
        for j in range(nc):
            H[i, j] = 0.0


@njit(
    "i8(f8[::1], i8[::1], f8[:, ::1], f8[::1], f8[::1], f8[:, ::1], i8[::1], f8[::1])", cache=True
)
def position(s: F64, lay: I64, C: F64, lever: F64, z: F64, H: F64, cols: I64, y: F64) -> int:
    """Antenna position ``z``: latitude, longitude [rad], height [m]; y in metres NED.

    z = p + C l + b_slow; from C exp([ψ×]) l: ∂/∂ψ = −C [l×].
    """
    m, n = radii(s[LAT])
    turn = z[1] - s[LON]
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    y[0] = (z[0] - s[LAT]) * (m + s[HEIGHT])
    y[1] = turn * (n + s[HEIGHT]) * math.cos(s[LAT])
    y[2] = s[HEIGHT] - z[2]
    nc = 9 if lay[L_GNSS] >= 0 else 6
    _clear(H, nc)
    x, v, w = lever[0], lever[1], lever[2]
    for i in range(3):
        y[i] -= C[i, 0] * x + C[i, 1] * v + C[i, 2] * w + s[GNSS_BIAS + i]
        cols[i], cols[3 + i] = POS + i, ATT + i
        H[i, i] = 1.0
        H[i, 3] = C[i, 2] * v - C[i, 1] * w
        H[i, 4] = C[i, 0] * w - C[i, 2] * x
        H[i, 5] = C[i, 1] * x - C[i, 0] * v
        if lay[L_GNSS] >= 0:
            cols[6 + i] = lay[L_GNSS] + i
            H[i, 6 + i] = 1.0
    return nc


@njit("i8(f8[::1], f8[:, ::1], f8[::1], f8[::1], f8[:, ::1], i8[::1], f8[::1])", cache=True)
def velocity(s: F64, C: F64, lever: F64, z: F64, H: F64, cols: I64, y: F64) -> int:
    """Antenna velocity ``z`` (3,) NED [m/s]: v + C (ω × l)."""
    x, v, w = lever[0], lever[1], lever[2]
    p, q, r = s[RATE_B], s[RATE_B + 1], s[RATE_B + 2]
    bx, by, bz = q * w - r * v, r * x - p * w, p * v - q * x
    _clear(H, 9)
    for i in range(3):
        y[i] = z[i] - s[VEL_N + i] - (C[i, 0] * bx + C[i, 1] * by + C[i, 2] * bz)
        cols[i], cols[3 + i], cols[6 + i] = VEL + i, ATT + i, RATE + i
        H[i, i] = 1.0
        H[i, 3] = C[i, 2] * by - C[i, 1] * bz
        H[i, 4] = C[i, 0] * bz - C[i, 2] * bx
        H[i, 5] = C[i, 1] * bx - C[i, 0] * by
        # ω × l = −l × ω
        H[i, 6] = C[i, 2] * v - C[i, 1] * w
        H[i, 7] = C[i, 0] * w - C[i, 2] * x
        H[i, 8] = C[i, 1] * x - C[i, 0] * v
    return 9


@njit("i8(f8[::1], i8[::1], f8, f8[:, ::1], i8[::1], f8[::1])", cache=True)
def pressure_height(s: F64, lay: I64, z: float, H: F64, cols: I64, y: F64) -> int:
    """Pressure height ``z`` [m]: height + offset; down is positive in δp."""
    y[0] = z - s[HEIGHT] - s[BARO_BIAS]
    cols[0], cols[1] = POS + 2, lay[L_BARO]
    H[0, 0], H[0, 1] = -1.0, 1.0
    return 2


@njit("i8(f8[:, ::1], f8, f8, f8, f8, f8[:, ::1], i8[::1], f8[::1])", cache=True)
def direction(
    C: F64, bx: float, by: float, bz: float, azimuth: float, H: F64, cols: I64, y: F64
) -> int:
    """Body vector (bx, by, bz) that should point to ``azimuth`` [rad]; 0 where it is too steep.

    As :func:`companion.measurements.heading.direction`, H_ψ = H_φ C.
    """
    un = C[0, 0] * bx + C[0, 1] * by + C[0, 2] * bz
    ue = C[1, 0] * bx + C[1, 1] * by + C[1, 2] * bz
    ud = C[2, 0] * bx + C[2, 1] * by + C[2, 2] * bz
    h2 = un * un + ue * ue
    if not h2 > 0.01 * (h2 + ud * ud):
        return 0
    e = azimuth - math.atan2(ue, un)
    y[0] = e - 2.0 * math.pi * math.floor(e / (2.0 * math.pi) + 0.5)
    for j in range(3):
        cols[j] = ATT + j
        H[0, j] = C[2, j] - ud * (un * C[0, j] + ue * C[1, j]) / h2
    return 3


@njit("i8(f8[::1], i8[::1], f8[:, ::1], f8[::1], f8[:, ::1], i8[::1], f8[::1])", cache=True)
def attitude(s: F64, lay: I64, C: F64, z: F64, H: F64, cols: I64, y: F64) -> int:
    """Roll, pitch, yaw ``z`` (3,) [rad] of another estimator: y = log(C_bn C_z) − b_slow [rad].

    0 where the two are more than a quarter turn apart: no small error then.
    """
    cr, sr = math.cos(z[0]), math.sin(z[0])
    cp, sp = math.cos(z[1]), math.sin(z[1])
    cy, sy = math.cos(z[2]), math.sin(z[2])
    Z = (
        (cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy),
        (cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy),
        (-sp, sr * cp, cr * cp),
    )
    trace = 0.0
    for i in range(3):
        for j in range(3):
            trace += C[i, j] * Z[i][j]
    if not trace > 1.0:
        return 0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        x = 0.0
        for m in range(3):
            x += C[m, k] * Z[m][j] - C[m, j] * Z[m][k]
        y[i] = 0.5 * x
    half = math.sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2])  # the sine of the angle
    factor = math.asin(min(half, 1.0)) / half if half > 1e-9 else 1.0
    nc = 6 if lay[L_ATTITUDE] >= 0 else 3
    _clear(H, nc)
    for i in range(3):
        y[i] = y[i] * factor - s[ATTITUDE_BIAS + i]
        cols[i] = ATT + i
        H[i, i] = 1.0
        if lay[L_ATTITUDE] >= 0:
            cols[3 + i] = lay[L_ATTITUDE] + i
            H[i, 3 + i] = 1.0
    return nc


@njit("i8(f8[::1], f8[:, ::1], f8[:, ::1], i8[::1], f8[::1])", cache=True)
def sideways(s: F64, C: F64, H: F64, cols: I64, y: F64) -> int:
    """No velocity to the right or down in body axes: v_b = C_bn v, ∂/∂ψ = [v_b×]."""
    bx = C[0, 0] * s[VEL_N] + C[1, 0] * s[VEL_N + 1] + C[2, 0] * s[VEL_N + 2]
    by = C[0, 1] * s[VEL_N] + C[1, 1] * s[VEL_N + 1] + C[2, 1] * s[VEL_N + 2]
    bz = C[0, 2] * s[VEL_N] + C[1, 2] * s[VEL_N + 1] + C[2, 2] * s[VEL_N + 2]
    _clear(H, 6)
    y[0], y[1] = -by, -bz
    for i in range(3):
        cols[i], cols[3 + i] = VEL + i, ATT + i
        H[0, i], H[1, i] = C[i, 1], C[i, 2]
    H[0, 3], H[0, 5] = bz, -bx
    H[1, 3], H[1, 4] = -by, bx
    return 6


@njit("i8(f8[::1], f8[:, ::1], f8[:, ::1], i8[::1], f8[::1])", cache=True)
def lateral(s: F64, C: F64, H: F64, cols: I64, y: F64) -> int:
    """Acceleration to the right in body axes is turn rate times forward speed: 0 = ω_z v_x − a_y.

    With u_b = C_bn u of velocity and acceleration: ∂(u_b)/∂ψ = [u_b×].
    """
    x = y_ = z = a = b = c = 0.0
    for m in range(3):
        x += C[m, 0] * s[VEL_N + m]
        y_ += C[m, 1] * s[VEL_N + m]
        z += C[m, 2] * s[VEL_N + m]
        a += C[m, 0] * s[ACC_N + m]
        b += C[m, 1] * s[ACC_N + m]
        c += C[m, 2] * s[ACC_N + m]
    w = s[RATE_B + 2]
    y[0] = w * x - b
    for m in range(3):
        cols[m], cols[3 + m], cols[6 + m] = ACC + m, VEL + m, ATT + m
        H[0, m], H[0, 3 + m] = C[m, 1], -w * C[m, 0]
    cols[9] = RATE + 2
    H[0, 6], H[0, 7], H[0, 8] = c, w * z, -a - w * y_
    H[0, 9] = -x
    return 10
