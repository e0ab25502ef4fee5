"""Satellites from broadcast ephemerides: position, velocity and clock by the ICDs' algorithm.

IS-GPS-200 table 20-IV and 20.3.3.3.3; Galileo OS SIS ICD section 5.1.1; BeiDou B1I ICD section
5.2.4.12 with its own frame for geostationary satellites.
"""

from __future__ import annotations

import math

from companion._jit import njit
from companion.gnss.systems import BEIDOU, GPS, C
from companion.types import F64

# --- columns of an ephemeris; times of reference are GPS time, angles rad
E_SAT, E_WEEK, E_TOE, E_TOC_WEEK, E_TOC = range(5)
"""Satellite; week and second of week of the orbit's and of the clock's time of reference."""
E_AF0, E_AF1, E_AF2, E_GROUP_DELAY = range(5, 9)
"""Clock polynomial [s, s/s, s/s²], group delay of the signal used [s]."""
E_SQRT_A, E_ECC, E_I0, E_OMEGA0, E_OMEGA, E_M0 = range(9, 15)
E_DELTA_N, E_OMEGA_DOT, E_IDOT = range(15, 18)
E_CUC, E_CUS, E_CRC, E_CRS, E_CIC, E_CIS = range(18, 24)
E_TOE_OWN = 24
"""Second of week of the orbit's time of reference in the system's own time."""
E_ISSUE, E_HEALTH, E_ACCURACY = range(25, 28)
"""Issue of data; 0 where healthy; accuracy of the ranges, 1σ [m]."""
EPHEMERIS_SIZE = 28

MU_GPS = 3.986005e14
MU = 3.986004418e14
OMEGA_E_GPS = 7.2921151467e-5
OMEGA_E_BDS = 7.292115e-5
GEO_TILT = math.radians(-5.0)
STEP_S = 0.5
"""Velocity is the central difference over ± this: its error is STEP²/6 · jerk < 1e-5 m/s."""


@njit("b1(i8)", cache=True)
def geostationary(sat: int) -> bool:
    """BeiDou's geostationary satellites have an orbit frame of their own."""
    prn = sat % 100
    return sat // 100 - 1 == BEIDOU and (prn <= 5 or prn >= 59)


@njit("f8(f8, f8, f8, f8)", cache=True)
def since(week: float, second: float, week_0: float, second_0: float) -> float:
    """Seconds from one GPS time to another, across the end of a week."""
    return float((week - week_0) * 604800.0 + (second - second_0))


@njit("f8(f8[::1], f8, f8[::1])", cache=True)
def place(e: F64, tk: float, x: F64) -> float:
    """ECEF position ``x`` (3,) [m] at ``tk`` seconds after the time of reference.

    In the frame of that moment. Returns the eccentric anomaly [rad].
    """
    sat = int(e[E_SAT])
    system = sat // 100 - 1
    mu = MU_GPS if system == GPS else MU
    rate = OMEGA_E_BDS if system == BEIDOU else OMEGA_E_GPS
    a = e[E_SQRT_A] * e[E_SQRT_A]
    mean = e[E_M0] + (math.sqrt(mu / (a * a * a)) + e[E_DELTA_N]) * tk
    anomaly = mean
    for _ in range(30):
        step = (anomaly - e[E_ECC] * math.sin(anomaly) - mean) / (
            1.0 - e[E_ECC] * math.cos(anomaly)
        )
        anomaly -= step
        if abs(step) < 1e-14:
            break
    sin_e, cos_e = math.sin(anomaly), math.cos(anomaly)
    u = math.atan2(math.sqrt(1.0 - e[E_ECC] * e[E_ECC]) * sin_e, cos_e - e[E_ECC]) + e[E_OMEGA]
    sin_2u, cos_2u = math.sin(2.0 * u), math.cos(2.0 * u)
    u += e[E_CUS] * sin_2u + e[E_CUC] * cos_2u
    r = a * (1.0 - e[E_ECC] * cos_e) + e[E_CRS] * sin_2u + e[E_CRC] * cos_2u
    i = e[E_I0] + e[E_IDOT] * tk + e[E_CIS] * sin_2u + e[E_CIC] * cos_2u
    p, q = r * math.cos(u), r * math.sin(u)
    node = e[E_OMEGA0] + e[E_OMEGA_DOT] * tk - rate * e[E_TOE_OWN]
    geo = geostationary(sat)
    if not geo:
        node -= rate * tk
    sin_o, cos_o, cos_i = math.sin(node), math.cos(node), math.cos(i)
    gx, gy, gz = p * cos_o - q * cos_i * sin_o, p * sin_o + q * cos_i * cos_o, q * math.sin(i)
    if geo:
        sin_t, cos_t = math.sin(rate * tk), math.cos(rate * tk)
        sin_5, cos_5 = math.sin(GEO_TILT), math.cos(GEO_TILT)
        x[0] = gx * cos_t + gy * sin_t * cos_5 + gz * sin_t * sin_5
        x[1] = -gx * sin_t + gy * cos_t * cos_5 + gz * cos_t * sin_5
        x[2] = -gy * sin_5 + gz * cos_5
    else:
        x[0], x[1], x[2] = gx, gy, gz
    return float(anomaly)


@njit("void(f8[::1], f8, f8, f8[::1])", cache=True)
def satellite_at(e: F64, week: float, second: float, out: F64) -> None:
    """Fill ``out`` (8,): position [m], velocity [m/s], clock [m], clock rate [m/s] at a GPS time.

    The clock holds the relativistic part of the eccentric orbit, −2 √(μ a) e sin E / c², and the
    group delay of the signal: pseudorange + clock is free of the satellite's clock.
    """
    tk = since(week, second, e[E_WEEK], e[E_TOE])
    system = int(e[E_SAT]) // 100 - 1
    mu = MU_GPS if system == GPS else MU
    place(e, tk + STEP_S, out[3:6])
    place(e, tk - STEP_S, out[:3])
    for i in range(3):
        out[3 + i] = (out[3 + i] - out[i]) / (2.0 * STEP_S)
    anomaly = place(e, tk, out[:3])
    t = since(week, second, e[E_TOC_WEEK], e[E_TOC])
    factor = -2.0 * math.sqrt(mu) * e[E_ECC] * e[E_SQRT_A] / (C * C)
    a = e[E_SQRT_A] * e[E_SQRT_A]
    motion = math.sqrt(mu / (a * a * a)) / (1.0 - e[E_ECC] * math.cos(anomaly))
    clock = e[E_AF0] + t * (e[E_AF1] + t * e[E_AF2]) + factor * math.sin(anomaly)
    out[6] = C * (clock - e[E_GROUP_DELAY])
    out[7] = C * (e[E_AF1] + 2.0 * t * e[E_AF2] + factor * math.cos(anomaly) * motion)
