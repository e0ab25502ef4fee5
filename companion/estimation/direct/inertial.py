"""An inertial unit as a measurement: rates and specific forces of unit u, at lever arm r.

    ω_u = (I + S_g) (ω + C_bn ω_in) + b_g
    f_u = (I + S_a) C_bn (a + ω_c × v − g) + ω × (ω × r) + b_a

Yu et al. 2018 eqs 31-36, with Earth and transport rate (ω_c = 2 ω_ie + ω_en) that the paper leaves
out for its low-cost units. As there, the angular acceleration that a lever arm also sees is not a
state: of two units on either side of the first its effect cancels.
"""

from __future__ import annotations

import math

from companion._jit import njit
from companion.estimation.direct.layout import (
    ACC,
    ACC_N,
    ACCEL_BIAS,
    ACCEL_SCALE,
    ATT,
    GYRO_BIAS,
    GYRO_SCALE,
    HEIGHT,
    L_N,
    L_P,
    LAT,
    RATE,
    RATE_B,
    UNIT,
    UNIT_SIZE,
    UNITS,
    VEL_N,
)
from companion.estimation.direct.parameters import U_LEVER
from companion.navigation import earth
from companion.types import F64, I64

EARTH_RATE = earth.RATE


@njit("void(f8[::1], i8, f8[:, ::1], f8[::1], f8[:, ::1], i8[::1], f8[::1])", cache=True)
def rate(s: F64, unit: int, C: F64, z: F64, H: F64, cols: I64, y: F64) -> None:
    """Innovation ``y`` (3,) [rad/s] and the nine columns of H of gyro ``z`` (3,) of ``unit``.

    Row i touches ω_i, b_g,i and s_g,i: ∂/∂ω = 1 + s, ∂/∂b = 1, ∂/∂s = ω. The turn of Earth's rate
    by an attitude error is left out: 7e-5 rad/s a radian.
    """
    m, n = earth.radii(s[LAT])
    east = s[VEL_N + 1] / (n + s[HEIGHT])
    inn = EARTH_RATE * math.cos(s[LAT]) + east
    ine = -s[VEL_N] / (m + s[HEIGHT])
    ind = -EARTH_RATE * math.sin(s[LAT]) - east * math.tan(s[LAT])
    at = UNITS + UNIT_SIZE * unit
    column = UNIT + UNIT_SIZE * unit
    for i in range(3):
        for j in range(9):
            H[i, j] = 0.0
    for i in range(3):
        w = s[RATE_B + i] + C[0, i] * inn + C[1, i] * ine + C[2, i] * ind
        k = 1.0 + s[at + GYRO_SCALE + i]
        y[i] = z[i] - k * w - s[at + GYRO_BIAS + i]
        cols[i], cols[3 + i], cols[6 + i] = (
            RATE + i,
            column + GYRO_BIAS + i,
            column + GYRO_SCALE + i,
        )
        H[i, i], H[i, 3 + i], H[i, 6 + i] = k, 1.0, w


@njit("void(f8[::1], f8[:, ::1], f8[::1])", cache=True)
def reaction(s: F64, C: F64, f: F64) -> None:
    """Fill ``f`` (3,) with C_bn (a + ω_c × v − g) [m/s²]: what an ideal first unit feels."""
    m, n = earth.radii(s[LAT])
    vn, ve, vd = s[VEL_N], s[VEL_N + 1], s[VEL_N + 2]
    east = ve / (n + s[HEIGHT])
    cn = 2.0 * EARTH_RATE * math.cos(s[LAT]) + east
    ce = -vn / (m + s[HEIGHT])
    cd = -2.0 * EARTH_RATE * math.sin(s[LAT]) - east * math.tan(s[LAT])
    x = s[ACC_N] + ce * vd - cd * ve
    v = s[ACC_N + 1] + cd * vn - cn * vd
    w = s[ACC_N + 2] + cn * ve - ce * vn - earth.gravity(s[LAT], s[HEIGHT])
    for i in range(3):
        f[i] = C[0, i] * x + C[1, i] * v + C[2, i] * w


@njit("f8(f8[::1], i8[::1], f8[:, ::1], i8[::1], i8, i8, f8)", cache=True)
def _share(s: F64, lay: I64, H: F64, cols: I64, nc: int, i: int, var: float) -> float:
    """How much of innovation ``i`` the update will take in: h P hᵀ / (h P hᵀ + var)."""
    n = lay[L_N]
    P = s[lay[L_P] : lay[L_P] + n * n].reshape((n, n))
    x = 0.0
    for a in range(nc):
        part = 0.0
        for b in range(nc):
            part += P[cols[a], cols[b]] * H[i, b]
        x += H[i, a] * part
    return x / (x + var)


