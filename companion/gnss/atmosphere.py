"""Delays in ionosphere and troposphere [m]."""

from __future__ import annotations

import math

from companion._jit import njit
from companion.gnss.systems import C
from companion.types import F64


@njit("f8(f8[::1], f8, f8, f8, f8, f8)", cache=True)
def klobuchar(
    coefficients: F64, lat: float, lon: float, azimuth: float, elevation: float, second: float
) -> float:
    """Ionospheric delay at L1 [m] towards ``azimuth``; as :func:`klobuchar_towards`."""
    north, east = math.cos(azimuth), math.sin(azimuth)
    return klobuchar_towards(coefficients, lat, lon, north, east, elevation, second)


@njit("f8(f8[::1], f8, f8, f8, f8, f8, f8)", cache=True, counted=False)
def klobuchar_towards(
    coefficients: F64, lat: float, lon: float, north: float, east: float, elevation: float,
    second: float,
) -> float:  # fmt: skip
    """Ionospheric delay at L1 [m] by the GPS broadcast model, IS-GPS-200 figure 20-4.

    ``coefficients`` (8,): α0…α3, β0…β3 as broadcast; ``lat``, ``lon``, ``elevation`` [rad];
    ``north``, ``east``: cosine and sine of the azimuth; ``second``: GPS second of week (or of day).
    The model speaks semicircles.
    """
    e = elevation / math.pi
    psi = 0.0137 / (e + 0.11) - 0.022
    phi = lat / math.pi + psi * north
    phi = min(max(phi, -0.416), 0.416)
    lam = lon / math.pi + psi * east / math.cos(phi * math.pi)
    phi_m = phi + 0.064 * math.cos((lam - 1.617) * math.pi)
    local = 43200.0 * lam + second
    local -= 86400.0 * math.floor(local / 86400.0)
    low = 0.53 - e
    slant = 1.0 + 16.0 * low * low * low
    amplitude, period = 0.0, 0.0
    for i in range(3, -1, -1):
        amplitude = amplitude * phi_m + coefficients[i]
        period = period * phi_m + coefficients[4 + i]
    amplitude, period = max(amplitude, 0.0), max(period, 72000.0)
    x = 2.0 * math.pi * (local - 50400.0) / period
    delay = 5e-9
    if abs(x) < 1.57:
        square = x * x
        delay += amplitude * (1.0 - square / 2.0 + square * square / 24.0)
    return C * slant * delay


@njit("f8(f8, f8)", cache=True, counted=False)
def zenith_delay(lat: float, height: float) -> float:
    """Tropospheric delay straight up [m]: Saastamoinen 1972 in a standard atmosphere.

    1013.25 hPa and 15 °C at sea level, −6.5 K/km, 70 % humidity (Groves 2013, section 9.3.2).
    """
    h = min(max(height, 0.0), 20000.0)
    pressure = 1013.25 * (1.0 - 2.2557e-5 * h) ** 5.2568
    kelvin = 15.0 - 6.5e-3 * h + 273.16
    vapour = 6.108 * 0.7 * math.exp((17.15 * kelvin - 4684.0) / (kelvin - 38.45))
    dry = 0.0022768 * pressure / (1.0 - 0.00266 * math.cos(2.0 * lat) - 0.00028e-3 * h)
    wet = 0.002277 * (1255.0 / kelvin + 0.05) * vapour
    return float(dry + wet)


@njit("f8(f8)", cache=True, counted=False)
def mapped(sin_elevation: float) -> float:
    """How many times as long the way through the troposphere is as straight up.

    1.001 / √(0.002001 + sin² E) of RTCA DO-229, good above 4 degrees, where 1/sin E is not.
    """
    s = max(sin_elevation, 0.0)
    return float(1.001 / math.sqrt(0.002001 + s * s))


@njit("f8(f8, f8, f8)", cache=True)
def troposphere(lat: float, height: float, elevation: float) -> float:
    """Tropospheric delay [m] towards ``elevation`` [rad]."""
    return zenith_delay(lat, height) * mapped(math.sin(elevation))
