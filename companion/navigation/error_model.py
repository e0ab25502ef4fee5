"""The error state of the strapdown solution: ⊞, and the transition of one covariance interval.

Error = truth − estimate; φ in n with C_true = (I + [φ×]) C. In metres NED, following Kamil et al.
2014 eq. 15 (there in latitude, longitude and height):

    δp' = F_pp δp + δv
    δv' = F_vp δp + F_vv δv − [f_n×] φ − C_nb δb_a − C_nb diag(f) δs_a
    φ'  = F_φv δv − [ω_in×] φ − C_nb δb_g − C_nb diag(ω) δs_g

The signs of δb follow from ω_true = ω_measured − b_true. The latitude derivatives of Earth rate,
of radii and of normal gravity are left out: they are below 2e-11 rad/s, 1e-8 1/s and 1e-9 1/s² per
metre, nothing against any noise here.
"""

from __future__ import annotations

import math

from companion._jit import njit
from companion.navigation.earth import gravity_gradient, radii
from companion.navigation.layout import (
    ACCEL_BIAS,
    ACCEL_BIAS_B,
    ACCEL_SCALE_B,
    ATT,
    BARO_BIAS,
    CLOCK,
    CLOCK_STATES,
    EARTH_RATE,
    GNSS_BIAS,
    GYRO_BIAS,
    GYRO_BIAS_B,
    GYRO_SCALE_B,
    HEIGHT,
    L_ACCEL_SCALE,
    L_BARO,
    L_CLOCK,
    L_GNSS,
    L_GYRO_SCALE,
    L_LEVER,
    LAT,
    LEVER_B,
    LON,
    POS,
    SUM_C,
    SUM_CF,
    SUM_CW,
    SUM_P,
    SUM_T,
    SUM_V,
    VEL,
    VEL_N,
)
from companion.navigation.rotation import rotate_nav
from companion.types import F64, I64

COLUMNS = 8
"""Block (r, c) of Φ is ``B[COLUMNS * r + c]``; columns p, v, φ, b_a, b_g, s_a, s_g, none."""


@njit("void(f8[::1], i8[::1], f8[::1])", cache=True, entry=True, counted=False)
def box_plus(s: F64, lay: I64, dx: F64) -> None:
    """Move the error ``dx`` (n,) into the nominal state in place: x ⊞ δx."""
    m, n = radii(s[LAT])
    lat = s[LAT]
    s[LAT] = lat + dx[POS] / (m + s[HEIGHT])
    s[LON] += dx[POS + 1] / ((n + s[HEIGHT]) * math.cos(lat))
    s[HEIGHT] -= dx[POS + 2]
    rotate_nav(s, dx[ATT], dx[ATT + 1], dx[ATT + 2])
    for i in range(3):
        s[VEL_N + i] += dx[VEL + i]
        s[ACCEL_BIAS_B + i] += dx[ACCEL_BIAS + i]
        s[GYRO_BIAS_B + i] += dx[GYRO_BIAS + i]
        if lay[L_ACCEL_SCALE] >= 0:
            s[ACCEL_SCALE_B + i] += dx[lay[L_ACCEL_SCALE] + i]
        if lay[L_GYRO_SCALE] >= 0:
            s[GYRO_SCALE_B + i] += dx[lay[L_GYRO_SCALE] + i]
        if lay[L_LEVER] >= 0:
            s[LEVER_B + i] += dx[lay[L_LEVER] + i]
        if lay[L_GNSS] >= 0:
            s[GNSS_BIAS + i] += dx[lay[L_GNSS] + i]
    if lay[L_BARO] >= 0:
        s[BARO_BIAS] += dx[lay[L_BARO]]
    if lay[L_CLOCK] >= 0:
        for i in range(CLOCK_STATES):
            s[CLOCK + i] += dx[lay[L_CLOCK] + i]