@njit("void(f8[::1], i8, f8[::1], f8[:, ::1])", cache=True)
def _about(s: F64, at: int, f: F64, H: F64) -> None:
    """Fill the columns of H that depend on the specific force ``f`` (3,): attitude and scale."""
    for i in range(3):
        k = 1.0 + s[at + ACCEL_SCALE + i]
        H[i, 3 + (i + 1) % 3] = -k * f[(i + 2) % 3]
        H[i, 3 + (i + 2) % 3] = k * f[(i + 1) % 3]
        H[i, 12 + i] = f[i]


@njit(
    "void(f8[::1], i8, f8[::1], f8[:, ::1], f8[::1], f8[:, ::1], i8[::1], f8[::1], f8[::1])",
    cache=True,
)
def force(s: F64, unit: int, known: F64, C: F64, z: F64, H: F64, cols: I64, y: F64, f: F64) -> None:
    """Innovation ``y`` (3,) [m/s²] and fifteen columns of H of accelerometer ``z`` of ``unit``.

    ``known``: the unit's row of the table; ``f`` (3,) is left with the predicted force.
    ∂/∂a = K C_bn, ∂/∂ψ = K [f×] from exp(−[ψ×]) f, K = I + S_a; ∂/∂ω of ω(ω·r) − r ω² is
    (ω·r) I + ω rᵀ − 2 r ωᵀ. Coriolis, 1e-4 m/s² a m/s, is left out of H.
    """
    reaction(s, C, f)
    at = UNITS + UNIT_SIZE * unit
    column = UNIT + UNIT_SIZE * unit
    wx, wy, wz = s[RATE_B], s[RATE_B + 1], s[RATE_B + 2]
    rx, ry, rz = known[U_LEVER], known[U_LEVER + 1], known[U_LEVER + 2]
    dot = wx * rx + wy * ry + wz * rz
    square = wx * wx + wy * wy + wz * wz
    for i in range(3):
        for j in range(15):
            H[i, j] = 0.0
    for i in range(3):
        k = 1.0 + s[at + ACCEL_SCALE + i]
        r = known[U_LEVER + i]
        w = s[RATE_B + i]
        y[i] = z[i] - k * f[i] - (w * dot - r * square) - s[at + ACCEL_BIAS + i]
        for j in range(3):
            H[i, j] = k * C[j, i]
            H[i, 6 + j] = w * known[U_LEVER + j] - 2.0 * r * s[RATE_B + j]
        H[i, 6 + i] += dot
        H[i, 9 + i] = 1.0
        cols[i], cols[3 + i], cols[6 + i] = ACC + i, ATT + i, RATE + i
        cols[9 + i], cols[12 + i] = column + ACCEL_BIAS + i, column + ACCEL_SCALE + i
    _about(s, at, f, H)


@njit("void(f8[::1], i8[::1], i8, f8[:, ::1], i8[::1], f8[::1], f8[::1], f8[::1])", cache=True)
def relinearise_force(
    s: F64, lay: I64, unit: int, H: F64, cols: I64, y: F64, R: F64, f: F64
) -> None:
    """Move the point that H of :func:`force` stands for from the predicted force to the likely one.

    Acceleration and attitude are seen only through f: one set of errors, α = −C [f×] ψ, leaves it
    as it is. Several units whose H stand for different f would each leave another set alone, and
    all together none: attitude would be learned from nothing. So f is where the update will bring
    it, and hardly moves from one unit to the next.
    """
    at = UNITS + UNIT_SIZE * unit
    for i in range(3):
        f[i] += _share(s, lay, H, cols, 15, i, R[i]) * y[i] / (1.0 + s[at + ACCEL_SCALE + i])
    _about(s, at, f, H)


@njit("void(f8[::1], i8[::1], i8, f8[:, ::1], i8[::1], f8[::1], f8)", cache=True)
def relinearise_rate(s: F64, lay: I64, unit: int, H: F64, cols: I64, y: F64, var: float) -> None:
    """The same for :func:`rate`: rate and scale factor are seen only through their product."""
    at = UNITS + UNIT_SIZE * unit
    for i in range(3):
        share = _share(s, lay, H, cols, 9, i, var)
        H[i, 6 + i] += share * y[i] / (1.0 + s[at + GYRO_SCALE + i])
