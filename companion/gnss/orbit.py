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


@njit("b1(i8)", cache=True)
def geostationary(sat: int) -> bool:
    """BeiDou's geostationary satellites have an orbit frame of their own."""
    prn = sat % 100
    return sat // 100 - 1 == BEIDOU and (prn <= 5 or prn >= 59)


@njit("f8(f8, f8, f8, f8)", cache=True, entry=True)
def since(week: float, second: float, week_0: float, second_0: float) -> float:
    """Seconds from one GPS time to another, across the end of a week."""
    return float((week - week_0) * 604800.0 + (second - second_0))


@njit("f8(f8, f8)", cache=True)
def eccentric(mean: float, ecc: float) -> float:
    """Eccentric anomaly [rad] by Newton's method on Kepler's equation."""
    anomaly = mean + ecc * math.sin(mean)
    for _ in range(30):
        step = (anomaly - ecc * math.sin(anomaly) - mean) / (1.0 - ecc * math.cos(anomaly))
        anomaly -= step
        if abs(step) < 1e-14:
            break
    return anomaly


@njit("f8(f8[::1], f8, f8[::1])", cache=True)
def place(e: F64, tk: float, x: F64) -> float:
    """ECEF position [m] and velocity [m/s], ``x`` (6,), at ``tk`` s after the time of reference.

    In the frame of that moment; the velocity is the derivative, term by term. Returns the eccentric
    anomaly [rad].
    """
    sat = int(e[E_SAT])
    system = sat // 100 - 1
    mu = MU_GPS if system == GPS else MU
    rate = OMEGA_E_BDS if system == BEIDOU else OMEGA_E_GPS
    ecc = e[E_ECC]
    a = e[E_SQRT_A] * e[E_SQRT_A]
    motion = math.sqrt(mu / (a * a * a)) + e[E_DELTA_N]
    anomaly = eccentric(e[E_M0] + motion * tk, ecc)
    sin_e, cos_e = math.sin(anomaly), math.cos(anomaly)
    flat, near = math.sqrt(1.0 - ecc * ecc), 1.0 - ecc * cos_e
    anomaly_dot = motion / near
    u = math.atan2(flat * sin_e, cos_e - ecc) + e[E_OMEGA]
    u_dot = anomaly_dot * flat / near
    sin_2u, cos_2u = math.sin(2.0 * u), math.cos(2.0 * u)
    twice = 2.0 * u_dot
    r = a * near + e[E_CRS] * sin_2u + e[E_CRC] * cos_2u
    r_dot = a * ecc * sin_e * anomaly_dot + twice * (e[E_CRS] * cos_2u - e[E_CRC] * sin_2u)
    i = e[E_I0] + e[E_IDOT] * tk + e[E_CIS] * sin_2u + e[E_CIC] * cos_2u
    i_dot = e[E_IDOT] + twice * (e[E_CIS] * cos_2u - e[E_CIC] * sin_2u)
    u += e[E_CUS] * sin_2u + e[E_CUC] * cos_2u
    u_dot += twice * (e[E_CUS] * cos_2u - e[E_CUC] * sin_2u)
    sin_u, cos_u = math.sin(u), math.cos(u)
    p, q = r * cos_u, r * sin_u
    p_dot, q_dot = r_dot * cos_u - q * u_dot, r_dot * sin_u + p * u_dot
    node, node_dot = e[E_OMEGA0] + e[E_OMEGA_DOT] * tk - rate * e[E_TOE_OWN], e[E_OMEGA_DOT]
    geo = geostationary(sat)
    if not geo:
        node -= rate * tk
        node_dot -= rate
    sin_o, cos_o = math.sin(node), math.cos(node)
    sin_i, cos_i = math.sin(i), math.cos(i)
    x[0], x[1] = p * cos_o - q * cos_i * sin_o, p * sin_o + q * cos_i * cos_o
    x[2] = q * sin_i
    x[3] = p_dot * cos_o - q_dot * cos_i * sin_o + x[2] * sin_o * i_dot - x[1] * node_dot
    x[4] = p_dot * sin_o + q_dot * cos_i * cos_o - x[2] * cos_o * i_dot + x[0] * node_dot
    x[5] = q_dot * sin_i + q * cos_i * i_dot
    if geo:
        sin_t, cos_t = math.sin(rate * tk), math.cos(rate * tk)
        sin_5, cos_5 = math.sin(GEO_TILT), math.cos(GEO_TILT)
        for o in (0, 3):
            gx, gy, gz = x[o], x[o + 1], x[o + 2]
            x[o] = gx * cos_t + gy * sin_t * cos_5 + gz * sin_t * sin_5
            x[o + 1] = -gx * sin_t + gy * cos_t * cos_5 + gz * cos_t * sin_5
            x[o + 2] = -gy * sin_5 + gz * cos_5
        x[3] += rate * x[1]
        x[4] -= rate * x[0]
    return float(anomaly)


@njit("f8(f8[::1], f8, f8)", cache=True)
def clock_polynomial(e: F64, week: float, second: float) -> float:
    """Clock [s] by its broadcast polynomial alone, to 1e-7 s of what :func:`satellite_at` tells."""
    t = since(week, second, e[E_TOC_WEEK], e[E_TOC])
    return float(e[E_AF0] + t * (e[E_AF1] + t * e[E_AF2]))


@njit("void(f8[::1], f8, f8, f8[::1])", cache=True, entry=True)
def satellite_at(e: F64, week: float, second: float, out: F64) -> None:
    """Fill ``out`` (8,): position [m], velocity [m/s], clock [m], clock rate [m/s] at a GPS time.

    The clock holds the relativistic part of the eccentric orbit, −2 √(μ a) e sin E / c², and the
    group delay of the signal: pseudorange + clock is free of the satellite's clock.
    """
    tk = since(week, second, e[E_WEEK], e[E_TOE])
    system = int(e[E_SAT]) // 100 - 1
    mu = MU_GPS if system == GPS else MU
    anomaly = place(e, tk, out)
    t = since(week, second, e[E_TOC_WEEK], e[E_TOC])
    factor = -2.0 * math.sqrt(mu) * e[E_ECC] * e[E_SQRT_A] / (C * C)
    a = e[E_SQRT_A] * e[E_SQRT_A]
    motion = math.sqrt(mu / (a * a * a)) / (1.0 - e[E_ECC] * math.cos(anomaly))
    clock = clock_polynomial(e, week, second) + factor * math.sin(anomaly)
    out[6] = C * (clock - e[E_GROUP_DELAY])
    out[7] = C * (e[E_AF1] + 2.0 * t * e[E_AF2] + factor * math.cos(anomaly) * motion)