@njit("void(f8[::1], f8[:, :, ::1])", cache=True, counted=False)
def core_blocks(s: F64, B: F64) -> None:
    """Fill the blocks of ``B`` (24, 3, 3) that every layout has."""
    T = s[SUM_T]
    lat, height = s[LAT], s[HEIGHT]
    m, n = radii(lat)
    m += height
    n += height
    sin_lat, cos_lat = math.sin(lat), math.cos(lat)
    tan_lat = sin_lat / cos_lat
    vn, ve, vd = s[VEL_N], s[VEL_N + 1], s[VEL_N + 2]
    enx, eny, enz = ve / n, -vn / m, -ve / n * tan_lat
    iex, iez = s[EARTH_RATE] * cos_lat, -s[EARTH_RATE] * sin_lat
    inx, iny, inz = iex + enx, eny, iez + enz
    cx, cy, cz = inx + iex, iny, inz + iez

    # p ← p: lat' = v_N/(M+h) and lon' = v_E/((N+h) cos φ), in metres
    B[0, :, :] = 0.0
    B[0, 0, 0] = 1.0 - T * vd / m
    B[0, 0, 2] = T * vn / m
    B[0, 1, 0] = T * ve * tan_lat / m
    B[0, 1, 1] = 1.0 - T * (vd / n + vn * tan_lat / m)
    B[0, 1, 2] = T * ve / n
    B[0, 2, 2] = 1.0
    # v ← p: gravity weakens upwards
    B[8, :, :] = 0.0
    B[8, 2, 2] = -T * gravity_gradient(lat, height)
    # v ← v: −(2ω_ie + ω_en) × δv − (∂ω_en/∂v δv) × v
    b = B[9]
    b[0, 0] = 1.0 + T * vd / m
    b[0, 1] = T * (cz - ve * tan_lat / n)
    b[0, 2] = -T * cy
    b[1, 0] = -T * cz
    b[1, 1] = 1.0 + T * (vn * tan_lat + vd) / n
    b[1, 2] = T * cx
    b[2, 0] = T * (cy - vn / m)
    b[2, 1] = -T * (cx + ve / n)
    b[2, 2] = 1.0
    # φ ← v: −∂ω_en/∂v
    B[17, :, :] = 0.0
    B[17, 0, 1] = -T / n
    B[17, 1, 0] = T / m
    B[17, 2, 1] = T * tan_lat / n
    # φ ← φ
    b = B[18]
    b[0, 0], b[0, 1], b[0, 2] = 1.0, T * inz, -T * iny
    b[1, 0], b[1, 1], b[1, 2] = -T * inz, 1.0, T * inx
    b[2, 0], b[2, 1], b[2, 2] = T * iny, -T * inx, 1.0
    # p ← v
    B[1, :, :] = 0.0
    B[1, 0, 0] = B[1, 1, 1] = B[1, 2, 2] = T
    # v ← φ: −[∫f×]; p ← φ: −[∫∫f×]
    for r, o in ((10, SUM_V), (2, SUM_P)):
        x, y, z = s[o], s[o + 1], s[o + 2]
        b = B[r]
        b[0, 0], b[0, 1], b[0, 2] = 0.0, z, -y
        b[1, 0], b[1, 1], b[1, 2] = -z, 0.0, x
        b[2, 0], b[2, 1], b[2, 2] = y, -x, 0.0
    # bias; ∫ f t dt = T ∫f − ∫∫f
    one = 1.0 / T
    tx = s[SUM_V] - one * s[SUM_P]
    ty = s[SUM_V + 1] - one * s[SUM_P + 1]
    tz = s[SUM_V + 2] - one * s[SUM_P + 2]
    for j in range(3):
        x, y, z = s[SUM_C + j], s[SUM_C + 3 + j], s[SUM_C + 6 + j]
        B[11, 0, j], B[11, 1, j], B[11, 2, j] = -x, -y, -z
        B[20, 0, j], B[20, 1, j], B[20, 2, j] = -x, -y, -z
        # v ← b_g: [f×] C t, integrated; p ← b_g is third order, a third of T of it
        B[12, 0, j] = ty * z - tz * y
        B[12, 1, j] = tz * x - tx * z
        B[12, 2, j] = tx * y - ty * x
        for i in range(3):
            B[3, i, j] = 0.5 * T * B[11, i, j]
            B[4, i, j] = B[12, i, j] * T / 3.0


@njit("void(f8[::1], f8[:, :, ::1])", cache=True, counted=False)
def scale_blocks(s: F64, B: F64) -> None:
    """Fill the blocks of ``B`` (24, 3, 3) in the columns of scale factors."""
    T = s[SUM_T]
    tx = s[SUM_V] - s[SUM_P] / T
    ty = s[SUM_V + 1] - s[SUM_P + 1] / T
    tz = s[SUM_V + 2] - s[SUM_P + 2] / T
    for j in range(3):
        x, y, z = s[SUM_CW + j], s[SUM_CW + 3 + j], s[SUM_CW + 6 + j]
        B[14, 0, j] = ty * z - tz * y
        B[14, 1, j] = tz * x - tx * z
        B[14, 2, j] = tx * y - ty * x
        for i in range(3):
            B[13, i, j] = -s[SUM_CF + 3 * i + j]
            B[5, i, j] = 0.5 * T * B[13, i, j]
            B[22, i, j] = -s[SUM_CW + 3 * i + j]
            B[6, i, j] = B[14, i, j] * T / 3.0


@njit("void(f8[::1], f8[:, :, ::1])", cache=True, counted=False)
def transition_blocks(s: F64, B: F64) -> None:
    """Fill ``B`` (24, 3, 3) with the rows p, v, φ of Φ, see :data:`COLUMNS`.

    From the sums since the last call: T, ∫f_n, ∫∫f_n, ∫C_nb, ∫C_nb diag(f), ∫C_nb diag(ω).
    Second order in T for the paths bias → attitude → velocity → position, so that a propagation
    at 50 Hz matches one at the IMU's rate to 1e-4.
    """
    core_blocks(s, B)
    scale_blocks(s, B)
