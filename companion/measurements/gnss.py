"""GNSS position and velocity of the antenna, lever arm included.

Position: z = p + C_nb l + b_slow;  velocity: z = v + C_nb (ω_ib × l). Earth rate in
ω_eb = ω_ib − ω_ie is left out of the lever term: 7e-5 m/s for a metre. Groves 2013, section 14.3.2.
"""

from __future__ import annotations

import math

from companion._jit import njit
from companion.navigation.earth import radii
from companion.navigation.layout import (
    ATT,
    GNSS_BIAS,
    GYRO_BIAS,
    GYRO_BIAS_B,
    GYRO_SCALE_B,
    HEIGHT,
    L_GNSS,
    L_GYRO_SCALE,
    L_LEVER,
    L_N,
    LAST_GYRO,
    LAT,
    LEVER_B,
    LON,
    POS,
    VEL,
    VEL_N,
)
from companion.types import F64, I64


@njit("void(f8[::1], i8[::1], f8[:, ::1], f8[::1], f8[:, ::1], f8[::1])", cache=True, counted=False)
def position(s: F64, lay: I64, C: F64, z: F64, H: F64, y: F64) -> None:
    """Fill innovation ``y`` (3,) [m, NED] and Jacobian ``H`` (3, n) of antenna position ``z``.

    ``z`` (3,) latitude, longitude [rad], height [m]; ``C`` (3, 3) is C_nb.
    """
    n = lay[L_N]
    m_radius, n_radius = radii(s[LAT])
    dlon = z[1] - s[LON]
    dlon -= 2.0 * math.pi * math.floor(dlon / (2.0 * math.pi) + 0.5)
    y[0] = (z[0] - s[LAT]) * (m_radius + s[HEIGHT])
    y[1] = dlon * (n_radius + s[HEIGHT]) * math.cos(s[LAT])
    y[2] = s[HEIGHT] - z[2]
    lx, ly, lz = s[LEVER_B], s[LEVER_B + 1], s[LEVER_B + 2]
    x = C[0, 0] * lx + C[0, 1] * ly + C[0, 2] * lz
    v = C[1, 0] * lx + C[1, 1] * ly + C[1, 2] * lz
    w = C[2, 0] * lx + C[2, 1] * ly + C[2, 2] * lz
    y[0] -= x + s[GNSS_BIAS]
    y[1] -= v + s[GNSS_BIAS + 1]
    y[2] -= w + s[GNSS_BIAS + 2]
    for i in range(3):
        for j in range(n):
            H[i, j] = 0.0
        H[i, POS + i] = 1.0
        if lay[L_GNSS] >= 0:
            H[i, lay[L_GNSS] + i] = 1.0
        if lay[L_LEVER] >= 0:
            for j in range(3):
                H[i, lay[L_LEVER] + j] = C[i, j]
    # δ(C l) = φ × (C l) = −[(C l)×] φ
    H[0, ATT + 1], H[0, ATT + 2] = w, -v
    H[1, ATT], H[1, ATT + 2] = -w, x
    H[2, ATT], H[2, ATT + 1] = v, -x


@njit("void(f8[::1], i8[::1], f8[:, ::1], f8[::1], f8[:, ::1], f8[::1])", cache=True, counted=False)
def velocity(s: F64, lay: I64, C: F64, z: F64, H: F64, y: F64) -> None:
    """Fill innovation ``y`` (3,) [m/s, NED] and ``H`` (3, n) of antenna velocity ``z`` (3,) NED."""
    n = lay[L_N]
    lx, ly, lz = s[LEVER_B], s[LEVER_B + 1], s[LEVER_B + 2]
    wx = s[LAST_GYRO] * (1.0 - s[GYRO_SCALE_B]) - s[GYRO_BIAS_B]
    wy = s[LAST_GYRO + 1] * (1.0 - s[GYRO_SCALE_B + 1]) - s[GYRO_BIAS_B + 1]
    wz = s[LAST_GYRO + 2] * (1.0 - s[GYRO_SCALE_B + 2]) - s[GYRO_BIAS_B + 2]
    bx, by, bz = wy * lz - wz * ly, wz * lx - wx * lz, wx * ly - wy * lx
    x = C[0, 0] * bx + C[0, 1] * by + C[0, 2] * bz
    v = C[1, 0] * bx + C[1, 1] * by + C[1, 2] * bz
    w = C[2, 0] * bx + C[2, 1] * by + C[2, 2] * bz
    y[0] = z[0] - s[VEL_N] - x
    y[1] = z[1] - s[VEL_N + 1] - v
    y[2] = z[2] - s[VEL_N + 2] - w
    for i in range(3):
        for j in range(n):
            H[i, j] = 0.0
        H[i, VEL + i] = 1.0
        # δω = −δb_g: C (−δb_g × l) = C [l×] δb_g
        H[i, GYRO_BIAS] = C[i, 1] * lz - C[i, 2] * ly
        H[i, GYRO_BIAS + 1] = C[i, 2] * lx - C[i, 0] * lz
        H[i, GYRO_BIAS + 2] = C[i, 0] * ly - C[i, 1] * lx
        if lay[L_GYRO_SCALE] >= 0:
            # δω = −diag(ω_measured) δs_g
            for j in range(3):
                H[i, lay[L_GYRO_SCALE] + j] = H[i, GYRO_BIAS + j] * s[LAST_GYRO + j]
        if lay[L_LEVER] >= 0:
            k = lay[L_LEVER]
            H[i, k] = C[i, 1] * wz - C[i, 2] * wy
            H[i, k + 1] = C[i, 2] * wx - C[i, 0] * wz
            H[i, k + 2] = C[i, 0] * wy - C[i, 1] * wx
    H[0, ATT + 1], H[0, ATT + 2] = w, -v
    H[1, ATT], H[1, ATT + 2] = -w, x
    H[2, ATT], H[2, ATT + 1] = v, -x
